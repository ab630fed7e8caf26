"""Report of an identification, made of the results of its steps."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from identify.checks.findings import Finding
from identify.contacts import results
from identify.contacts.determination import Outcomes
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.paper_methods import PaperMethods
from identify.contacts.refusals import Refusal
from identify.linear.modal import NEARLY_INVISIBLE, Transformation
from identify.pages.wording import COVERED
from identify.paper.nifo import Nifo, fitted_mode
from identify.paper.surface import Stops
from identify.signals.noise import noise_source
from rig.model.description import Rig, contact_stations

MOST_OPEN_TO_DOUBT = 0.05
"""A share of time whose 95 % interval reaches further is not told."""


def contact_report(
    rig: Rig, outcomes: Outcomes, methods: PaperMethods, findings: tuple[Finding, ...] = ()
) -> results.ContactReport:
    """The report: the answers, and what the paper's methods say beside them."""
    motion = methods.motion
    eta_m = {contact.name: row for contact, row in zip(rig.contacts, methods.eta_m, strict=True)}
    return results.ContactReport(
        rig=rig.name,
        contacts=tuple(_contact(name, estimate, eta_m[name]) for name, estimate in outcomes.estimates.items()),
        unanswered=unanswered(outcomes.refusals),
        main_equation=methods.main_equation,
        modes=_modes(rig, methods.spectra, outcomes.refusals),
        nifo=tuple(_nifo_result(rig, n) for n in methods.spectra),
        surface=results.Surfaces(
            tuple(results.SurfaceResult(s.equation.name, _clearances(rig, s.stops)) for s in methods.surfaces),
            _clearances(rig, methods.histogram),
        ),
        transformation=tuple(_transformation_result(t) for t in methods.transformations),
        trusted_hz=motion.trusted_hz,
        channels_used=(*rig.force_names, *motion.channels),
        findings=findings,
        noise_from=noise_source(motion, rig),
        notes=methods.notes,
    )


def unanswered(refusals: Mapping[str, Refusal]) -> tuple[results.Unanswered, ...]:
    """Refusals as the reports have them."""
    return tuple(
        results.Unanswered(name, refusal.sentence, refusal.code, refusal.remedy, dict(refusal.evidence))
        for name, refusal in refusals.items()
    )


def closed_share(found: JointEstimate, eta_m: Float[np.ndarray, " samples"]) -> float | None:
    """Share of the samples beyond the stops that are touched. None where moving each stop by its 95 % interval in and
    out makes too much of it.
    """
    lower, upper = found.touched
    (at_lower, at_upper, *_), (of_lower, of_upper, *_) = found.values, found.errors

    def share(out: float) -> float:
        below = lower & (eta_m < -at_lower - out * of_lower)
        return float(np.mean(below | (upper & (eta_m > at_upper + out * of_upper))))

    return share(0.0) if share(-COVERED) - share(COVERED) < 2 * MOST_OPEN_TO_DOUBT else None


def _contact(name: str, found: JointEstimate, eta_m: Float[np.ndarray, " samples"]) -> results.ContactEstimate:
    lower, upper, stiffness, damping, clearance = (
        results.Estimate(float(of @ found.values), found.error(of), found.own_error(of))
        for of in (*np.eye(len(found.values)), found.clearance)
    )
    return results.ContactEstimate(
        name=name,
        clearance_m=clearance,
        stiffness_n_per_m=stiffness,
        damping_n_s_per_m=damping,
        lower_clearance_m=lower if found.sides_known and found.touched[0] else None,
        upper_clearance_m=upper if found.sides_known and found.touched[1] else None,
        closed_share=closed_share(found, eta_m),
        law=found.form.name,
        exponent=results.Estimate(found.exponent, found.exponent_error) if found.form.shapes else None,
        reference_depth_m=found.form.reference_depth_m if found.form.shapes else None,
    )


def _modes(rig: Rig, spectra: Sequence[Nifo], refusals: Mapping[str, Refusal]) -> tuple[results.Mode, ...]:
    """The elastic modes within the band."""
    inside = [n for n in spectra if 0 < n.equation.frequency_hz < n.frequency_hz[-1]]
    silent = [c for c in rig.contacts if c.name in refusals]

    def mode(found: Nifo) -> results.Mode:
        body = found.equation.body
        acting = tuple(c.name for c in silent if body in {s.body for s in contact_stations(c)})
        return results.Mode(body, found.equation.index, *fitted_mode(found), acting)

    return tuple(mode(found) for found in inside)


def _nifo_result(rig: Rig, found: Nifo) -> results.NifoResult:
    stiffness = tuple(
        results.Stiffness(rig.contacts[j].name, results.Estimate(float(mean), float(error)), float(deviation))
        for j, mean, error, deviation in zip(
            found.contacts, found.mean_n_per_m, found.stiffness_error_n_per_m, found.deviation_n_per_m, strict=True
        )
    )
    hidden = tuple(
        c.name for c, share in zip(rig.contacts, found.equation.visibility, strict=True) if share < NEARLY_INVISIBLE
    )
    band = (float(found.frequency_hz[0]), float(found.frequency_hz[-1]))
    return results.NifoResult(found.equation.name, band, found.resolution_hz, found.averages, stiffness, hidden)


def _clearances(rig: Rig, stops: Sequence[Stops | None]) -> tuple[results.Clearance, ...]:
    return tuple(
        results.Clearance(c.name, results.Estimate(s.clearance_m, s.clearance_error_m))
        for c, s in zip(rig.contacts, stops, strict=True)
        if s is not None
    )


def _transformation_result(found: Transformation) -> results.TransformationResult:
    modes, stations = found.inverse.shape
    return results.TransformationResult(
        found.body.name, stations, modes, found.condition, tuple(float(x) for x in found.lost)
    )
