"""Clearances, contact stiffnesses and unmodelled effects from vibration recordings.

    import identify

    found = identify.contact("barrel.mcap", use="acceleration")
    print(found)
    found.save("results")

`contact` finds clearance, stiffness and damping of every contact, `law` the contact law as a formula, `gap` how the
machine differs from its description. Each takes recordings or the names of their files, and returns a result with
`to_dict()`, `table()`, `figure(name)` and `save(folder)`.
"""

from importlib.metadata import version

from identify.api import ContactResult, GapResult, LawResult, Picture, contact, gap, law

__all__ = ["ContactResult", "GapResult", "LawResult", "Picture", "contact", "gap", "law"]
__version__ = version("rig-identify")
