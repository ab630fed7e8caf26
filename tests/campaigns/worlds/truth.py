"""What is sealed of every case: the schema of key.json."""

from typing import Literal

import msgspec

from tests.campaigns.worlds.forces import Excitation
from tests.campaigns.worlds.machine import Machine

World = Literal["own", "wide", "other", "counted", "bench", "stated"]
WORLDS: tuple[World, ...] = ("own", "wide", "other", "counted", "bench", "stated")
BENCHES_OF: tuple[World, ...] = ("bench", "stated")
"""Worlds with the machines of the bench."""
CaseKind = Literal["null", "single", "pair", "several", "outside"]
"""`several`: two to four effects of the library at once."""


class EffectTruth(msgspec.Struct, frozen=True, kw_only=True):
    """An effect as it was put in. Parameters bear their unit in the name; a factor is one of what is believed.

    `parameters` is as drawn. `whole` is how the machine differs from rig.json there, the tolerance that was drawn and
    the effect together (a clearance factor: true over believed), with the same fields: what a diagnosis of the law as
    it is finds. Of an uncounted one (a cable) nobody speaks unless it shows. `stand_ins` are the effects of the library
    that come nearest to one outside it, at its place.

    place: contact ("all" or a name), body, beam, sensor, side, each where there is one, and position_m. A strength is
    the distance from no effect in that of the effect's default; of factors in logarithms.
    """

    name: str
    parameters: dict[str, float]
    place: dict[str, str | float]
    strength: float
    whole: dict[str, float] = {}
    uncounted: bool = False
    stand_ins: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """NAME:FIELD=VALUE,... as the command line of `rig record --effect` writes it; all contacts are left out."""
        words = {k: v for k, v in self.place.items() if v != "all" and k != "position_m"} | self.parameters
        return f"{self.name}:{','.join(f'{k}={v}' for k, v in words.items())}"


class Expected(msgspec.Struct, frozen=True, kw_only=True):
    """What a description of an effect outside the library has to say; None where it has no such thing."""

    where: Literal["force", "sensor", "distributed", "contact pair"]
    law: str
    body: str | None = None
    position_m: float | None = None
    sensor: str | None = None
    contact: str | None = None
    frequency_hz: float | None = None


class RecordTruth(msgspec.Struct, frozen=True, kw_only=True):
    """One record: what excites it, the seed, and each contact's share of time pressed."""

    file: str
    excitation: Excitation
    seed: int
    closed_fraction: dict[str, float]


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """The answer to one case; `draw` counts from 0 and is above if earlier draws could not be simulated.

    `machine` names its kind in the world "bench".

    `nominal` is the machine as believed, `drawn` with every tolerance, `true` with the effects too. `hung` tells
    whether a small mass or a cable hangs somewhere as a tolerance.
    """

    case: str
    world: World
    kind: CaseKind
    effects: tuple[EffectTruth, ...]
    expected: Expected | None
    hung: bool
    machine: str = ""
    records: tuple[RecordTruth, ...]
    nominal: Machine
    drawn: Machine
    true: Machine
    draw: int
    refused: tuple[str, ...]
    sha256: dict[str, str]

    @property
    def strengths(self) -> tuple[float, ...]:
        return tuple(effect.strength for effect in self.effects)


class Key(msgspec.Struct, frozen=True, kw_only=True):
    """The sealed answers."""

    world: World
    seed: int
    nulls_only: bool
    duration_s: float
    cases: tuple[Case, ...]
