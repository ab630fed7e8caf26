"""The ancf plant against the same model set up the plain way, and what each measure contributes.

Plain: full Newton, Exudyn's dense linear solver, a Python function for the contact, the axial stiffness as it is.
Exudyn's own settings are that with modified Newton. Newton's tolerances are loosened as far as rounding of the axial
forces asks: with Exudyn's own (1e-8, 1e-10 N) the plain model ends in an error. The barrel in its cradle at a hundredth
of the amplitude, both at a step of 2^-13 s; error: of the displacements over the first 0.1 s of contact, against the
plant at 2^-16 s.
"""

import time
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from typing import Any, no_type_check
from unittest.mock import patch

import numpy as np

from rig.model.contact_laws import DeadZone
from rig.simulation.excitation import QUIET_S, force_history
from rig.simulation.motion import Motion, concatenated
from rig.simulation.plants import ancf, finite_elements
from rig.simulation.reference import BarrelCradle
from tests.benchmarks.measuring import Figure

SMALL = 0.01
SETTINGS = BarrelCradle(sensors="displacement", clearance_1_m=SMALL * 5e-3, clearance_2_m=SMALL * 5e-3)
POWER, FINE, DURATION_S, YOUNG_S = 13, 16, 0.375, 0.1


def figures() -> Iterator[Figure]:
    true, _ = _run(FINE, {})
    own, own_s = min((_run(POWER, {}) for _ in range(3)), key=lambda run: run[1])
    plain, plain_s = _run(POWER, PLAIN)
    yield Figure("error of the plant", _error(own, true))
    yield Figure("error of the plain model", _error(plain, true))
    yield Figure("simulated s per CPU s", DURATION_S / own_s)
    for measure, changes in MEASURES.items():
        yield Figure(f"times faster than plain by this alone: {measure}", plain_s / _run(POWER, PLAIN | changes)[1])
    yield Figure("times faster than the plain model", plain_s / own_s, at_least=4)
    stock_s = min(_run(POWER, PLAIN | MEASURES["modified Newton"])[1] for _ in range(2))
    yield Figure("times faster than with Exudyn's own settings", stock_s / own_s)


def _run(power: int, changed: dict[str, Any]) -> tuple[Motion, float]:
    """The motion, and the CPU seconds of its steps alone: building the model is left out."""
    step_s = 2.0**-power
    force_n = force_history(SETTINGS.force(), QUIET_S + DURATION_S, 2.0**-FINE)[round(QUIET_S * 2**FINE) :]
    spent, advance = 0.0, ancf._advance

    def timed(*arguments: Any) -> None:
        nonlocal spent
        begin = time.process_time()
        advance(*arguments)
        spent += time.process_time() - begin

    with ExitStack() as changes:
        changes.enter_context(patch.object(ancf, "_advance", timed))
        for name, value in changed.items():
            changes.enter_context(patch.object(WHERE[name], name, value))
        blocks = ancf.simulate(SETTINGS.rig(), SMALL * force_n[:: 2 ** (FINE - power)], step_s, lambda _: None)
        return concatenated(blocks), spent


def _error(motion: Motion, true: Motion) -> float:
    first = int(np.argmax(true.contact_force_n.any(axis=0)))
    every = round(motion.step_s / true.step_s)
    young = slice(first // every, first // every + round(YOUNG_S / motion.step_s))
    expected = true.displacement_m[:, ::every][:, young]
    return float(np.linalg.norm(motion.displacement_m[:, young] - expected) / np.linalg.norm(expected))


def _plain_settings(exu: Any, _: Any, step_s: float, modified: bool = False, sparse: bool = False) -> Any:
    settings = exu.SimulationSettings()
    integration = settings.timeIntegration
    integration.verboseMode = 0
    integration.newton.relativeTolerance = 1e-5
    integration.newton.absoluteTolerance = 1e-4
    integration.newton.useModifiedNewton = modified
    if sparse:
        settings.linearSolverType = exu.LinearSolverType.EigenSparse
    settings.solutionSettings.writeSolutionToFile = False
    settings.solutionSettings.sensorsWritePeriod = step_s
    return settings


def _python_contact(_: Any, mbs: Any, against: int, at: int, law: DeadZone) -> int:
    from exudyn.itemInterface import CoordinateSpringDamper

    lower, upper, stiffness = law.lower_clearance_m, law.upper_clearance_m, law.stiffness_n_per_m

    @no_type_check
    def force(_system, _t, _number, eta, _rate, _k, _c, _offset):
        return stiffness * (max(eta - upper, 0.0) + min(eta + lower, 0.0))

    return int(
        mbs.AddObject(
            CoordinateSpringDamper(
                markerNumbers=[against, at], stiffness=stiffness, damping=0.0, springForceUserFunction=force
            )
        )
    )


WHERE = {"_solver_settings": ancf, "add_contact": finite_elements, "AXIAL_STIFFNESS_FACTOR": finite_elements}
"""The module that reads each name."""
PLAIN = {"_solver_settings": _plain_settings, "add_contact": _python_contact, "AXIAL_STIFFNESS_FACTOR": 1.0}
MEASURES = {
    "modified Newton": {"_solver_settings": partial(_plain_settings, modified=True)},
    "sparse linear solver": {"_solver_settings": partial(_plain_settings, sparse=True)},
    "both": {"_solver_settings": partial(_plain_settings, modified=True, sparse=True)},
    "contact compiled": {"add_contact": finite_elements.add_contact},
    "softer axially": {"AXIAL_STIFFNESS_FACTOR": finite_elements.AXIAL_STIFFNESS_FACTOR},
}
