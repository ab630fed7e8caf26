"""Tables of curves as files: csv, mat or parquet, one file per table."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rig.extras import needs_extra
from rig.files import atomic_write

Table = dict[str, Float[np.ndarray, " rows"]]
"""Columns of equal length by their names, which end in the unit unless it is one."""


def save_tables(tables: Mapping[str, Table], folder: Path, form: str) -> None:
    """Write each table to a file of its name in an existing folder; raises RigError if one cannot be written."""
    for name, table in tables.items():
        with atomic_write(folder / f"{name}.{form}") as partial_path:
            WRITERS[form](table, partial_path)


def _write_csv(table: Table, path: Path) -> None:
    import csv

    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerow(table)
        np.savetxt(stream, np.stack([*table.values()], axis=1), fmt="%.17g", delimiter=",")


def _write_mat(table: Table, path: Path) -> None:
    """Write a matrix `values` and a cell array `names`, as names of contacts are no valid names of variables."""
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
