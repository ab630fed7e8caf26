"""Results of `identify contact`: the contacts' laws (contact.json), their motion and forces (motion.csv, .parquet)."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from rig.errors import RigError
from rig.files import contents
from rig.model.contact_laws import ContactLaw, DeadZone
from rig.model.description import Rig

LEAST_S = 0.1
"""What the curves have to cover."""
LEAST_STEP_S, ABSURD = 1e-9, 1e100
"""Closer rows and larger values, in SI units, are none of a recording; splines through them would overflow."""


class _Value(msgspec.Struct, frozen=True):
    value: float


class _Contact(msgspec.Struct, frozen=True):
    name: str
    clearance_m: _Value
    stiffness_n_per_m: _Value
    damping_n_s_per_m: _Value
    lower_clearance_m: _Value | None = None
    upper_clearance_m: _Value | None = None


class _Report(msgspec.Struct, frozen=True):
    contacts: tuple[_Contact, ...]


@dataclass(frozen=True)
class Curves:
    """Relative displacements and separated contact forces, at a rate that suffices for the band of the force."""

    time_s: Float[np.ndarray, " rows"]
    relative_m: Float[np.ndarray, "contacts rows"]
    force_n: Float[np.ndarray, "contacts rows"]

    def at(self, time_s: Float[np.ndarray, " samples"]) -> Float[np.ndarray, "2 contacts samples"]:
        """Both at other times between the first and the last row, by cubic splines."""
        return np.asarray(CubicSpline(self.time_s, np.stack([self.relative_m, self.force_n]), axis=2)(time_s))

    def within(self, time_s: Float[np.ndarray, " samples"]) -> slice:
        """The samples between the first and the last row."""
        first, last = np.searchsorted(time_s, self.time_s[[0, -1]])
        return slice(int(first), int(last))


@dataclass(frozen=True)
class Identified:
    """Laws by contact, and the curves where they were exported."""

    laws: Mapping[str, ContactLaw] = field(default_factory=dict)
    curves: Curves | None = None


NOTHING_IDENTIFIED = Identified()


def read_identified(path: Path, rig: Rig, duration_s: float) -> Identified:
    """Content of a contact.json, or of the folder that holds it, with the curves that `--export` wrote beside it.

    Raises RigError if a file cannot be read or is none of `identify contact`, or is one of another recording.
    """
    file = path / "contact.json" if path.is_dir() else path
    laws = identified_laws(file, rig)
    beside = [one for one in (file.with_name("motion.parquet"), file.with_name("motion.csv")) if one.exists()]
    return Identified(laws, _curves(beside[0], rig, duration_s) if beside else None)


def _curves(path: Path, rig: Rig, duration_s: float) -> Curves:
    try:
        columns = _parquet(path) if path.suffix == ".parquet" else _csv(path)
        time_s = columns["time_s"]
        relative_m, force_n = (
            np.array([columns[f"{c.name} {what}"] for c in rig.contacts]).reshape(len(rig.contacts), time_s.size)
            for what in ("relative displacement m", "contact force N")
        )
    except KeyError as error:
        raise RigError(f"{path}: has no column {error}; identify this recording with --export") from error
    except (ValueError, StopIteration, csv.Error) as error:
        raise RigError(f"{path}: is no table of `identify contact --export` ({error}); make it anew") from error
    grows = bool(time_s.size) and (np.diff(time_s) > LEAST_STEP_S).all() and time_s[-1] - time_s[0] > LEAST_S
    if not (grows and (np.abs([*relative_m, *force_n, time_s]) < ABSURD).all()):
        raise RigError(f"{path}: has too few rows, a time that does not grow, or no number somewhere; make it anew")
    if not (time_s[0] >= 0 and time_s[-1] <= duration_s):
        raise RigError(f"{path}: goes to {time_s[-1]:g} s, the recording to {duration_s:g} s; identify this recording")
    return Curves(time_s, relative_m, force_n)


def _csv(path: Path) -> dict[str, Float[np.ndarray, " rows"]]:
    lines = contents(path).decode().splitlines()
    names = next(csv.reader(lines[:1]))
    values = np.loadtxt(lines[1:], delimiter=",", ndmin=2)
    return dict(zip(names, values.T, strict=True))


def _parquet(path: Path) -> dict[str, Float[np.ndarray, " rows"]]:
    import io

    from pyarrow import parquet

    table = parquet.read_table(io.BytesIO(contents(path)))
    return {name: table[name].to_numpy() for name in table.column_names}


def identified_laws(path: Path, rig: Rig) -> dict[str, DeadZone]:
    """The laws in a contact.json, by contact; both sides are the clearance where they are not told apart.

    Raises RigError if the file cannot be read, is no contact.json, or names a contact that the rig does not have.
    """
    try:
        report = msgspec.json.decode(contents(path), type=_Report)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RigError(f"{path}: is no contact.json ({error}); make one by `identify contact`") from error
    names = [c.name for c in rig.contacts]
    for found in report.contacts:
        if found.name not in names:
            raise RigError(f"{path}: has a contact {found.name!r}, the rig has {', '.join(names)}; take another file")
    try:
        return {c.name: _law(c) for c in report.contacts}
    except RigError as error:
        raise RigError(f"{path}: {error}") from error


def _law(found: _Contact) -> DeadZone:
    return DeadZone(
        lower_clearance_m=(found.lower_clearance_m or found.clearance_m).value,
        upper_clearance_m=(found.upper_clearance_m or found.clearance_m).value,
        stiffness_n_per_m=found.stiffness_n_per_m.value,
        damping_n_s_per_m=max(0.0, found.damping_n_s_per_m.value),  # an estimate may lie below zero
    )
