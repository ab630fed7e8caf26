"""What acts unmeasured: how likely a record is with it, and how gap.json tells it."""

from dataclasses import replace

from identify.gaps.residual.likelihood import Misfit, Reference, misfit
from identify.gaps.residual.spectra import Record
from identify.gaps.results import Matters
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.unmeasured_force import UnmeasuredForceFit
from identify.gaps.unmeasured_force.clearance_modulation import ClearanceModulation
from identify.linear.joined import joined
from rig.model.description import Rig
from rig.model.unmeasured_force import UnmeasuredForce


def cost_with(record: Record, reference: Reference, rig: Rig, found: UnmeasuredForceFit, alone: Misfit) -> float:
    """-2 ln p of a validation record with an unmeasured force beside a rig, which alone leaves `alone`.

    The force is taken off what the sensors delivered, and the rig fitted to the rest like any other. Its time history
    is free to follow one direction of the residual's many: there nothing is gained. Nor is it where the records do not
    show the same.
    """
    if not found.same_place:
        return alone.minus_two_log
    cleared = replace(record, delivered=record.delivered - found.delivered())
    left = misfit(cleared, reference, fit_nuisance(cleared, rig, rounds=1)[1])
    followed = found.directions / found.held.observed.rows
    return left.minus_two_log + followed * (alone.linear + alone.sharp - left.linear - left.sharp)


def unmeasured(
    rig: Rig,
    force: UnmeasuredForce | None,
    modulation: ClearanceModulation | None,
    left: Misfit,
    matters: Matters,
) -> UnmeasuredForce | None:
    """The force, or the clearance that swings: what explains more of the gap, in units of what matters.

    A force explains a share of what is left of the motion, a swinging clearance of what is left of its contact's force.
    """
    if modulation is None:
        return force
    contacts = {c.name: c for c in joined(rig).contacts}
    share = dict(zip(contacts, left.contact_shares, strict=True))[modulation.contact]
    by_force = force.explained * left.share / matters.motion if force else 0.0
    if modulation.share * share / matters.contact > by_force:
        return modulation.described(contacts[modulation.contact])
    return force
