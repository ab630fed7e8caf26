"""What a file states beside its arrays: names, units, rates and starts, in fields of a struct, group or attribute.

A field describes what is next to it: the array that it is an attribute of, or the arrays of the struct or group it is
in. A struct or group without arrays (`x_values`, `Header`) is a description of those around it.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from rig.lab.column import Column
from rig.lab.recorded import is_real, stated_clock
from rig.lab.units import stated_unit

Field: TypeAlias = str | float | tuple[str, ...] | np.ndarray
"""Text, number, list of texts, or small array of numbers."""
Path: TypeAlias = tuple[str, ...]
Texts: TypeAlias = list[str | tuple[str, ...]]
MAX_FIELD_VALUES = 65536
"""Most characters or numbers of an array that is kept as a field."""
MAX_KEPT_VALUES = 2_000_000
"""Most characters and numbers that are kept of all fields."""
MIN_SIGNAL_SAMPLES = 16
"""Fewest numbers of an array that counts among those which a text may describe."""
_UNIT_NAME = re.compile(
    r"^(?:y|ordinate|signal|channel|eng\w*|physical)?[ _]?units?"
    r"(?:[ _]?(?:text|string|label|name|description|symbol))?$",
    re.IGNORECASE,
)
_LABEL_NAMES = (
    re.compile(r"^(?:channel|signal|sensor|y)?[ _]?names?$", re.IGNORECASE),
    re.compile(r"^(?:channel|signal|sensor|y|long)?[ _]?(?:labels?|titles?|long[ _]?name)$", re.IGNORECASE),
)
_ABSCISSA_NAME = re.compile(r"^(?:t|time|zeit|x[ _]?(?:values?|axis|data)|abscissa|time[ _]?stamps?)$", re.IGNORECASE)
_CELL = re.compile(r"(.*)\{\d+\}$")
_DATA_SUFFIX = re.compile(r"[ _]?(?:data|values?|samples|y)$", re.IGNORECASE)


@dataclass(frozen=True)
class Stated:
    """What a file states of a channel; None and empty where it states nothing."""

    unit: str | None = None
    rate_hz: float | None = None
    start_s: float | None = None
    label: str = ""


def column_of(name: str, values: Float[np.ndarray, " samples"], stated: Stated, date_text: str = "") -> Column:
    """Column of a channel with what is stated of it; its label is left out if it is its name."""
    label = "" if stated.label == name else stated.label
    return Column(name, values, stated.unit, stated.rate_hz, date_text, stated.start_s, label=label)


class _Node:
    """An array, or a struct or group around arrays: what is in it, its fields, and how many signals it holds."""

    def __init__(self) -> None:
        self.children: dict[str, _Node] = {}
        self.fields: dict[Path, Field] = {}
        self.signal_count = 0

    @cached_property
    def clock(self) -> tuple[float | None, float | None]:
        """Rate (Hz) and start (s) that the fields state."""
        named: dict[str, object] = {}
        for path, value in self.fields.items():
            if isinstance(value, str) or is_real(value):
                named.setdefault(path[-1], value)
                for unit_path in ((*path[:-1], "unit"), (*path[:-1], "units"), (*path[:-1], "quantity", "label")):
                    if len(path) > 1 and isinstance(unit := self.fields.get(unit_path), str):
                        named.setdefault(f"{path[-1]} units", unit)
        return stated_clock(named)

    @cached_property
    def units(self) -> Texts:
        """Text or list of texts that states the unit of the signals in it."""
        return [
            value
            for path, value in self.fields.items()
            if isinstance(value, str | tuple) and value and not _is_abscissa(path) and _is_unit_field(path)
        ]

    @cached_property
    def labels(self) -> Texts:
        """Texts that name the signals in it, the surest first."""
        return [
            value
            for pattern in _LABEL_NAMES
            for path, value in self.fields.items()
            if isinstance(value, str | tuple) and value and not _is_abscissa(path) and not _is_unit_field(path)
            if pattern.match(path[-1])
        ]

    @cached_property
    def texts(self) -> dict[str, str]:
        """Texts by their paths in lower case."""
        return {".".join(path).lower(): value for path, value in self.fields.items() if isinstance(value, str)}


class StatedFields:
    """Fields and arrays of a file by their paths, added first and then asked for what they state."""

    def __init__(self) -> None:
        self._root, self._kept_values = _Node(), 0
        self._waiting: dict[Path, Field] = {}

    def add_array(self, path: Path, value_count: int) -> None:
        """Add an array, whose struct or group is then no mere description of others."""
        is_signal = value_count >= MIN_SIGNAL_SAMPLES and not _is_abscissa(path)
        node = self._root
        node.signal_count += is_signal
        for name in path:
            node = node.children.setdefault(name, _Node())
            node.signal_count += is_signal

    def add_field(self, path: Path, value: Field) -> None:
        """Add a field; beyond MAX_KEPT_VALUES nothing more is kept."""
        self._kept_values += 1 if isinstance(value, float) else max(len(value), np.size(value))
        if self._kept_values <= MAX_KEPT_VALUES:
            self._waiting[path] = value

    def fields_beside(self, path: Path) -> Mapping[Path, Field]:
        """Fields beside an array, by their paths from its struct or group on."""
        return self._nodes(path[:-1])[-1].fields

    def of_array(self, path: Path, channel_count: int) -> list[Stated]:
        """What is stated of each channel of an array."""
        nodes = self._nodes(path)[::-1]
        rate_hz = next((rate_hz for node in nodes if (rate_hz := node.clock[0]) is not None), None)
        start_s = next((start_s for node in nodes if (start_s := node.clock[1]) is not None), None)
        own_node, is_abscissa = nodes[0], _is_abscissa(path)
        labels, units = channel_count * [""], channel_count * [""]
        for node in nodes[: 1 if is_abscissa else None]:
            if node is own_node or node.signal_count == 1:
                _fill(labels, node.labels, channel_count)
                _fill(
                    units,
                    [channel_count * (unit,) if isinstance(unit, str) else unit for unit in node.units],
                    channel_count,
                )
            else:
                _fill(labels, _lists(node.labels), channel_count)
                _fill(units, _lists(node.units), channel_count)
            if node is own_node and not is_abscissa and len(nodes) > 1:
                _fill(labels, _own_texts(path[-1], nodes[1], ("name", "signalname", "label", "title")), channel_count)
                _fill(units, _own_texts(path[-1], nodes[1], ("unit", "units")), channel_count)
        return [
            Stated(stated_unit(unit), rate_hz, start_s, label.strip())
            for unit, label in zip(units, labels, strict=True)
        ]

    def _nodes(self, path: Path) -> list[_Node]:
        """Nodes from the root to an array, each with its fields."""
        for field_path, value in _with_cells_joined(self._waiting).items():
            node, depth = self._root, 0
            while depth < len(field_path) - 1 and (child := node.children.get(field_path[depth])):
                node = child
                depth += 1
            node.fields[field_path[depth:]] = value
        self._waiting = {}
        nodes = [self._root]
        for name in path:
            nodes.append(nodes[-1].children.get(name) or _Node())
        return nodes


def _with_cells_joined(fields: Mapping[Path, Field]) -> dict[Path, Field]:
    """Fields, with the texts of a cell array (labels{1}, labels{2}, ...) as one list too."""
    joined: dict[Path, Field] = {}
    for path, value in fields.items():
        cell = _CELL.match(path[-1])
        if cell and isinstance(value, str):
            texts = joined.get((*path[:-1], cell[1]), ())
            joined[*path[:-1], cell[1]] = (*texts, value) if isinstance(texts, tuple) else (value,)
        else:
            joined[path] = value
    return joined


def _is_abscissa(path: Path) -> bool:
    return any(map(_ABSCISSA_NAME.match, path))


def _is_unit_field(path: Path) -> bool:
    return _UNIT_NAME.match(path[-1]) is not None or path[-2:] == ("quantity", "label")


def _lists(texts: Texts) -> Texts:
    return [text for text in texts if isinstance(text, tuple)]


def _own_texts(array_name: str, parent: _Node, field_names: Sequence[str]) -> Texts:
    """Texts that bear the name of an array: force_unit, force_name, Channel_1_Header.Unit of Channel_1_Data."""
    stems = dict.fromkeys((array_name.lower(), _DATA_SUFFIX.sub("", array_name).lower()))
    keys = (
        f"{stem}{separator}{field_name}"
        for stem in stems
        for field_name in field_names
        for separator in ("_", "", "_header.", "_info.")
    )
    return [parent.texts[key] for key in keys if key in parent.texts]


def _fill(texts: list[str], stated: Texts, channel_count: int) -> None:
    """Fill what is empty of the texts of the channels from the first that states as many."""
    for stated_texts in stated:
        new_texts = (stated_texts,) if isinstance(stated_texts, str) else stated_texts
        if len(new_texts) == channel_count:
            texts[:] = [text or new_text for text, new_text in zip(texts, new_texts, strict=True)]
            return
