"""The numeric arrays of a MATLAB file of version 7.3, which is HDF5."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from rig.errors import RigError
from rig.extras import needs_extra


def arrays_of_hdf5(path: Path, most_bytes: int) -> Iterator[tuple[str, np.ndarray]]:
    """Name and values of every real numeric array, also in structs and cells, as `rig.lab.matlab.arrays_of` names them.

    Raises RigError if h5py is not installed or the arrays have more than most_bytes in all, and what h5py raises on a
    damaged file.
    """
    with needs_extra("lab", f"{path}: a MATLAB file of version 7.3 (save(..., '-v7') stores it as an older one)"):
        import h5py
    with h5py.File(path, "r") as file:
        left = most_bytes
        for name in file:
            if name.startswith("#"):  # what references point to
                continue
            for full, dataset in _numeric(file, name, file[name], h5py):
                left -= dataset.nbytes
                if left < 0:
                    raise RigError(f"{path}: its compressed data swells beyond measure; store it by save(..., '-v7')")
                yield full, dataset[()].T


def _numeric(file: Any, name: str, item: Any, h5py: Any) -> Iterator[tuple[str, Any]]:
    """The datasets of real numbers in an array, in a struct (a group), or behind the references of a cell array."""
    if isinstance(item, h5py.Group):
        for field, inner in item.items():
            if isinstance(inner, h5py.Dataset) and h5py.check_ref_dtype(inner.dtype) and not _is(inner, "cell"):
                for k, reference in enumerate(inner[()].T.ravel(order="F"), start=1):
                    yield from _numeric(file, f"{name}({k}).{field}", file[reference], h5py)
            else:
                yield from _numeric(file, f"{name}.{field}", inner, h5py)
    elif _is(item, "cell"):
        for k, reference in enumerate(item[()].T.ravel(order="F"), start=1):
            yield from _numeric(file, f"{name}{{{k}}}", file[reference], h5py)
    elif item.dtype.kind in "iuf" and not _is(item, "char") and not item.attrs.get("MATLAB_empty", 0):
        yield name, item


def _is(item: Any, kind: str) -> bool:
    return bytes(item.attrs.get("MATLAB_class", b"")) == kind.encode()
