"""Clearances, contact stiffnesses and unmodelled effects from vibration recordings.

    import identify

    found = identify.contact("barrel.mcap", use="acceleration")
    print(found)
    print(found["contact_1"].clearance.interval)
    found.save("results")

`check` says what is wrong with a recording, `contact` finds clearance, stiffness and damping of every contact, `law`
the contact law as a formula, `gap` how the machine differs from its description, `compare` what changed between
recordings, `plan` what a test will tell before it is run. Each takes recordings or the names of their files (`plan` a
rig.json), and returns a result that prints as a short table (in a notebook too) and has `to_dict()` and `table()`; all
but `check` also have `save(folder)`, and all but `check` and `plan` `figure(name)`.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from identify.api import check, compare, contact, gap, law, plan
    from identify.contacts.identified_contact import EstimatedQuantity, IdentifiedContact
    from identify.pages.style import Picture
    from identify.planning.plan_result import PlanResult
    from identify.results import CheckResult, ContactResult, GapResult, HistoryResult, LawResult

_MODULES = {
    "CheckResult": "identify.results",
    "ContactResult": "identify.results",
    "EstimatedQuantity": "identify.contacts.identified_contact",
    "GapResult": "identify.results",
    "HistoryResult": "identify.results",
    "IdentifiedContact": "identify.contacts.identified_contact",
    "LawResult": "identify.results",
    "PlanResult": "identify.planning.plan_result",
    "Picture": "identify.pages.style",
    "check": "identify.api",
    "compare": "identify.api",
    "contact": "identify.api",
    "gap": "identify.api",
    "law": "identify.api",
    "plan": "identify.api",
}
"""Where each name is, loaded when it is first asked for (PEP 562)."""
__all__ = [
    "CheckResult",
    "ContactResult",
    "EstimatedQuantity",
    "GapResult",
    "HistoryResult",
    "IdentifiedContact",
    "LawResult",
    "Picture",
    "PlanResult",
    "check",
    "compare",
    "contact",
    "gap",
    "law",
    "plan",
]
__version__ = version("rig-identify")


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)
