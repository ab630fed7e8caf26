"""Tables as files: curves as csv, mat or parquet, one file per table; rows of numbers and words as csv and parquet."""

import csv
from collections.abc import Callable, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.extras import needs_extra
from rig.files import atomic_write, write_bytes

Table = dict[str, Float[np.ndarray, " rows"]]
"""Columns of equal length by their names, which end in the unit unless it is one."""
Row = Mapping[str, str | float | None]
"""Cells by their columns."""


def save_tables(tables: Mapping[str, Table], folder: Path, suffix: str) -> None:
    """Write each table to a file of its name in an existing folder; raises RigError if one cannot be written."""
    for table_name, table in tables.items():
        with atomic_write(folder / f"{table_name}.{suffix}") as partial_path:
            WRITERS[suffix](table, partial_path)


def _write_csv(table: Table, path: Path) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerow(table)
        np.savetxt(stream, np.stack([*table.values()], axis=1), fmt="%.17g", delimiter=",")


def _write_mat(table: Table, path: Path) -> None:
    """Write a matrix `values` and a cell array `names`, as names of contacts are no valid names of variables."""
    from scipy.io import savemat

    values = np.stack([*table.values()], axis=1)
    savemat(path, {"values": values, "names": np.array([*table], dtype=object)}, appendmat=False, do_compression=True)


def _write_parquet(table: Table, path: Path) -> None:
    pyarrow, parquet = _pyarrow(path)
    parquet.write_table(pyarrow.table(table), path)


def _pyarrow(path: Path) -> tuple[Any, Any]:
    """Modules pyarrow and pyarrow.parquet; raises RigError where they are not installed."""
    with needs_extra("view", f"{path}: a parquet file"):
        import pyarrow
        from pyarrow import parquet
    return pyarrow, parquet


def save_rows(rows: Sequence[Row], column_names: Sequence[str], folder: Path, table_name: str) -> str:
    """Write rows to NAME.csv and NAME.parquet; the note is empty, or says why there is no parquet file.

    An empty cell of the CSV, a null of the parquet file, is a number that is not there; words are never null.
    """
    csv_text = StringIO()
    writer = csv.DictWriter(csv_text, column_names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_bytes(csv_text.getvalue().encode(), folder / f"{table_name}.csv")
    parquet_path = folder / f"{table_name}.parquet"
    try:
        pyarrow, parquet = _pyarrow(parquet_path)
    except RigError as error:
        return str(error)
    array_by_column = {}
    for column_name in column_names:
        cells = [row.get(column_name) for row in rows]
        arrow_type = pyarrow.string() if any(isinstance(cell, str) for cell in cells) else pyarrow.float64()
        array_by_column[column_name] = pyarrow.array(cells, arrow_type)
    with atomic_write(parquet_path) as partial_path:
        parquet.write_table(pyarrow.table(array_by_column), partial_path)
    return ""


WRITERS: Mapping[str, Callable[[Table, Path], None]] = {
    "csv": _write_csv,
    "mat": _write_mat,
    "parquet": _write_parquet,
}
