"""Masses: two with a bumper, a chain, a frame, one on a shaken base, one in a driven piston, one with friction."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, no_type_check

import numba
import numpy as np

from tests.campaigns.fifteen_rigs.bodies import masses_in_a_row, point_mass
from tests.campaigns.fifteen_rigs.field_rig import (
    ACCELERATION,
    DISPLACEMENT,
    NOISE,
    FieldRig,
    contact,
    import_map,
    sensors,
)
from tests.campaigns.fifteen_rigs.laboratory import (
    GROUND,
    MASS,
    Assembly,
    Grid,
    Instrument,
    Measured,
    TrueContact,
    built,
    gaussian,
    recorded,
    shaken_ground,
    through_instruments,
)
from tests.campaigns.fifteen_rigs.piecewise_linear import linear_rms_m
from tests.campaigns.fifteen_rigs.session import UserSession, write_record

GRID = Grid(1024.0, 30.0, 16)
FRICTION_N = 1.0


def excited(
    folder: Path,
    rng: np.random.Generator,
    assembly: Assembly,
    instruments: Sequence[Instrument],
    band_hz: tuple[float, float],
    clearances: float,
    grid: Grid = GRID,
) -> Sequence[TrueContact]:
    """Gaussian forces by which every contact, were it open, would move by so many of its clearances (rms) or more."""
    machine = assembly.machine()
    levels = []
    for number in range(len(assembly.forces)):
        moved = [
            linear_rms_m(machine, k, number, band_hz) / max(c.lower_m or 0.0, c.upper_m or 0.0)
            for k, c in enumerate(assembly.contacts)
        ]
        levels.append(clearances / min(moved))
    inputs = np.array([gaussian(level, band_hz, grid, rng) for level in levels])
    record = recorded(assembly, instruments, inputs, grid, rng)
    names = ("force",) if len(inputs) == 1 else tuple(f"force_{k + 1}" for k in range(len(inputs)))
    write_record(folder / "run.csv", record, grid.rate_hz, names)
    print(f"  {levels} N rms, closed {record.closed_share}", flush=True)
    return assembly.contacts


def shaken(
    folder: Path,
    rng: np.random.Generator,
    assembly: Assembly,
    instruments: Sequence[Instrument],
    band_hz: tuple[float, float],
    rms_m_per_s2: float,
    grid: Grid = GRID,
) -> Sequence[TrueContact]:
    ground = shaken_ground(rms_m_per_s2, band_hz, grid, rng)
    record = recorded(assembly, instruments, ground[1:], grid, rng, ground)
    write_record(folder / "run.csv", record, grid.rate_hz, ())
    print(f"  {rms_m_per_s2} m/s2 rms, closed {record.closed_share}", flush=True)
    return assembly.contacts


def two_masses(folder: Path, rng: np.random.Generator) -> Sequence[TrueContact]:
    bodies = {"first": built(point_mass(1.5, 6.0, 0.01), rng), "second": built(point_mass(2.5, 9.0, 0.01), rng)}
    bumper = contact("contact_1", ("first", 0.0), rng, 5e-4, 2e4, 5.0, ("second", 0.0), "upper")
    places = [("first", 0.0), ("second", 0.0)]
    assembly = Assembly(bodies, [bumper], [("first", 0.0)])
    return excited(folder, rng, assembly, sensors(places, f"{ACCELERATION},{DISPLACEMENT}"), (2.0, 40.0), 3.0)


def describe_two_masses(session: UserSession) -> None:
    session.run(
        "rig init two_masses --masses-kg 1.5,2.5 --frequencies-hz 6,9 --stops upper --clearance-m 5e-4 "
        f"--stiffness-n-per-m 2e4 --sample-rate-hz 1024 --quantity {ACCELERATION},{DISPLACEMENT} --out lab --force"
    )
    import_map(session)


def chain(folder: Path, rng: np.random.Generator) -> Sequence[TrueContact]:
    body = built(masses_in_a_row([3.0, 2.0, 1.0], [4e4, 3e4, 2e4], 0.01), rng)
    stop = contact("contact_1", ("chain", 3.0), rng, 3e-4, 1e5, 10.0, ("chain", 2.0))
    places = [("chain", k) for k in (1.0, 2.0, 3.0)]
    return excited(
        folder, rng, Assembly({"chain": body}, [stop], [places[2]]), sensors(places, ACCELERATION), (2.0, 60.0), 3.0
    )


def describe_chain(session: UserSession) -> None:
    session.run(
        "rig init chain --masses-kg 3,2,1 --springs-n-per-m 4e4,3e4,2e4 --contacts 3-2 --clearance-m 3e-4 "
        f"--stiffness-n-per-m 1e5 --noise-density {NOISE[ACCELERATION]} --sample-rate-hz 1024 --out lab --force"
    )
    import_map(session)


def frame(folder: Path, rng: np.random.Generator) -> Sequence[TrueContact]:
    body = built(masses_in_a_row([6.5] * 4, [5e5] * 4, 0.01), rng)
    bumper = contact("contact_1", ("chain", 3.0), rng, 1e-4, 1e6, 50.0, ("chain", 2.0), "upper")
    places = [("chain", float(k)) for k in (1, 2, 3, 4)]
    assembly = Assembly({"chain": body}, [bumper], [places[3]])
    return excited(folder, rng, assembly, sensors(places, f"{ACCELERATION},{DISPLACEMENT}"), (3.0, 100.0), 3.0)


def describe_frame(session: UserSession) -> None:
    session.run(
        "rig init chain --masses-kg 6.5,6.5,6.5,6.5 --springs-n-per-m 5e5 --contacts 3-2 --stops upper "
        "--clearance-m 1e-4 --stiffness-n-per-m 1e6 --sample-rate-hz 1024 "
        f"--quantity {ACCELERATION},{DISPLACEMENT} --out lab --force"
    )
    import_map(session)


def ground_sensor(quantity: str) -> Instrument:
    return Instrument(f"table_{quantity}", GROUND, 0.0, quantity, NOISE[quantity])


def on_the_ground(rig: dict[str, Any], quantity: str) -> None:
    """As rig/recording/README.md has it: a sensor on the ground, and no force."""
    rig["sensors"].append({"name": f"table_{quantity}", "station": "ground", "quantity": quantity})
    rig.pop("force_at", None)


def shaken_mass(folder: Path, rng: np.random.Generator) -> Sequence[TrueContact]:
    stops = contact("contact_1", ("mass", 0.0), rng, 5e-4, 4e4, 4.0)
    assert stops.lower_m is not None
    assert stops.upper_m is not None
    unequal = TrueContact("contact_1", stops.at, None, 0.7 * stops.lower_m, 1.3 * stops.upper_m, *_law(stops))
    assembly = Assembly({"mass": built(point_mass(2.0, 12.0, 0.02), rng)}, [unequal])
    places = [*sensors([("mass", 0.0)], ACCELERATION), ground_sensor(ACCELERATION)]
    return shaken(folder, rng, assembly, places, (4.0, 40.0), 3.0)


def describe_shaken_mass(session: UserSession) -> None:
    session.run(
        "rig init mass --mass-kg 2 --frequency-hz 12 --damping-ratio 0.02 --clearance-m 5e-4 --stiffness-n-per-m 4e4 "
        f"--noise-density {NOISE[ACCELERATION]} --sample-rate-hz 1024 --out lab --force"
    )
    session.edit_rig("lab/rig.json", lambda rig: on_the_ground(rig, ACCELERATION))
    import_map(session)


def piston(folder: Path, rng: np.random.Generator) -> Sequence[TrueContact]:
    stops = contact("contact_1", ("mass", 0.0), rng, 1e-3, 5e4, 20.0)
    assembly = Assembly({"mass": built(point_mass(0.8, 0.0, 0.0), rng)}, [stops])
    places = [*sensors([("mass", 0.0)], f"{ACCELERATION},{DISPLACEMENT}"), ground_sensor(DISPLACEMENT)]
    return shaken(folder, rng, assembly, places, (2.0, 20.0), 4.0)


def describe_piston(session: UserSession) -> None:
    session.run(
        "rig init mass --mass-kg 0.8 --frequency-hz 0 --clearance-m 1e-3 --stiffness-n-per-m 5e4 "
        f"--quantity {ACCELERATION},{DISPLACEMENT} --sample-rate-hz 1024 --out lab --force"
    )
    session.edit_rig("lab/rig.json", lambda rig: on_the_ground(rig, DISPLACEMENT))
    import_map(session)


def _law(stops: TrueContact) -> tuple[float, float]:
    return stops.stiffness_n_per_m, stops.damping_n_s_per_m


def friction_mass(folder: Path, rng: np.random.Generator) -> Sequence[TrueContact]:
    stops = contact("contact_1", ("mass", 0.0), rng, 1e-3, 2e4, 5.0)
    mass_kg = 2.0 * (1 + MASS * rng.standard_normal())
    grid = Grid(1024.0, 30.0, 64)
    force = gaussian(5.0, (1.0, 20.0), grid, rng)
    assert stops.lower_m is not None
    assert stops.upper_m is not None
    x, a = sliding_mass(mass_kg, FRICTION_N, stops.lower_m, stops.upper_m, *_law(stops), force, grid.step_s)
    instruments = sensors([("mass", 0.0)], f"{ACCELERATION},{DISPLACEMENT}")
    columns = through_instruments(instruments, np.array([a, x]), grid, rng)
    cell = Instrument("force", "mass", 0.0, "force", 2e-4)
    (measured,) = through_instruments([cell], force[None], grid, rng).values()
    write_record(folder / "run.csv", Measured(measured[None], columns, {}), grid.rate_hz)
    return [stops]


@numba.njit(cache=True)
@no_type_check
def sliding_mass(mass_kg, friction_n, lower_m, upper_m, stiffness, damping, force, h):
    """m x'' = F - F_c sign(x') - f(x, x') by semi-implicit Euler; at rest where less than F_c pulls."""
    x, v = 0.0, 0.0
    out = np.zeros((2, force.size))
    for n in range(force.size):
        depth = max(x - upper_m, 0.0) + min(x + lower_m, 0.0)
        pull = force[n] - stiffness * depth - (damping * v if depth != 0.0 else 0.0)
        free = v + h * pull / mass_kg
        slowed = h * friction_n / mass_kg
        after = free - slowed if free > slowed else free + slowed if free < -slowed else 0.0
        out[0, n], out[1, n] = x, (after - v) / h
        x += h * after
        v = after
    return out


def describe_friction_mass(session: UserSession) -> None:
    session.run(
        "rig init mass --mass-kg 2 --frequency-hz 0 --clearance-m 1e-3 --stiffness-n-per-m 2e4 "
        f"--quantity {ACCELERATION},{DISPLACEMENT} --sample-rate-hz 1024 --out lab --force"
    )
    import_map(session)


RIGS = {
    "two_masses": FieldRig(two_masses, describe_two_masses),
    "chain": FieldRig(chain, describe_chain),
    "frame": FieldRig(frame, describe_frame),
    "shaken_mass": FieldRig(shaken_mass, describe_shaken_mass),
    "piston": FieldRig(piston, describe_piston),
    "friction_mass": FieldRig(friction_mass, describe_friction_mass),
}
