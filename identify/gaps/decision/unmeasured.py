"""What acts unmeasured: how likely a record is with it, and how gap.json tells it."""

from dataclasses import replace

from identify.gaps.residual.likelihood import Misfit, Reference, misfit
from identify.gaps.residual.spectra import Record
from identify.gaps.results import Matters, MeanForce, Unknown
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.unknown import Sought, UnknownForce
from identify.gaps.unknown import sentence as described
from identify.gaps.unknown.play import Breathing
from identify.linear.joined import joined
from rig.model.description import Rig


def cost_with(record: Record, reference: Reference, rig: Rig, found: Sought, alone: Misfit) -> float:
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
    rig: Rig, found: UnknownForce | None, swinging: Breathing | None, left: Misfit, matters: Matters
) -> Unknown | None:
    """The force, or the clearance that swings: what explains more of the gap, in units of what matters.

    A force explains a share of what is left of the motion, a swinging clearance of what is left of its contact's force.
    """
    force = found.validation_explained_share * left.share / matters.motion if found else 0.0
    contacts = {c.name: c for c in joined(rig).contacts}
    shares = dict(zip(contacts, left.contact_shares, strict=True))
    if swinging and swinging.share * shares[swinging.contact] / matters.contact > force:
        contact = contacts[swinging.contact]
        return Unknown(
            sentence=swinging.sentence,
            kind="contact",
            body=contact.at.body,
            position_m=contact.at.position_m,
            position_error_m=0.0,
            against_body=contact.against.body if contact.against else None,
            against_position_m=contact.against.position_m if contact.against else None,
            sensor=None,
            contact=swinging.contact,
            frequency_hz=swinging.frequency_hz,
            band_hz=(swinging.frequency_hz, swinging.frequency_hz),
            rms_n=0.0,
            when="always",
            against="none",
            law=f"{1e3 * swinging.amplitude_m:.3g} mm at {swinging.frequency_hz:.4g} Hz",
            explained=swinging.share,
        )
    if found is None:
        return None
    at_place = found.kind in ("force", "pair")
    seen = found.surface
    return Unknown(
        sentence=described(found),
        kind=found.kind,
        body=found.body or None,
        position_m=found.position_m.value if at_place else None,
        position_error_m=found.position_m.standard_error if at_place else None,
        against_body=found.against_body or None,
        against_position_m=found.against_position_m if found.against_body else None,
        sensor=found.sensor or None,
        growth=dict(zip(found.bodies, found.growth, strict=True)),
        same_place=found.same_place,
        frequency_hz=found.frequency_hz,
        band_hz=found.band_hz,
        rms_n=found.rms.value,
        amplitude_n=found.amplitude_n,
        when=found.when,
        before_excitation=found.before_excitation,
        by_time=found.by_time,
        against=found.against,
        law=found.law,
        explained=found.validation_explained_share,
        over_motion=MeanForce(seen.eta_m, seen.rate_m_per_s, seen.share) if seen else None,
        spectrum_hz=found.spectrum_hz,
        spectrum=found.spectrum,
    )
