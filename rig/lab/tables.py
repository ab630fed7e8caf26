"""Measured data as columns, from the files in which laboratories keep them: CSV, UFF, MATLAB, TDMS and HDF5."""

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from rig.errors import RigError
from rig.files import check_source
from rig.lab.column import Blocks, Column, Refused, UnreadableError
from rig.lab.csv_columns import csv_blocks
from rig.lab.csv_text import TEXT_SUFFIXES, TextForm
from rig.lab.hdf5 import hdf5_blocks
from rig.lab.matlab import matlab_blocks
from rig.lab.tdms import tdms_blocks
from rig.lab.uff import uff_blocks
from rig.limits import MAX_ITEMS, MAX_NAME_LENGTH, PROGRAM_BYTES, check_decoded_size
from rig.recording.file import check_is_no_mcap

Result = TypeVar("Result")
ColumnKey = str | int
"""Name of a column, or its number from 1."""
WORKING_BYTES_PER_SAMPLE = 16
"""An imported sample is held twice as a double: in its column and in the rows in SI."""


@dataclass(frozen=True)
class Table:
    """Names of all columns of a file, the requested columns by index, and what was decided about it in words."""

    names: tuple[str, ...]
    columns: Mapping[int, Column]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, columns: Sequence[Column]) -> "Table":
        return cls(tuple(column.name for column in columns), dict(enumerate(columns)))

    def column(self, column_key: ColumnKey) -> Column:
        """Column by name or number; raises RigError if there is none, or more than one."""
        if isinstance(column_key, int):
            if not 1 <= column_key <= len(self.names):
                raise RigError(f"there is no column {column_key}; the file has 1 to {len(self.names)}")
            return self.columns[column_key - 1]
        match_indices = [index for index, name in enumerate(self.names) if name == column_key]
        if len(match_indices) > 1:
            raise RigError(f"{len(match_indices)} columns are named {column_key!r}; give the number of the one meant")
        if not match_indices:
            listed_names = ", ".join(map(repr, self.names[:12])) + (", ..." if len(self.names) > 12 else "")
            raise RigError(f"there is no column {column_key!r}; the file has {listed_names}")
        return self.columns[match_indices[0]]


def read_table(path: Path, text_form: TextForm, column_keys: Collection[ColumnKey] | None = None) -> Table:
    """Requested columns (None: all) of a file, whose format follows from its suffix; no others are decoded.

    Raises RigError as `with_blocks` does, and with a sentence if the file holds no numbers, or keeps a column that is
    asked for elsewhere.
    """
    table = with_blocks(path, text_form, lambda blocks: _read_blocks(path, blocks, column_keys))
    if not table.names:
        raise RigError(f"{path}: holds no column of numbers over time; check what was exported")
    return table


def with_blocks(path: Path, text_form: TextForm, consume_blocks: Callable[[Blocks], Result]) -> Result:
    """Result of `consume_blocks`, given the content of a file, whose format follows from its suffix.

    Raises RigError with a sentence if the file cannot be opened, is empty, is not of its format, or would take more
    memory than `rig.limits` allows.
    """
    check_is_no_mcap(path)
    if (suffix := path.suffix.lower()) not in READERS:
        raise RigError(f"{path}: the suffix {suffix!r} is none of {', '.join(READERS)}; rename the file or convert it")
    check_source(path)
    try:
        if not path.stat().st_size:
            raise RigError(f"{path}: is empty; export it again")
        with closing(READERS[suffix](path, text_form)) as blocks:
            return consume_blocks(blocks)
    except OSError as error:
        if error.errno is None:  # of a format's library, in words of its own
            raise RigError(f"{path}: cannot be read as {suffix}, whole or in part; export it again") from error
        raise RigError(f"{path}: cannot be opened ({error.strerror or error}); check the name") from error
    except RigError:
        raise
    except MemoryError as error:
        raise RigError(f"{path}: needs more memory than there is; export it again, or a shorter record") from error
    except UnreadableError as error:
        raise RigError(f"{path}: cannot be read as {suffix} ({error}); export it again") from error
    except Exception as error:  # what the formats' libraries raise on a bad file is not to be listed
        raise RigError(f"{path}: cannot be read as {suffix}, whole or in part; export it again") from error


def _read_blocks(path: Path, blocks: Blocks, column_keys: Collection[ColumnKey] | None) -> Table:
    column_names: list[str] = []
    columns: dict[int, Column] = {}
    notes: tuple[str, ...] = ()
    file_bytes, needed_bytes = path.stat().st_size, PROGRAM_BYTES
    for block in blocks:
        first_index = len(column_names)
        if isinstance(block, Refused):
            if _is_possibly_requested(block, first_index, column_keys):
                raise RigError(f"{path}: {block.sentence}")
            continue
        column_names += block.names
        if len(column_names) > MAX_ITEMS or max(map(len, block.names)) > MAX_NAME_LENGTH:
            raise UnreadableError(
                f"it has more than {MAX_ITEMS} columns, or names of over {MAX_NAME_LENGTH} characters"
            )
        chosen_indices = [
            index
            for index, name in enumerate(block.names)
            if column_keys is None or name in column_keys or first_index + index + 1 in column_keys
        ]
        if chosen_indices:
            needed_bytes += WORKING_BYTES_PER_SAMPLE * block.sample_count * len(chosen_indices)
            other_count = len(columns) + len(chosen_indices) - 1
            others_note = f" with {other_count} more" if other_count else ""
            memory_label = f"{path}: column {block.names[chosen_indices[-1]]!r}{others_note}"
            check_decoded_size(needed_bytes + block.working_bytes, file_bytes, memory_label)
            columns |= zip((first_index + index for index in chosen_indices), block.read(chosen_indices), strict=True)
            notes = (*notes, *(note for note in block.notes if note not in notes))
    return Table(tuple(column_names), columns, notes)


def _is_possibly_requested(refused: Refused, column_count: int, column_keys: Collection[ColumnKey] | None) -> bool:
    """True if a key may select refused content: by its name, one of its channels, or a number beyond `column_count`."""
    if column_keys is None:
        return True
    return any(
        key > column_count if isinstance(key, int) else refused.name in (key, key.partition("[")[0])
        for key in column_keys
    )


READERS: dict[str, Callable[[Path, TextForm], Blocks]] = {
    **dict.fromkeys(TEXT_SUFFIXES, csv_blocks),
    ".uff": lambda path, _: uff_blocks(path),
    ".unv": lambda path, _: uff_blocks(path),
    ".mat": lambda path, _: matlab_blocks(path),
    ".tdms": lambda path, _: tdms_blocks(path),
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), lambda path, _: hdf5_blocks(path)),
}
