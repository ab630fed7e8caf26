"""Contact laws for the compiled loop of the modal plant: their formulas by numba, their numbers as rows of a table."""

import math
import sys
import zlib
from collections.abc import Callable, Sequence
from inspect import unwrap
from pathlib import Path
from types import FunctionType
from typing import Any, no_type_check

import msgspec
import numba
import numpy as np
from numba.extending import overload

import rig.model.contact_laws
from rig.model.contact_laws import LAWS, PLANE_LAWS, ContactLaw
from rig.model.contact_laws.annular import Annular
from rig.model.contact_laws.elementary import beyond, contributes, magnitude, power, root, select, smaller, tanh
from rig.simulation.plants.loading import law_row_spans

NUMBA_OPTIONS = {"fastmath": {"contract", "reassoc", "nsz"}, "error_model": "numpy"}
inlined = numba.njit(inline="always", **NUMBA_OPTIONS)


def _source_checksum() -> int:
    """CRC-32 of the formulas' source: numba caches compiled code by the caller's file and argument types only."""
    files = sorted(path for folder in rig.model.contact_laws.__path__ for path in Path(folder).glob("*.py"))
    return zlib.crc32(b"".join(path.read_bytes() for path in [*files, Path(__file__)]))


ANNULAR_Y, ANNULAR_Z = -1, -2
"""Kinds of the first and the second row of an annular contact."""
LAW_RECORD_TYPE = np.dtype(
    [
        ("kind", "i8"),
        ("acts_in_the_gap", "i8"),
        *((name, "f8") for name in sorted({f for law in LAWS.values() for f in law.__struct_fields__})),
        (f"formulas_{_source_checksum()}", "i8"),
    ]
)
"""Record type with a row per contact and the fields of every kind of law. The last column exists for its name only: a
changed formula makes another type, for which numba compiles anew."""


def law_records(laws: Sequence[ContactLaw]) -> Any:
    """Table with a row of coefficients per law, of any kind; an annular one has two, ANNULAR_Y and ANNULAR_Z."""
    table = np.zeros(len(laws), LAW_RECORD_TYPE)
    for law_record, law in zip(table, laws, strict=True):
        for field_name, value in msgspec.structs.asdict(law).items():
            law_record[field_name] = value
        law_record["kind"] = ANNULAR_Y if law.spatial else PLANE_LAWS.index(type(law))
        law_record["acts_in_the_gap"] = law.acts_in_the_gap
    for _, row_span in law_row_spans(laws):
        table["kind"][row_span.start + 1 : row_span.stop] = ANNULAR_Z
    return table.view(np.recarray)


@no_type_check
def _power(x, exponent):
    value = 1.0
    for _ in range(exponent != 0.0):  # no loop is evaluated ahead of an `if` in the formula, as a bare power would be
        value = x**exponent
    return value


@no_type_check
def _tanh(x):
    """Hyperbolic tangent by its continued fraction at x / 32 and five doublings, to 1e-15: a call slows the loop."""
    t = 0.0
    for _ in range(x != 0.0):
        y = max(-20.0, min(20.0, x)) / 32
        s = y * y
        t = y * (135135 + s * (17325 + s * (378 + s))) / (135135 + s * (62370 + s * (3150 + 28 * s)))
        for _ in range(5):
            t = 2 * t / (1 + t * t)
    return t


_SCALAR_FUNCTIONS: dict[Callable[..., Any], Callable[..., Any]] = {
    contributes: lambda factor: True,  # noqa: ARG005
    beyond: lambda eta, low, high: max(eta - high, 0.0) + min(eta - low, 0.0),
    select: lambda condition, chosen, otherwise: chosen if condition else otherwise,
    smaller: lambda one, other: min(one, other),  # noqa: PLW0108 - numba takes no builtins here
    magnitude: lambda x: abs(x),  # noqa: PLW0108
    power: _power,
    root: lambda x: math.sqrt(x),  # noqa: PLW0108
    tanh: _tanh,
}
"""Scalar implementations of the functions that formulas use."""

for _module in [sys.modules[name] for name in sys.modules if name.startswith(rig.model.contact_laws.__name__)]:
    _helpers = [f for f in vars(_module).values() if isinstance(f, FunctionType) and f.__module__ == _module.__name__]
    _SCALAR_FUNCTIONS = {f: unwrap(f) for f in _helpers} | _SCALAR_FUNCTIONS  # functions that formulas share

for _general, _compiled in _SCALAR_FUNCTIONS.items():
    overload(_general, strict=False)(lambda *_, own=_compiled: own)


def _dispatching_formula(formulas: Sequence[Callable[..., Any]], first_kind: int = 0) -> Any:
    """Compiled formula that dispatches on a row's kind among the formulas from number `first_kind` on."""
    first_formula = inlined(unwrap(formulas[first_kind]))
    if first_kind + 1 == len(formulas):
        return first_formula
    later_formula = _dispatching_formula(formulas, first_kind + 1)

    @inlined
    @no_type_check
    def formula_of_kind(law_record, eta, rate, time_s):
        if law_record.kind == first_kind:
            return first_formula(law_record, eta, rate, time_s)
        return later_formula(law_record, eta, rate, time_s)

    return formula_of_kind


force_n = _dispatching_formula([law.formula for law in PLANE_LAWS])
"""Contact force (N) from (row, eta, eta', t)."""
vector_force_n = inlined(unwrap(Annular.formula))
"""Its components y and z from (row, (eta_y, eta_z), (eta_y', eta_z'), t) of an annular contact."""
