"""The rig with its contacts as a record showed them: what `identify contact` writes as rig.json."""

import numpy as np
from msgspec.structs import replace

from identify.contacts.law_form import EXPONENTS
from identify.contacts.results import ContactEstimate, ContactReport
from rig.model.contact_laws import AnyLaw, DeadZone
from rig.model.description import Rig


def identified_rig(rig: Rig, report: ContactReport) -> Rig:
    """Clearance, stiffness, damping and exponent of every contact that was identified; all else, and the others, as
    believed.

    A clearance of which only half the total play is known is laid about the believed middle of the gap.
    """
    found = {c.name: c for c in report.contacts}
    contacts = tuple(replace(c, law=_law(c.law, found[c.name])) if c.name in found else c for c in rig.contacts)
    return replace(rig, contacts=contacts)


def _law(law: AnyLaw, found: ContactEstimate) -> AnyLaw:
    lower, upper = law.lower_clearance_m, law.upper_clearance_m
    if found.lower_clearance_m is None and found.upper_clearance_m is None:
        off_centre = (upper - lower) / 2
        lower, upper = found.clearance_m.value - off_centre, found.clearance_m.value + off_centre
    if found.lower_clearance_m is not None:
        lower = found.lower_clearance_m.value
    if found.upper_clearance_m is not None:
        upper = found.upper_clearance_m.value
    if isinstance(law, DeadZone):
        exponent = 1.0 if found.exponent is None else float(np.clip(found.exponent.value, *EXPONENTS))
        depth_m = found.reference_depth_m or law.reference_depth_m
        law = replace(law, exponent=exponent, reference_depth_m=depth_m, pulls=found.law != "cannot pull")
    return replace(
        law,
        lower_clearance_m=max(0.0, lower),
        upper_clearance_m=max(0.0, upper),
        stiffness_n_per_m=max(0.0, found.stiffness_n_per_m.value),
        damping_n_s_per_m=max(0.0, found.damping_n_s_per_m.value),  # an estimate may lie below zero
    )
