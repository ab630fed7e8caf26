"""Records without a force: a free decay after a release or an unmeasured blow, which is over when the record begins."""

from collections.abc import Sequence

import numpy as np

from identify.checks.findings import Finding
from identify.contacts.joint import Joint
from identify.signals.kinematics import Kinematics
from identify.signals.spectra import force_band
from rig.errors import RigError

MOST_UNEXPLAINED = 0.03
"""Of a contact's force: in a free decay less is left, where a force acts that was not recorded more."""


def is_unforced(motion: Kinematics) -> bool:
    return not np.any(motion.forces_n)


def driven_to_hz(motion: Kinematics) -> float:
    """Up to where the rig is excited: by the force or, without one, as far as its displacements vibrate.

    Raises RigError if neither a force nor a motion was recorded.
    """
    rows = [row for row in (motion.displacement_m if is_unforced(motion) else motion.forces_n) if np.any(row)]
    if not rows:
        raise RigError("the force and all sensors are zero throughout; look at their channels")
    return max(force_band(row, motion.sample_rate_hz)[1] for row in rows)


def free_fits(contacts: Sequence[str], fits: Sequence[Joint | str]) -> tuple[Joint | str, ...]:
    """The fits of a record without a force; reasons why there are none say that a force may be missing.

    Raises RigError if the contacts' forces do not follow from the motion: then other forces acted.
    """
    for name, fit in zip(contacts, fits, strict=True):
        if isinstance(fit, Joint) and fit.unexplained > MOST_UNEXPLAINED:
            raise RigError(
                f"the exciting force is zero throughout, and this is no free decay: {100 * fit.unexplained:.2g} % of "
                f"{name}'s force follow from no clearance and stiffness; record the force that moves the rig (a base "
                "that shakes moves it, too), or let the record begin when the rig has been released"
            )
    reason = "the exciting force is zero throughout: unless this is a free decay, record it; "
    return tuple(fit if isinstance(fit, Joint) else reason + fit for fit in fits)


def without_dead_force(findings: Sequence[Finding], forces: Sequence[str]) -> tuple[Finding, ...]:
    """The findings without those of force channels at zero, which a free decay explains."""
    return tuple(f for f in findings if f.cause != "dead" or not set(f.channels) <= set(forces))
