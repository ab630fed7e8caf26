"""Clearances, contact stiffnesses and unmodelled effects from vibration recordings.

    import identify

    found = identify.contact("barrel.mcap", use="acceleration")
    print(found)
    found.save("results")

`check` says what is wrong with a recording, `contact` finds clearance, stiffness and damping of every contact, `law`
the contact law as a formula, `gap` how the machine differs from its description, `compare` what changed between
recordings. Each takes recordings or the names of their files, and returns a result with `to_dict()` and `table()`, all
but `check` also with `figure(name)` and `save(folder)`.
"""

from importlib.metadata import version

from identify.api import check, compare, contact, gap, law
from identify.pages.picture import Picture
from identify.results import CheckResult, ContactResult, GapResult, HistoryResult, LawResult

__all__ = [
    "CheckResult",
    "ContactResult",
    "GapResult",
    "HistoryResult",
    "LawResult",
    "Picture",
    "check",
    "compare",
    "contact",
    "gap",
    "law",
]
__version__ = version("rig-identify")
