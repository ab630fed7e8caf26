"""A body of any shape as its modal basis: modes from a finite-element model or an experimental modal analysis."""

from collections.abc import Sequence
from functools import lru_cache
from typing import ClassVar

import msgspec
import numpy as np
import scipy
from jaxtyping import Float

from rig.errors import RigError

SAME_PLACE_M = 1e-9
MAX_MODAL_VALUE = 1e9
"""Largest frequency (Hz) and shape value (1/sqrt(kg)); larger ones would overflow."""
MAX_TRANSLATION_ERROR = 1e-2
"""Largest error with which rigid-body modes may represent a unit translation."""


class ShapeRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The value of every mode shape at one place, in 1/sqrt(kg); node is its name, by which stations may give it."""

    position_m: float
    values: tuple[float, ...]
    node: str | None = None


class Structure(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="structure"):
    """A body known by its modes alone: frequencies, damping ratios, and mass-normalised shapes at the given places.

    A mode of frequency 0 is a rigid-body motion. Places are metres from the left end, of a body `length_m` long. Only
    at the given places is a shape exact: a cubic spline (scipy.interpolate.CubicSpline) stands for it between them,
    a straight line beyond the first and the last. Where the places have no common axis (has_axis is false), positions
    only number them: between them the nearest one's shapes hold, and slopes are zero. The participations of the modes
    in a motion of the base, the integrals of their shapes over the mass (sqrt(kg)), are known for a free body, and have
    to be given for one that is held, if its base moves.
    """

    is_mass: ClassVar[bool] = False
    clamped: ClassVar[bool] = False

    name: str
    length_m: float
    natural_hz: tuple[float, ...] = msgspec.field(name="frequencies_hz")
    ratios: tuple[float, ...] = msgspec.field(name="damping_ratios")
    rows: tuple[ShapeRow, ...] = msgspec.field(name="shapes")
    has_axis: bool = True
    participations: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not (np.isfinite(self.length_m) and self.length_m > 0):
            raise self._error(f"length_m is {self.length_m}; give a finite value above zero")
        if not self.natural_hz:
            raise self._error("frequencies_hz is empty; give at least one mode")
        if len(self.ratios) != len(self.natural_hz):
            raise self._error(
                f"there are {len(self.ratios)} damping_ratios for {len(self.natural_hz)} frequencies_hz; give one each"
            )
        for mode_hz in self.natural_hz:
            if not 0 <= mode_hz <= MAX_MODAL_VALUE:
                raise self._error(f"a frequency is {mode_hz} Hz; give 0 (a rigid-body mode) to {MAX_MODAL_VALUE:g} Hz")
        if any(np.diff(self.natural_hz) < 0):
            raise self._error("frequencies_hz do not ascend; sort the modes by frequency, rigid-body modes first")
        for ratio in self.ratios:
            if not (np.isfinite(ratio) and ratio >= 0):
                raise self._error(f"a damping ratio is {ratio}; give finite values, zero or above")
        if self.participations and len(self.participations) != len(self.natural_hz):
            raise self._error(
                f"there are {len(self.participations)} participations for {len(self.natural_hz)} frequencies_hz; give "
                "one each, or none"
            )
        if any(not abs(value) <= MAX_MODAL_VALUE for value in self.participations):
            raise self._error(f"participations are {self.participations}; give finite values in sqrt(kg)")
        self._check_rows()

    def _check_rows(self) -> None:
        if not self.rows:
            raise self._error("shapes is empty; give the shapes at the contacts, the sensors and the force")
        for row in self.rows:
            if not 0 <= row.position_m <= self.length_m:
                raise self._error(f"shapes are given at {row.position_m} m; give places from 0 to {self.length_m} m")
            if len(row.values) != len(self.natural_hz):
                raise self._error(
                    f"there are {len(row.values)} shape values at {row.position_m} m for {len(self.natural_hz)} modes; "
                    "give one each"
                )
            for value in row.values:
                if not abs(value) <= MAX_MODAL_VALUE:
                    raise self._error(
                        f"a shape value at {row.position_m} m is {value}; give finite values in 1/sqrt(kg), "
                        f"{MAX_MODAL_VALUE:g} at most"
                    )
        if any(np.diff(self.positions_m) <= SAME_PLACE_M):
            raise self._error("the positions of shapes do not ascend; sort them, each place once")

    @property
    def positions_m(self) -> Float[np.ndarray, " places"]:
        return np.array([row.position_m for row in self.rows])

    @property
    def half_thickness_m(self) -> None:
        """None: the modes do not tell the thickness."""
        return None

    @property
    def kind(self) -> str:
        modes_text = f"modal basis, {self.max_modes} modes"
        if self.participations:
            return modes_text
        try:
            return f"{modes_text}, {np.sum(self.translation() ** 2):.4g} kg"
        except RigError:
            return modes_text

    @property
    def mass_kg(self) -> float:
        """Approximate mass: one over the mean square of the shapes, which of a beam is its mass."""
        return float(1 / np.mean(self.shapes(self.positions_m, self.max_modes) ** 2))

    @property
    def max_modes(self) -> int:
        return len(self.natural_hz)

    @property
    def rigid_modes(self) -> int:
        return self.natural_hz.count(0.0)

    def places(self, _count: int) -> Float[np.ndarray, " places"]:
        """Positions at which the shapes are given, m."""
        return self.positions_m

    def frequencies_hz(self, count: int) -> Float[np.ndarray, " modes"]:
        return np.array(self.natural_hz[: self._checked_count(count)])

    def damping_ratios(self, count: int) -> Float[np.ndarray, " modes"]:
        return np.array(self.ratios[: self._checked_count(count)])

    def scale_damping(self, factor: float) -> "Structure":
        """Structure with all damping ratios times a factor."""
        return msgspec.structs.replace(self, ratios=tuple(ratio * factor for ratio in self.ratios))

    def scale_frequencies(self, factor: float) -> "Structure":
        """Structure with all frequencies times a factor."""
        return msgspec.structs.replace(self, natural_hz=tuple(natural_hz * factor for natural_hz in self.natural_hz))

    def scale_mass(self, factor: float) -> "Structure":
        """Structure with the mass times a factor, at the same frequencies: its shapes are those of a unit mass."""
        sqrt_factor, replace = float(np.sqrt(factor)), msgspec.structs.replace
        rows = tuple(replace(row, values=tuple(value / sqrt_factor for value in row.values)) for row in self.rows)
        return replace(self, rows=rows, participations=tuple(sqrt_factor * g for g in self.participations))

    def shapes(
        self, positions_m: Float[np.ndarray, " stations"], count: int, order: int = 0
    ) -> Float[np.ndarray, "stations modes"]:
        """Shapes at places, in 1/sqrt(kg): as given where they are given, else by the spline.

        Of order 1 or 2 the spline's derivatives along the body, per m or m^2: as good as the places are dense; zero if
        only one place is given.
        """
        return self._interpolated_shapes(positions_m, order)[:, : self._checked_count(count)]

    def has_shapes_at(self, position_m: float) -> bool:
        """True if the modal basis gives shapes at this position."""
        return bool(np.min(np.abs(self.positions_m - position_m)) <= SAME_PLACE_M)

    def node_at(self, position_m: float) -> str | None:
        """Name of the node at this position; None where there is none."""
        return next((row.node for row in self.rows if abs(row.position_m - position_m) <= SAME_PLACE_M), None)

    def translation(self) -> Float[np.ndarray, " modes"]:
        """Participations g of the modes in a translation of the base, in sqrt(kg).

        Of a free body they are the modal coordinates of a unit translation, sum_i phi_i(x) g_i = 1; g.g is its mass.
        Raises RigError where none are given and the rigid-body modes do not contain a translation.
        """
        if self.participations:
            return np.array(self.participations)
        rigid_count = self.rigid_modes
        participations = np.zeros(self.max_modes)
        rigid_shapes = np.array([row.values for row in self.rows])[:, :rigid_count]
        unit_translation = np.ones(len(self.rows))
        if 0 < rigid_count <= len(unit_translation):
            participations[:rigid_count] = np.linalg.lstsq(rigid_shapes, unit_translation, rcond=None)[0]
        if np.max(np.abs(rigid_shapes @ participations[:rigid_count] - unit_translation)) > MAX_TRANSLATION_ERROR:
            raise self._error(
                "its modal basis does not say how its mass follows a moving base; give participations, in sqrt(kg), or "
                "the rigid-body modes (0 Hz) of a free body"
            )
        return participations

    def _interpolated_shapes(
        self, positions_m: Float[np.ndarray, " stations"], order: int
    ) -> Float[np.ndarray, "stations all"]:
        requested_m, row_positions_m = np.asarray(positions_m, dtype=float), self.positions_m
        row_shapes = np.array([row.values for row in self.rows])
        if len(row_positions_m) == 1 or not self.has_axis:
            nearest_shapes = row_shapes[np.abs(requested_m[:, None] - row_positions_m[None, :]).argmin(axis=1)]
            return nearest_shapes if order == 0 else np.zeros_like(nearest_shapes)
        spline = _shape_spline(self.rows)
        clipped_m = np.clip(requested_m, row_positions_m[0], row_positions_m[-1])
        if order:
            return np.asarray(spline(clipped_m, order))
        shapes = np.asarray(spline(clipped_m) + spline(clipped_m, 1) * (requested_m - clipped_m)[:, None])
        if requested_m.size:
            distances = np.abs(requested_m[:, None] - row_positions_m[None, :])
            is_at_row = distances.min(axis=1) <= SAME_PLACE_M
            shapes[is_at_row] = row_shapes[distances.argmin(axis=1)[is_at_row]]
        return shapes

    def _checked_count(self, count: int) -> int:
        if not 1 <= count <= self.max_modes:
            raise self._error(f"{count} modes asked for; its modal basis has 1 to {self.max_modes}")
        return count

    def _error(self, sentence: str) -> RigError:
        return RigError(f"structure {self.name!r}: {sentence}")


def structure_of(
    name: str,
    length_m: float,
    frequencies_hz: Float[np.ndarray, " modes"],
    damping_ratios: Float[np.ndarray, " modes"],
    positions_m: Float[np.ndarray, " places"],
    shapes: Float[np.ndarray, "places modes"],
    node_names: Sequence[str | None] = (),
) -> Structure:
    """Structure from arrays of a finite-element model or a modal analysis, with the names of its nodes if given."""
    row_values = zip(positions_m, shapes.tolist(), node_names or [None] * len(positions_m), strict=True)
    return Structure(
        name=name,
        length_m=float(length_m),
        natural_hz=tuple(frequencies_hz.tolist()),
        ratios=tuple(damping_ratios.tolist()),
        rows=tuple(ShapeRow(float(position_m), tuple(values), node) for position_m, values, node in row_values),
    )


@lru_cache(maxsize=64)
def _shape_spline(rows: tuple[ShapeRow, ...]) -> "scipy.interpolate.CubicSpline":
    return scipy.interpolate.CubicSpline([row.position_m for row in rows], [row.values for row in rows])
