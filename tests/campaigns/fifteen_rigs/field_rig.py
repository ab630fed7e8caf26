"""What a rig of the campaign is: how it is measured, and how its owner describes it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.campaigns.fifteen_rigs.laboratory import Instrument, TrueContact
from tests.campaigns.fifteen_rigs.session import UserSession

ACCELERATION, DISPLACEMENT, STRAIN = "acceleration", "displacement", "strain"
NOISE = {ACCELERATION: 1e-3, DISPLACEMENT: 1e-8, STRAIN: 1e-9}
"""One-sided densities of the sensors, in their units per sqrt(Hz)."""
TAIL = "rig import run.csv --map lab/run.toml --out run.mcap --force"


@dataclass(frozen=True)
class FieldRig:
    """measure writes run.csv into the folder and returns what is true; describe makes lab/rig.json and lab/run.toml.

    remedy: options of a second `identify contact`, where the first one has findings or refuses a contact.
    """

    measure: Callable[[Path, np.random.Generator], Sequence[TrueContact]]
    describe: Callable[[UserSession], None]
    remedy: str = ""


def around(value: float, rng: np.random.Generator, share: float = 0.2) -> float:
    """What its owner believes to be `value`."""
    return value * rng.uniform(1 - share, 1 + share)


def contact(
    name: str,
    at: tuple[str, float],
    rng: np.random.Generator,
    clearance_m: float,
    stiffness_n_per_m: float,
    damping_n_s_per_m: float,
    against: tuple[str, float] | None = None,
    stops: str = "both",
) -> TrueContact:
    """A contact whose clearance is off the belief by up to 20 %, stiffness and damping by up to 40 %; the stops of a
    pair are unlike by up to 5 %."""
    d = around(clearance_m, rng)
    sides = [d * rng.uniform(0.975, 1.025) for _ in range(2)]
    return TrueContact(
        name,
        at,
        against,
        None if stops == "upper" else sides[0],
        None if stops == "lower" else sides[1],
        around(stiffness_n_per_m, rng, 0.4),
        around(damping_n_s_per_m, rng, 0.4),
    )


def sensors(places: Sequence[tuple[str, float]], quantities: str) -> list[Instrument]:
    """One of every quantity at each place, named as `rig init` names them."""
    return [
        Instrument(f"{body}_{1e3 * x:04.0f}mm_{quantity}", body, x, quantity, NOISE[quantity])
        for quantity in quantities.split(",")
        for body, x in places
    ]


def import_map(session: UserSession) -> None:
    session.run("rig import run.csv --rig lab/rig.json --write-map lab/run.toml --force")
