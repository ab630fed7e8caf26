"""Supports of bodies as springs to the base; those without a stiffness are practically rigid."""

import numpy as np

from rig.errors import RigError
from rig.model.components import PointSpring, Support
from rig.model.description import Body, Rig

RIGID_SUPPORT_RATIO = 1e7
"""Static stiffness of a support that is not given, over that of its body there: its first twelve modes are those of a
rigid support within 1e-4."""


def springs_including_supports(rig: Rig) -> tuple[PointSpring, ...]:
    """Springs of a rig and its supports as springs.

    Raises RigError if a support stands where its body cannot move.
    """
    return (*rig.springs, *(_support_spring(rig.body(support.station.body), support) for support in rig.supports))


def _support_spring(body: Body, support: Support) -> PointSpring:
    stiffness = support.stiffness_n_per_m
    return PointSpring(
        station=support.station,
        stiffness_n_per_m=_rigid_support_n_per_m(body, support) if stiffness is None else stiffness,
    )


def _rigid_support_n_per_m(body: Body, support: Support) -> float:
    """Stiffness of a rigid support, N/m: RIGID_SUPPORT_RATIO / sum phi^2 / omega^2 over the elastic modes there."""
    omega = 2 * np.pi * body.frequencies_hz(body.max_modes)
    shapes = body.shapes(np.array([support.station.position_m]), body.max_modes)[0]
    compliance_m_per_n = float(np.sum(shapes[omega > 0] ** 2 / omega[omega > 0] ** 2))
    if not compliance_m_per_n * RIGID_SUPPORT_RATIO > np.finfo(float).tiny:
        raise RigError(
            f"a support stands at {support.station.position_m} m of {body.name!r}, which does not bend there; leave "
            "it out, or give stiffness_n_per_m"
        )
    return RIGID_SUPPORT_RATIO / compliance_m_per_n
