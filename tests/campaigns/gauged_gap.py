"""Diagnosis of two beams with four accelerometers and six strain gauges, simulated as in `fifteen_rigs`, beside that of
their accelerometers alone: python -m tests.campaigns.gauged_gap --out out/gauged_gap."""

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from msgspec.structs import replace as with_fields
from scipy.linalg import eigh

import identify
from identify.gaps.results import Gap
from rig.model.description import Rig, Sensor, Station
from rig.recording import Recording, Signals, channel_groups
from rig.simulation.reference import BarrelCradle
from tests.campaigns.fifteen_rigs.bodies import ModalBody, uniform_beam
from tests.campaigns.fifteen_rigs.field_rig import ACCELERATION, NOISE, STRAIN
from tests.campaigns.fifteen_rigs.laboratory import Assembly, Grid, Instrument, TrueContact, built, gaussian, recorded
from tests.campaigns.fifteen_rigs.rigs_pairs import BAND_HZ, GAUGES, MODES, RATIO, REFERENCE, stations
from tests.campaigns.fifteen_rigs.session import COVERED

GRID = Grid(2048.0, 15.0, 16)
FORCE_RMS_N = 14.0
FIBRE_M, CLEARANCE_M, STIFFNESS_N_PER_M = 0.005, 5e-3, 1e5
CLEARANCE_TOLERANCE, STIFFNESS_TOLERANCE, DAMPING_TOLERANCE_S = 0.01, 0.01, 1e-5
MASS_KG, MASS_AT_M, STIFFNESS_FACTOR, GAUGE_GAIN = 0.15, 0.8, 1.4, 1.1
WRONG_GAUGE = f"barrel_0500mm_{STRAIN}"
TRUE_VALUES = {
    "none": {},
    "added_mass": {"added_mass.mass_kg": MASS_KG, "added_mass.relative_position": MASS_AT_M},
    "contact_stiffness": {"contact_stiffness.factor": STIFFNESS_FACTOR},
    "sensor_gain": {"sensor_gain.factor": GAUGE_GAIN},
}
ACCELEROMETERS = stations((0.45, 1.0), (0.0, 0.55))


def instrument(body: str, position_m: float, quantity: str) -> Instrument:
    name = f"{body}_{1e3 * position_m:04.0f}mm_{quantity}"
    return Instrument(name, body, position_m, quantity, NOISE[quantity], FIBRE_M if quantity == STRAIN else 0.0)


INSTRUMENTS = [*(instrument(*at, ACCELERATION) for at in ACCELEROMETERS), *(instrument(*at, STRAIN) for at in GAUGES)]


def nominal_rig(with_gauges: bool) -> Rig:
    sensors = tuple(
        Sensor(name=s.name, station=Station(s.body, s.position_m), quantity=s.quantity, noise_density=s.noise_density)
        for s in INSTRUMENTS
        if with_gauges or s.quantity != STRAIN
    )
    rig = BarrelCradle(sample_rate_hz=GRID.rate_hz).rig()
    return with_fields(rig, name="gauged" if with_gauges else "accelerometers", sensors=sensors)


def with_mass(body: ModalBody, mass_kg: float, position_m: float) -> ModalBody:
    """Body with a mass at a place: modes of (I + m phi phi^T, diag omega^2)."""
    shape, curvatures = body.shapes(position_m), body.curvatures
    assert curvatures is not None
    inertia = np.eye(shape.size) + mass_kg * np.outer(shape, shape)
    squares, vectors = eigh(np.diag((2 * np.pi * body.frequencies_hz) ** 2), inertia)
    rigid = np.arange(shape.size) < np.count_nonzero(body.frequencies_hz == 0)
    return replace(
        body,
        frequencies_hz=np.where(rigid, 0.0, np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)),
        shapes=lambda x: body.shapes(x) @ vectors,
        curvatures=lambda x: curvatures(x) @ vectors,
        participations=None,
    )


def machine(effect: str, rng: np.random.Generator) -> Assembly:
    """Machine off by its tolerances, with an effect or "none"."""
    cradle, barrel = (built(uniform_beam(1.0, REFERENCE, MODES, RATIO, c), rng) for c in (True, False))
    if effect == "added_mass":
        barrel = with_mass(barrel, MASS_KG, MASS_AT_M)
    contacts = []
    for name, on_barrel_m, on_cradle_m in (("contact_1", 0.0, 0.45), ("contact_2", 0.55, 1.0)):
        clearance_m = CLEARANCE_M * (1 + CLEARANCE_TOLERANCE * rng.standard_normal())
        stiffness = STIFFNESS_N_PER_M * (1 + STIFFNESS_TOLERANCE * rng.standard_normal())
        if effect == "contact_stiffness" and name == "contact_1":
            stiffness = STIFFNESS_N_PER_M * STIFFNESS_FACTOR
        damping = DAMPING_TOLERANCE_S * stiffness * abs(rng.standard_normal())
        places = ("barrel", on_barrel_m), ("cradle", on_cradle_m)
        contacts.append(TrueContact(name, *places, clearance_m, clearance_m, stiffness, damping))
    lengths = {"cradle": 1.0, "barrel": 1.0}
    return Assembly({"cradle": cradle, "barrel": barrel}, contacts, [("barrel", 1.0)], lengths)


def recordings(effect: str, seed: int, rig: Rig) -> list[Recording]:
    """Two recordings of one machine through the same sensors under two forces."""
    assembly, records = machine(effect, np.random.default_rng([seed, 1])), []
    for force_seed in (2, 3):
        force_n = gaussian(FORCE_RMS_N, BAND_HZ, GRID, np.random.default_rng([seed, force_seed]))
        measured = recorded(assembly, INSTRUMENTS, force_n[None], GRID, np.random.default_rng([seed, 4]))
        columns, groups = dict(measured.columns), channel_groups(rig)
        if effect == "sensor_gain":
            columns[WRONG_GAUGE] = GAUGE_GAIN * columns[WRONG_GAUGE]
        signals = {"force": Signals(groups["force"], 0.0, measured.forces_n)}
        for quantity in groups.keys() - {"force"}:
            values = np.array([columns[name] for name in groups[quantity].names])
            signals[quantity] = Signals(groups[quantity], 0.0, values)
        records.append(Recording(rig, signals, {}))
    return records


def named_values(report: Gap, effect: str) -> Iterator[str]:
    """Numbers of the named effects with half their 95 % intervals, beside what is true."""
    if not report.criteria.named:
        return
    cause = report.causes[0]
    for name, estimate in cause.parameters.items():
        true = TRUE_VALUES[effect].get(name)
        half = COVERED * estimate.standard_error
        yield f"{', '.join(cause.effects)}: {name} {estimate.value:.4g} +- {half:.2g} (true: {true})"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns.gauged_gap", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/gauged_gap"))
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--effects", nargs="+", choices=list(TRUE_VALUES), default=list(TRUE_VALUES))
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    for effect in asked.effects:
        for seed in asked.seeds:
            for with_gauges in (True, False):
                if effect == "sensor_gain" and not with_gauges:
                    continue  # the same recordings as without an effect
                begin, rig = time.monotonic(), nominal_rig(with_gauges)
                answer = identify.gap(recordings(effect, seed, rig), null_reference=asked.out)
                answer.save(asked.out / f"{effect}_{seed}_{rig.name}")
                seconds = time.monotonic() - begin
                print(f"{effect} {seed} {rig.name}: {answer.report.verdict}, {seconds:.0f} s", flush=True)
                for line in named_values(answer.report, effect):
                    print(f"    {line}", flush=True)


if __name__ == "__main__":
    main()
