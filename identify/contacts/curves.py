"""The curves of an identification as data: csv, mat or parquet, one file a family."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from identify.contacts.identification import Identification
from rig.extras import needs_extra
from rig.files import atomic_write

Table = dict[str, Float[np.ndarray, " rows"]]
"""Columns of one length by their names, which end in the unit; an empty unit is not written."""


def curves(found: Identification) -> dict[str, Table]:
    """By family: `motion` (relative displacements and separated contact forces over time), `surface` (restoring force
    of the main modal equation, as measured and as fitted) and `nifo` (over frequency; not of a free decay)."""
    names = [c.name for c in found.rig.contacts]
    tables = {"motion": _motion(found), "surface": _surface(found, names)}
    return tables | ({"nifo": _nifo(found, names)} if found.forms else {})


def _time_s(found: Identification, factor: int, rows: int) -> Float[np.ndarray, " rows"]:
    """In the record, of which the start may be left out."""
    return found.motion.first_s + np.arange(rows) * factor / found.motion.sample_rate_hz


def _motion(found: Identification) -> Table:
    """At the rate of the separated forces; of all contacts between the same places together."""
    factor = found.factor
    force = found.separated_n
    eta = found.eta_m[[place.members[0] for place in found.same_place], ::factor]
    rows = min(eta.shape[1], force.shape[1])
    table: Table = {"time_s": _time_s(found, factor, rows)}
    for place, displacement, contact_n in zip(found.same_place, eta, force, strict=True):
        name = place.contact.name
        table[f"{name} relative displacement m"] = displacement[:rows]
        table[f"{name} contact force N"] = contact_n[:rows]
    return table


def _surface(found: Identification, names: list[str]) -> Table:
    surface = found.surface
    eta = found.eta_m[:, :: surface.factor]
    velocity = surface.equation.velocity[:: surface.factor]
    rows = min(eta.shape[1], surface.measured.size, velocity.size)
    table: Table = {"time_s": _time_s(found, surface.factor, rows)}
    table |= {f"{name} relative displacement m": row[:rows] for name, row in zip(names, eta, strict=True)}
    table["modal velocity sqrt(kg) m/s"] = velocity[:rows]
    table["restoring force N/sqrt(kg)"] = surface.measured[:rows]
    table["fitted restoring force N/sqrt(kg)"] = surface.fitted[:rows]
    return table


def _nifo(found: Identification, names: list[str]) -> Table:
    """Both forms; each line's FRF of the modal coordinate over the modal force, and stiffness of every contact."""
    table: Table = {"frequency_Hz": found.weak.frequency_hz}
    for form, result in (("weak form", found.weak), ("paper's form", found.paper)):
        rows = {"FRF s^2": result.frf}
        rows |= {
            f"{names[j]} stiffness N/m": row for j, row in zip(result.contacts, result.stiffness_n_per_m, strict=True)
        }
        for name, row in rows.items():
            if result.frequency_hz.size == found.weak.frequency_hz.size:
                table[f"{form} {name} real"], table[f"{form} {name} imaginary"] = row.real, row.imag
    return table


def _write_csv(table: Table, path: Path) -> None:
    import csv

    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerow(table)
        np.savetxt(stream, np.stack([*table.values()], axis=1), fmt="%.17g", delimiter=",")


def _write_mat(table: Table, path: Path) -> None:
    """A matrix `values` and a cell array `names`: names of contacts are no names of variables."""
    from scipy.io import savemat

    values = np.stack([*table.values()], axis=1)
    savemat(path, {"values": values, "names": np.array([*table], dtype=object)}, appendmat=False, do_compression=True)


def _write_parquet(table: Table, path: Path) -> None:
    with needs_extra("view", f"{path}: a parquet file"):
        import pyarrow as pa
        from pyarrow import parquet
    parquet.write_table(pa.table(table), path)


WRITERS: Mapping[str, Callable[[Table, Path], None]] = {
    "csv": _write_csv,
    "mat": _write_mat,
    "parquet": _write_parquet,
}


def save_curves(found: Identification, folder: Path, form: str) -> None:
    """motion, surface and nifo in a folder that is there; raises RigError if one cannot be written."""
    for name, table in curves(found).items():
        with atomic_write(folder / f"{name}.{form}") as part:
            WRITERS[form](table, part)
