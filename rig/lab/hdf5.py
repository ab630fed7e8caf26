"""Datasets of real numbers in an HDF5 file, which must hold them itself: no link to another file is followed.

HDF5 can keep a dataset as raw bytes of any other file (external storage), as a view of other HDF5 files (virtual), or
not at all (chunks never written, read as a fill value); and what it stores may swell while it is decompressed.
"""

import math
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.extras import needs_extra
from rig.lab.column import Blocks, Column, ColumnBlock, Refused, UnreadableError, column_names, utf8_or_latin1_text
from rig.lab.stated import MAX_FIELD_VALUES, Stated, StatedFields, column_of
from rig.limits import MAX_DEPTH, MAX_ITEMS, MAX_NAME_LENGTH

NAME_ATTRIBUTES = ("name",)
"""Attributes for the name of a dataset; one without a name is called by its path."""
SINGLE_ATTRIBUTES = ("unit", "units", "sample_rate_hz", "fs")
"""Attributes of a dataset that have one value, or are a fault."""
RATE_ATTRIBUTES = ("sample_rate_hz", "fs")
DATE_ATTRIBUTES = ("recorded", "start_time", "date")
"""Attributes of a dataset or the file that state when it was recorded."""
_HDF4_MARK = b"\x0e\x03\x13\x01"
SINGLE_VALUE_SHAPES = ((), (1,))
"""Shapes of an attribute with a single value."""
BYTES_PER_READ = 32_000_000
"""Bytes of a matrix read at once."""
DEFLATE, LZF = 1, 32000
PLAIN_FILTERS = {2, 3}
"""Filters that do not change the size: shuffling and checksums."""
MAX_EXPANSION = {DEFLATE: 1032, LZF: 90}
"""Largest expansion on decompression (zlib: 258 bytes from two bits; LZF: 264 bytes from three)."""
UNCHECKED_CHUNK_BYTES = 100_000_000
"""Size up to which a chunk is decompressed without a check of its content."""
BYTES_PER_INFLATION = 1 << 20
MAX_ATTRIBUTES = 1000
"""Most attributes of a group or dataset that are looked at."""


@contextmanager
def open_hdf5(path: Path, purpose: str) -> Iterator[Any]:
    """Open HDF5 file; raises UnreadableError if it is none, RigError if h5py is not installed."""
    with needs_extra("lab", f"{path}: {purpose}"):
        import h5py

    if not h5py.is_hdf5(path):
        with path.open("rb") as stream:
            if stream.read(4) == _HDF4_MARK:
                raise RigError(f"{path}: is HDF4, an older format than HDF5, which is not read; convert it by h4toh5")
        raise UnreadableError("its beginning is another")
    with h5py.File(path, "r", locking=False) as file:
        yield file


def hdf5_blocks(path: Path) -> Blocks:
    """Block per dataset; the rows of a matrix, or its columns if those are fewer, are NAME[1], NAME[2], ...

    Units, rates, starts and labels are those of attributes and single values of the dataset or the groups around it.
    """
    with open_hdf5(path, "an HDF5 file") as file:
        stated = StatedFields()
        add_attributes(stated, file, ())
        for full_name, item in _datasets(file, "", set(), 0, stated):
            if not isinstance(item, Refused):
                add_dataset(stated, item, tuple(full_name.split("/")))
        for full_name, item in _datasets(file, "", set(), 0, None):
            if isinstance(item, Refused):
                yield item
            else:
                dataset_name = attribute_text(item, NAME_ATTRIBUTES) or full_name
                yield from dataset_blocks(path, item, dataset_name, stated, tuple(full_name.split("/")))


def _datasets(
    group: Any, prefix: str, visited_addresses: set[int], nesting_depth: int, stated: StatedFields | None
) -> Iterator[tuple[str, Any]]:
    """Full name and dataset, or Refused, of all in a group; the attributes of groups are added to `stated`."""
    import h5py

    for item_name, item in members(group, prefix, nesting_depth):
        full_name = f"{prefix}{item_name}"
        if isinstance(item, Refused):
            yield full_name, item
        elif not is_first_visit(item, visited_addresses):
            continue
        elif isinstance(item, h5py.Group):
            if stated is not None:
                add_attributes(stated, item, tuple(full_name.split("/")))
            yield from _datasets(item, f"{full_name}/", visited_addresses, nesting_depth + 1, stated)
        elif isinstance(item, h5py.Dataset):
            yield full_name, item


def add_attributes(stated: StatedFields, item: Any, item_path: tuple[str, ...]) -> None:
    """Add the attributes of a group or dataset that have a single value."""
    for attribute_name in islice(item.attrs, MAX_ATTRIBUTES):
        try:
            text = attribute_text(item, (attribute_name,))
            value_type = item.attrs.get_id(attribute_name).dtype
        except Exception:  # of a type that h5py does not read, as programs add for themselves
            continue
        if text is not None and len(text) <= MAX_FIELD_VALUES:
            stated.add_field((*item_path, attribute_name), _number_or_text(value_type, text))


def add_dataset(stated: StatedFields, dataset: Any, dataset_path: tuple[str, ...]) -> None:
    """Add a dataset as an array with its attributes, or as a field if it is one number or text of this file."""
    if external_storage_refusal(dataset, ""):
        return
    add_attributes(stated, dataset, dataset_path)
    try:
        shape, value_type = dataset.shape, dataset.dtype
    except TypeError:  # a type that NumPy does not have
        return
    if shape in SINGLE_VALUE_SHAPES and dataset.chunks is None and dataset.id.get_storage_size():
        value = np.ravel(np.asarray(dataset[()], dtype=object))[0]
        text = utf8_or_latin1_text(value) if isinstance(value, bytes) else str(value)
        if len(text) <= MAX_FIELD_VALUES:
            stated.add_field(dataset_path, _number_or_text(value_type, text))
    elif value_type.kind in "iuf" and shape:
        stated.add_array(dataset_path, math.prod(shape))


def _number_or_text(value_type: np.dtype, text: str) -> str | float:
    return float(text) if value_type.kind in "iuf" else text


def members(group: Any, prefix: str, nesting_depth: int) -> Iterator[tuple[str, Any]]:
    """Name and object of every member, sorted by name; a link to another file is a Refused.

    Soft links, which are aliases, are left out. Raises UnreadableError where groups are nested too deep.
    """
    import h5py

    if len(prefix) > MAX_NAME_LENGTH or nesting_depth > MAX_DEPTH:
        raise UnreadableError(
            f"its groups are more than {MAX_DEPTH} deep, or have names of over {MAX_NAME_LENGTH} characters"
        )
    for name in sorted(group):
        link_type = group.id.links.get_info(name.encode("utf-8", "surrogateescape")).type
        if link_type == h5py.h5l.TYPE_EXTERNAL:
            full_name = f"{prefix}{name}"
            yield name, Refused(full_name, _other_file_sentence(full_name, "is a link to another file"))
        elif link_type == h5py.h5l.TYPE_HARD:
            yield name, group[name]


def is_first_visit(item: Any, visited_addresses: set[int]) -> bool:
    """True if an object is visited for the first time, under any name; raises UnreadableError if there are too many."""
    import h5py

    object_address = h5py.h5o.get_info(item.id).addr
    if object_address in visited_addresses:
        return False
    visited_addresses.add(object_address)
    if len(visited_addresses) > MAX_ITEMS:
        raise UnreadableError(f"it has more than {MAX_ITEMS} groups and datasets")
    return True


def dataset_blocks(
    path: Path, dataset: Any, dataset_name: str, stated: StatedFields, dataset_path: tuple[str, ...]
) -> Iterator[ColumnBlock | Refused]:
    """Block of a dataset of real numbers; a Refused if its numbers are in another file.

    That is checked first: reading the shape of a virtual dataset can open the other file.
    """
    if sentence := external_storage_refusal(dataset, dataset_name):
        yield Refused(dataset_name, sentence)
        return
    try:
        shape, number_type = dataset.shape, dataset.dtype
    except TypeError:  # a type that NumPy does not have
        return
    if number_type.kind not in "iuf" or len(shape) not in (1, 2) or math.prod(shape) < 2:
        return
    sample_axis = len(shape) - 1 if len(shape) == 1 or shape[0] <= shape[1] else 0
    column_count = math.prod(shape) // shape[sample_axis]
    if column_count > MAX_ITEMS:
        raise UnreadableError(f"its dataset {dataset_name!r} has {column_count} columns")
    channel_names = column_names(dataset_name, column_count)
    chunk_bytes = math.prod(dataset.chunks or ()) * number_type.itemsize
    working_bytes = 2 * chunk_bytes + min(dataset.nbytes, BYTES_PER_READ)
    stated_of_channels = stated.of_array(dataset_path, column_count)
    read = partial(_read_columns, path, dataset, sample_axis, channel_names, stated_of_channels)
    yield ColumnBlock(channel_names, shape[sample_axis], read, working_bytes)


def external_storage_refusal(dataset: Any, dataset_name: str) -> str:
    """Sentence that refuses a dataset whose numbers are in other files; empty if they are in this one."""
    import h5py

    creation_properties = dataset.id.get_create_plist()
    if creation_properties.get_layout() == h5py.h5d.VIRTUAL:
        return _other_file_sentence(dataset_name, "is a view of other files (a virtual dataset)")
    if creation_properties.get_external_count():
        return _other_file_sentence(dataset_name, "has its bytes in another file (external storage)")
    return ""


def _other_file_sentence(content_name: str, reason: str) -> str:
    return f"{content_name!r} {reason}, which is not opened; store its numbers in this one"


def _read_columns(
    path: Path,
    dataset: Any,
    sample_axis: int,
    names: Sequence[str],
    stated_of_channels: Sequence[Stated],
    indices: Sequence[int],
) -> list[Column]:
    check_written_and_decompressible(path, dataset, names[indices[0]])
    for attribute in SINGLE_ATTRIBUTES:
        if attribute in dataset.attrs and dataset.attrs.get_id(attribute).shape not in SINGLE_VALUE_SHAPES:
            raise UnreadableError(f"its dataset {names[0]!r} has an attribute {attribute!r} of other than one value")
    rate_text = attribute_text(dataset, RATE_ATTRIBUTES)
    if rate_text is not None and stated_of_channels[0].rate_hz is None:
        raise UnreadableError(f"its dataset {names[0]!r} has the sample rate {rate_text!r}")
    channel_rows = _read_rows(dataset, sample_axis, indices)
    date_text = attribute_text(dataset, DATE_ATTRIBUTES) or attribute_text(dataset.file, DATE_ATTRIBUTES) or ""
    return [
        column_of(names[k], row, stated_of_channels[k], date_text) for k, row in zip(indices, channel_rows, strict=True)
    ]


def _read_rows(dataset: Any, sample_axis: int, column_indices: Sequence[int]) -> Float[np.ndarray, "chosen samples"]:
    """Channels of a matrix, read in spans of whole chunks, or channel by channel if a chunk is too large."""
    sample_count = dataset.shape[sample_axis]
    values = np.empty((len(column_indices), sample_count))
    chunk_length = dataset.chunks[sample_axis] if dataset.chunks else 1
    span_length = BYTES_PER_READ // (dataset.nbytes // sample_count) // chunk_length * chunk_length
    if dataset.ndim == 1:
        values[0] = dataset[()]
    elif dataset.nbytes <= BYTES_PER_READ or (span_length and len(column_indices) > 1):
        span_length = span_length or sample_count
        for first_sample in range(0, sample_count, span_length):
            sample_span = slice(first_sample, first_sample + span_length)
            span_rows = dataset[:, sample_span] if sample_axis else dataset[sample_span].T
            values[:, sample_span] = span_rows[column_indices]
    else:
        for channel_values, column_index in zip(values, column_indices, strict=True):
            channel_values[:] = dataset[column_index] if sample_axis else dataset[:, column_index]
    return values


def check_written_and_decompressible(path: Path, dataset: Any, dataset_name: str) -> None:
    """Raise RigError if samples were never written, have unknown filters, or expand beyond their chunk."""
    import h5py

    dataset_label = f"{path}: {dataset_name!r}"
    creation_properties = dataset.id.get_create_plist()
    layout = creation_properties.get_layout()
    if layout == h5py.h5d.CONTIGUOUS and not dataset.id.get_storage_size():
        raise _unwritten_error(dataset_label, dataset.size, dataset.size)
    if layout != h5py.h5d.CHUNKED:
        return
    chunk_filters = [creation_properties.get_filter(k) for k in range(creation_properties.get_nfilters())]
    compression_codes = [code for code, *_ in chunk_filters if code not in PLAIN_FILTERS]
    if len(compression_codes) > 1 or not set(compression_codes) <= set(MAX_EXPANSION):
        filter_names = ", ".join(
            f"{code} {utf8_or_latin1_text(filter_name)!r}" for code, _, _, filter_name in chunk_filters
        )
        raise RigError(
            f"{dataset_label} is stored by the filters {filter_names}, which are not read; store it by gzip or without"
        )
    chunk_bytes = math.prod(dataset.chunks) * dataset.dtype.itemsize
    doubtful_offsets: list[tuple[int, ...]] = []
    stored_values = 0

    def count_stored(chunk: Any) -> None:
        nonlocal stored_values
        extents = zip(dataset.chunks, dataset.shape, chunk.chunk_offset, strict=True)
        stored_values += math.prod(max(0, min(chunk_length, extent - start)) for chunk_length, extent, start in extents)
        max_expansion = MAX_EXPANSION[compression_codes[0]] if compression_codes else 0
        if chunk.size * max_expansion > max(UNCHECKED_CHUNK_BYTES, chunk_bytes):
            doubtful_offsets.append(chunk.chunk_offset)

    dataset.id.chunk_iter(count_stored)
    if stored_values < dataset.size:
        raise _unwritten_error(dataset_label, dataset.size - stored_values, dataset.size)
    for chunk_offset in doubtful_offsets:
        if compression_codes == [LZF] or not _is_inflated_size_at_most(
            dataset.id.read_direct_chunk(chunk_offset)[1], chunk_bytes
        ):
            raise RigError(
                f"{dataset_label} has a chunk that swells beyond its {chunk_bytes} bytes; store it without compression"
            )


def _unwritten_error(dataset_label: str, missing_count: int, sample_count: int) -> RigError:
    return RigError(
        f"{dataset_label} has {missing_count} of {sample_count} samples that were never written; export it again"
    )


def _is_inflated_size_at_most(compressed: bytes, max_bytes: int) -> bool:
    """True if a zlib stream decompresses to at most `max_bytes`."""
    decompressor, decompressed_count = zlib.decompressobj(), 0
    for first_byte in range(0, len(compressed), BYTES_PER_INFLATION):
        compressed_piece = compressed[first_byte : first_byte + BYTES_PER_INFLATION]
        while compressed_piece and decompressed_count <= max_bytes:
            decompressed_count += len(decompressor.decompress(compressed_piece, BYTES_PER_INFLATION))
            compressed_piece = decompressor.unconsumed_tail
    return decompressed_count <= max_bytes


def attribute_text(item: Any, attribute_names: Sequence[str]) -> str | None:
    """First of these attributes that has a single value, as text; None if there is none."""
    for attribute_name in attribute_names:
        if attribute_name in item.attrs and item.attrs.get_id(attribute_name).shape in SINGLE_VALUE_SHAPES:
            attribute_value = np.ravel(np.asarray(item.attrs[attribute_name], dtype=object))[0]
            if isinstance(attribute_value, str):
                attribute_value = attribute_value.encode("utf-8", "surrogateescape")
            return utf8_or_latin1_text(attribute_value) if isinstance(attribute_value, bytes) else str(attribute_value)
    return None
