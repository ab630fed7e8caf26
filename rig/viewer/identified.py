"""Results of `identify contact`: the contacts' laws (contact.json), their motion and forces (motion.csv, .parquet)."""

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from rig.errors import RigError
from rig.files import contents
from rig.limits import decoded_result
from rig.model.contact_laws import ContactLaw, DeadZone
from rig.model.description import Rig, contact_rows

MIN_CURVES_S = 0.1
"""Least duration of the curves, s."""
MIN_STEP_S, MAX_VALUE = 1e-9, 1e100
"""Least time between rows (s) and largest value (SI) in a plausible file; otherwise splines would overflow."""


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
class IdentifiedCurves:
    """Identified relative displacements and separated contact forces, sampled for the band of the force."""

    time_s: Float[np.ndarray, " rows"]
    relative_displacement_m: Float[np.ndarray, "contacts rows"]
    force_n: Float[np.ndarray, "contacts rows"]

    def interpolate(self, time_s: Float[np.ndarray, " samples"]) -> Float[np.ndarray, "2 contacts samples"]:
        """Relative displacements and forces at other times within the curves, by cubic splines."""
        spline = CubicSpline(self.time_s, np.stack([self.relative_displacement_m, self.force_n]), axis=2)
        return np.asarray(spline(time_s))

    def covered_samples(self, time_s: Float[np.ndarray, " samples"]) -> slice:
        """Samples within the time of the curves."""
        first_sample, end_sample = np.searchsorted(time_s, self.time_s[[0, -1]])
        return slice(int(first_sample), int(end_sample))


@dataclass(frozen=True)
class IdentifiedContacts:
    """Identified laws by contact, and the curves if they were exported."""

    laws: Mapping[str, ContactLaw] = field(default_factory=dict)
    curves: IdentifiedCurves | None = None


NOTHING_IDENTIFIED = IdentifiedContacts()


def read_identified(path: Path, rig: Rig, duration_s: float) -> IdentifiedContacts:
    """Read a contact.json, given by its path or folder, and the curves that `--export` wrote beside it.

    Raises RigError if a file is unreadable or invalid, or belongs to another recording.
    """
    report_path = path / "contact.json" if path.is_dir() else path
    law_by_contact = identified_laws(report_path, rig)
    candidate_paths = (report_path.with_name(name) for name in ("motion.parquet", "motion.csv"))
    curves_path = next((path for path in candidate_paths if path.exists()), None)
    return IdentifiedContacts(law_by_contact, _read_curves(curves_path, rig, duration_s) if curves_path else None)


def _read_curves(path: Path, rig: Rig, duration_s: float) -> IdentifiedCurves:
    try:
        columns = _parquet_columns(path) if path.suffix == ".parquet" else _csv_columns(path)
        time_s = columns["time_s"]
        relative_displacement_m, force_n = (
            np.array([columns[f"{contact.name} {quantity}"] for contact in contact_rows(rig)]).reshape(-1, time_s.size)
            for quantity in ("relative displacement m", "contact force N")
        )
    except KeyError as error:
        raise RigError(f"{path}: has no column {error}; identify this recording with --export") from error
    except (ValueError, StopIteration, csv.Error) as error:
        raise RigError(f"{path}: is no table of `identify contact --export` ({error}); make it anew") from error
    time_grows = bool(time_s.size) and (np.diff(time_s) > MIN_STEP_S).all() and time_s[-1] - time_s[0] > MIN_CURVES_S
    if not (time_grows and (np.abs([*relative_displacement_m, *force_n, time_s]) < MAX_VALUE).all()):
        raise RigError(f"{path}: has too few rows, a time that does not grow, or no number somewhere; make it anew")
    if not (time_s[0] >= 0 and time_s[-1] <= duration_s):
        raise RigError(f"{path}: goes to {time_s[-1]:g} s, the recording to {duration_s:g} s; identify this recording")
    return IdentifiedCurves(time_s, relative_displacement_m, force_n)


def _csv_columns(path: Path) -> dict[str, Float[np.ndarray, " rows"]]:
    csv_lines = contents(path).decode().splitlines()
    column_names = next(csv.reader(csv_lines[:1]))
    csv_values = np.loadtxt(csv_lines[1:], delimiter=",", ndmin=2)
    return dict(zip(column_names, csv_values.T, strict=True))


def _parquet_columns(path: Path) -> dict[str, Float[np.ndarray, " rows"]]:
    import io

    from pyarrow import parquet

    parquet_table = parquet.read_table(io.BytesIO(contents(path)))
    return {column_name: parquet_table[column_name].to_numpy() for column_name in parquet_table.column_names}


def identified_laws(path: Path, rig: Rig) -> dict[str, DeadZone]:
    """Laws in a contact.json, by contact; without separate sides, both clearances are the common one.

    Where one side alone was determined, the other has no stop here.

    Raises RigError if the file is unreadable or invalid, or names a contact that the rig does not have.
    """
    report = decoded_result(contents(path), _Report, str(path), "contact.json", "make one by `identify contact`")
    contact_names = [contact.name for contact in rig.contacts]
    for contact in report.contacts:
        if contact.name not in contact_names:
            raise RigError(
                f"{path}: has a contact {contact.name!r}, the rig has {', '.join(contact_names)}; take another file"
            )
    try:
        return {contact.name: _dead_zone_of(contact) for contact in report.contacts}
    except RigError as error:
        raise RigError(f"{path}: {error}") from error


def _dead_zone_of(contact: _Contact) -> DeadZone:
    clearances = contact.lower_clearance_m, contact.upper_clearance_m
    lower_clearance_m, upper_clearance_m = (
        contact.clearance_m.value if clearances == (None, None) else math.inf if clearance is None else clearance.value
        for clearance in clearances
    )
    return DeadZone(
        lower_clearance_m=lower_clearance_m,
        upper_clearance_m=upper_clearance_m,
        stiffness_n_per_m=contact.stiffness_n_per_m.value,
        damping_n_s_per_m=max(0.0, contact.damping_n_s_per_m.value),  # an estimate may lie below zero
    )
