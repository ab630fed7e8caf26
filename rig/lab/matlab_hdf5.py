"""The numeric arrays of a MATLAB file of version 7.3, which is HDF5."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rig.lab.column import Blocks, ColumnBlock, Refused, UnreadableError
from rig.lab.hdf5 import attribute, blocks_of, check_stored, is_new, kept_elsewhere, members, opened
from rig.limits import MAX_DEPTH, MAX_ITEMS


def matlab_hdf5_blocks(path: Path) -> Blocks:
    """A block a real numeric array, also in structs and cells, named as `rig.lab.matlab` does.

    A group that hard links or references reach by several ways is listed by the first of them. Raises RigError if h5py
    is not installed.
    """
    purpose = "a MATLAB file of version 7.3 (save(..., '-v7') stores it as an older one)"
    with opened(path, purpose) as file:
        arrays = _Arrays(path, file)
        for name, item in members(file, "", 0):
            if not name.startswith("#"):  # what references point to
                yield from arrays.of(name, item, 1)


class _Arrays:
    """The walk through a file, which remembers where it was and how many references it followed."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file = path, file
        self._visited: set[int] = set()
        self._references = 0

    def of(self, name: str, item: Any, depth: int) -> Iterator[ColumnBlock | Refused]:
        """The blocks of an array, of a struct (a group), or of what the references of a cell array lead to."""
        import h5py

        if isinstance(item, Refused):
            yield item
        elif isinstance(item, h5py.Group):
            if is_new(item, self._visited):
                for field, inner in members(item, f"{name}.", depth):
                    if isinstance(inner, h5py.Dataset) and _refers(inner) and not _is(inner, "cell"):
                        yield from self._behind(inner, f"{name}(", f").{field}", depth + 1)
                    else:
                        yield from self.of(f"{name}.{field}", inner, depth + 1)
        elif isinstance(item, h5py.Dataset) and _is(item, "cell"):
            yield from self._behind(item, f"{name}{{", "}", depth + 1)
        elif isinstance(item, h5py.Dataset) and not _is(item, "char") and not _is_empty(item):
            yield from blocks_of(self._path, item, name)

    def _behind(self, dataset: Any, before: str, after: str, depth: int) -> Iterator[ColumnBlock | Refused]:
        """The blocks of what references lead to; in their names the element's number stands between the two texts."""
        name = f"{before}1{after}"
        if not is_new(dataset, self._visited):
            return
        if sentence := kept_elsewhere(dataset, name):
            yield Refused(name, sentence)
            return
        self._references += dataset.size
        if depth > MAX_DEPTH or self._references > MAX_ITEMS:
            raise UnreadableError(f"its cells are more than {MAX_DEPTH} deep, or more than {MAX_ITEMS}")
        check_stored(self._path, dataset, name)
        for number, reference in enumerate(dataset[()].T.ravel(order="F"), start=1):
            yield from self.of(f"{before}{number}{after}", self._file[reference], depth)


def _refers(dataset: Any) -> bool:
    import h5py

    return h5py.check_ref_dtype(dataset.dtype) is h5py.Reference


def _is(item: Any, kind: str) -> bool:
    return attribute(item, ("MATLAB_class",)) == kind


def _is_empty(item: Any) -> bool:
    return attribute(item, ("MATLAB_empty",)) not in (None, "0")
