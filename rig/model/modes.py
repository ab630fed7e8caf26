"""Modes of a body with its attachments: point masses, springs, supports, a compliant clamp."""

from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import msgspec
import numpy as np
import scipy
from jaxtyping import Float
from numpy.polynomial.legendre import leggauss

from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.description import Body, Rig, rig_stations
from rig.model.oscillator import Oscillator
from rig.model.structure import SAME_PLACE_M, Structure, structure_of
from rig.model.supports import springs_including_supports

ELEMENT_COUNT = 80
"""Elements of a beam with attachments: its sixteenth mode is within 0.02 % of Bernoulli-Euler theory."""

PLACE_COUNT = 81
"""Places along a beam at which `with_attachments_merged` gives its shapes."""
EIGENVALUE_ROUNDING = 1e-9
"""Share of the highest mode's eigenvalue within which rounding may make one negative: the mesh's highest is 1e5 times
that of the sixteenth mode, of which double precision therefore loses some 2e-11."""


@runtime_checkable
class Modes(Protocol):
    """Modes of a body as a plant needs them; every `Body` implements this protocol."""

    def frequencies_hz(self, count: int) -> Float[np.ndarray, " modes"]: ...
    def damping_ratios(self, count: int) -> Float[np.ndarray, " modes"]: ...
    def shapes(
        self, positions_m: Float[np.ndarray, " stations"], count: int, order: int = 0
    ) -> Float[np.ndarray, "stations modes"]: ...


@dataclass(frozen=True)
class FiniteElementModes:
    """Mass-normalised modes of a beam from its finite elements; every mode keeps the uniform beam's damping ratio."""

    beam: Beam
    node_positions_m: Float[np.ndarray, " nodes"]
    natural_hz: Float[np.ndarray, " all"]
    eigenvectors: Float[np.ndarray, "coordinates all"]

    def frequencies_hz(self, count: int) -> Float[np.ndarray, " modes"]:
        if not 1 <= count <= len(self.natural_hz):
            raise RigError(f"beam {self.beam.name!r}: {count} modes asked for; it has 1 to {len(self.natural_hz)} here")
        return self.natural_hz[:count]

    def damping_ratios(self, count: int) -> Float[np.ndarray, " modes"]:
        return self.beam.damping_ratios(count)

    def shapes(
        self, positions_m: Float[np.ndarray, " stations"], count: int, order: int = 0
    ) -> Float[np.ndarray, "stations modes"]:
        node_weights = [hermite_weights(self.node_positions_m, float(position_m), order) for position_m in positions_m]
        return np.array(node_weights).reshape(len(node_weights), len(self.eigenvectors)) @ self.eigenvectors[:, :count]


@dataclass(frozen=True)
class CoupledModes:
    """Modes of a structure with attachments, as combinations of its own; mode k keeps the damping ratio of mode k."""

    structure: Structure
    natural_hz: Float[np.ndarray, " all"]
    eigenvectors: Float[np.ndarray, "all all"]

    def frequencies_hz(self, count: int) -> Float[np.ndarray, " modes"]:
        if not 1 <= count <= len(self.natural_hz):
            raise RigError(
                f"structure {self.structure.name!r}: {count} modes asked for; it has 1 to {len(self.natural_hz)}"
            )
        return self.natural_hz[:count]

    def damping_ratios(self, count: int) -> Float[np.ndarray, " modes"]:
        return self.structure.damping_ratios(count)

    def shapes(
        self, positions_m: Float[np.ndarray, " stations"], count: int, order: int = 0
    ) -> Float[np.ndarray, "stations modes"]:
        return self.structure.shapes(positions_m, self.structure.max_modes, order) @ self.eigenvectors[:, :count]


Meshed = Beam | Oscillator
"""Bodies whose mass and stiffness are known, not only their modes."""


def mode_count(body: Body, modes_per_beam: int) -> int:
    """Number of modes taken of a body: `modes_per_beam` of a beam, of other bodies at most as many as they have."""
    return modes_per_beam if isinstance(body, Beam) else min(modes_per_beam, body.max_modes)


def modes_of(rig: Rig, body: Body) -> Modes:
    """Modes of a body in this rig: its own if nothing is attached, else with masses, linear springs, supports, clamp.

    A beam with attachments has 80 Hermite elements; a structure's modes are coupled by the attachments, exact except
    for the truncation of its basis. Cubic springs are left out. Mode k keeps the damping ratio of the bare body's.
    """
    point_masses = [mass for mass in rig.masses if mass.station.body == body.name]
    springs = [spring for spring in springs_including_supports(rig) if spring.station.body == body.name]
    clamps = [clamp for clamp in rig.clamps if clamp.body == body.name]
    linear_springs = [spring for spring in springs if spring.stiffness_n_per_m or spring.rotational_n_m_per_rad]
    if not (point_masses or linear_springs or clamps):
        return body
    if isinstance(body, Oscillator):
        return oscillator_with_attachments(rig, body)
    if isinstance(body, Structure):
        return structure_modes_with_attachments(rig, body)
    nodes_m = np.linspace(0, body.length_m, ELEMENT_COUNT + 1)
    mass_matrix, stiffness_matrix = matrices(rig, body, nodes_m)
    held_count = held_coordinate_count(rig, body)
    _check_stable(rig, body, stiffness_matrix[held_count:, held_count:])
    floating_count = _rigid_mode_count(body, nodes_m, stiffness_matrix)
    natural_hz, free_vectors = _natural_modes(
        body, stiffness_matrix[held_count:, held_count:], mass_matrix[held_count:, held_count:], floating_count
    )
    eigenvectors = np.concatenate([np.zeros((held_count, free_vectors.shape[1])), free_vectors])
    return FiniteElementModes(body, nodes_m, natural_hz, eigenvectors)


def with_attachments_merged(rig: Rig) -> Rig:
    """Rig whose point masses, linear springs, supports and clamps are part of its bodies, for what asks bodies for
    their modes: a mass on a stiffer spring, else a structure with the modes `modes_of`.

    Its shapes are given at all stations and at `PLACE_COUNT` places of the body. A structure loses a mode, the highest
    one, for each stiff support: that of the support's own motion.
    """
    stations = [*(mass.station for mass in rig.masses), *(spring.station for spring in springs_including_supports(rig))]
    attached_bodies = {station.body for station in stations} | {clamp.body for clamp in rig.clamps}
    bodies = tuple(_with_attachments_merged(rig, body) if body.name in attached_bodies else body for body in rig.bodies)
    return msgspec.structs.replace(rig, bodies=bodies, masses=(), springs=(), supports=(), clamps=())


def _with_attachments_merged(rig: Rig, body: Body) -> Body:
    modes, count = modes_of(rig, body), body.max_modes
    if isinstance(modes, Oscillator):
        return modes
    if isinstance(body, Structure):
        stiff_supports = [
            support
            for support in rig.supports
            if support.station.body == body.name and support.stiffness_n_per_m is None
        ]
        count = max(1, count - len(stiff_supports))
    stations_m = [station.position_m for station in (*rig_stations(rig), *rig.forces) if station.body == body.name]
    positions_m = np.unique([*stations_m, *body.places(PLACE_COUNT)])
    positions_m = positions_m[np.append(np.diff(positions_m) > SAME_PLACE_M, True)]
    shapes = modes.shapes(positions_m, count)
    condensed_body = structure_of(
        body.name, body.length_m, modes.frequencies_hz(count), modes.damping_ratios(count), positions_m, shapes
    )
    return msgspec.structs.replace(
        condensed_body,
        has_axis=getattr(body, "has_axis", True),
        participations=tuple(participation_or_empty(rig, body, modes, count).tolist()),
    )


def neighbouring_basis_places_m(body: Body, position_m: float) -> tuple[float, ...]:
    """Nearest places (m) on either side at which a modal basis gives shapes; empty where the shapes are known.

    They are known at the places of the basis, and everywhere on a body that is described by mass and stiffness.
    """
    if not isinstance(body, Structure) or body.has_shapes_at(position_m):
        return ()
    places_m = body.positions_m
    next_index = int(np.searchsorted(places_m, position_m))
    return tuple(float(x_m) for x_m in places_m[max(next_index - 1, 0) : next_index + 1])


def structure_modes_with_attachments(rig: Rig, body: Structure) -> CoupledModes:
    """Modes of a structure coupled by masses m and springs k, k_r at places with shapes p and slopes s:

    (1 + sum m p p') q'' + (omega^2 + sum k p p' + k_r s s') q = 0
    """
    mode_total = body.max_modes
    mass_matrix = np.eye(mode_total)
    attached_stiffness = np.zeros((mode_total, mode_total))
    for mass_point in rig.masses:
        if mass_point.station.body == body.name:
            displacement_shape = body.shapes(np.array([mass_point.station.position_m]), mode_total)[0]
            mass_matrix += mass_point.mass_kg * np.outer(displacement_shape, displacement_shape)
    for spring in springs_including_supports(rig):
        if spring.station.body == body.name:
            position_m = np.array([spring.station.position_m])
            displacement_shape, shape_slope = (body.shapes(position_m, mode_total, order)[0] for order in (0, 1))
            attached_stiffness += spring.stiffness_n_per_m * np.outer(displacement_shape, displacement_shape)
            attached_stiffness += spring.rotational_n_m_per_rad * np.outer(shape_slope, shape_slope)
    rigid_count = body.rigid_modes
    floating_count = (
        rigid_count - int(np.linalg.matrix_rank(attached_stiffness[:rigid_count, :rigid_count])) if rigid_count else 0
    )
    stiffness_matrix = np.diag((2 * np.pi * body.frequencies_hz(mode_total)) ** 2) + attached_stiffness
    _check_stable(rig, body, stiffness_matrix)
    return CoupledModes(body, *_natural_modes(body, stiffness_matrix, mass_matrix, floating_count))


def _natural_modes(
    body: Body, stiffness: Float[np.ndarray, "n n"], mass: Float[np.ndarray, "n n"], floating_count: int
) -> tuple[Float[np.ndarray, " modes"], Float[np.ndarray, "n modes"]]:
    """Natural frequencies (Hz) and mass-normalised shapes of all modes; the first `floating_count` are set to 0 Hz.

    So are those that rounding makes imaginary by less than `EIGENVALUE_ROUNDING` of the highest: springs of next to
    nothing hold such a mode. Raises RigError if rounding makes the eigenvalues meaningless.
    """
    message = f"the modes of {body.name!r} are lost in rounding; check it and the masses, springs and clamps it carries"
    try:
        omega_squared, eigenvectors = scipy.linalg.eigh(stiffness, mass, subset_by_index=[0, body.max_modes - 1])
    except np.linalg.LinAlgError as error:
        raise RigError(message) from error
    omega_squared[:floating_count] = 0.0  # rounding would give them a frequency
    omega_squared[(omega_squared < 0) & (omega_squared > -EIGENVALUE_ROUNDING * omega_squared[-1])] = 0.0
    if not (omega_squared >= 0).all():
        raise RigError(message)
    return np.sqrt(omega_squared) / (2 * np.pi), eigenvectors


def _check_stable(rig: Rig, body: Body, stiffness: Float[np.ndarray, "n n"]) -> None:
    """Raise RigError if springs of negative stiffness make the stiffness matrix indefinite."""
    if any(spring.stiffness_n_per_m < 0 for spring in rig.springs if spring.station.body == body.name):
        lowest_eigenvalue, highest_eigenvalue = np.linalg.eigvalsh(stiffness)[[0, -1]]
        if lowest_eigenvalue < -1e-14 * abs(highest_eigenvalue) or highest_eigenvalue <= 0:
            raise RigError(
                f"the springs of negative stiffness on {body.name!r} are more than what holds it; make them weaker"
            )


def oscillator_with_attachments(rig: Rig, body: Oscillator) -> Oscillator:
    """Oscillator with its point masses and linear springs added; it keeps its damping ratio."""
    mass_kg = body.mass_kg + sum(mass.mass_kg for mass in rig.masses if mass.station.body == body.name)
    added_n_per_m = sum(spring.stiffness_n_per_m for spring in rig.springs if spring.station.body == body.name)
    _check_stable(rig, body, np.full((1, 1), body.stiffness_n_per_m + added_n_per_m))
    frequency_hz = float(np.sqrt((body.stiffness_n_per_m + added_n_per_m) / mass_kg)) / (2 * np.pi)
    return msgspec.structs.replace(body, mass_kg=mass_kg, frequency_hz=frequency_hz)


def loaded_mass(rig: Rig, body: Body) -> Body:
    """Single mass with its point masses and linear springs; any other body as it is."""
    return oscillator_with_attachments(rig, body) if isinstance(body, Oscillator) else body


def participation(rig: Rig, body: Body, modes: Modes, count: int) -> Float[np.ndarray, " modes"]:
    """Participation of each mode in a motion of the base: the integral of its shape over the mass, in sqrt(kg)."""
    attached = [mass for mass in rig.masses if mass.station.body == body.name]
    if isinstance(body, Oscillator):
        return oscillator_with_attachments(rig, body).mass_kg * modes.shapes(np.zeros(1), count)[0]
    if isinstance(body, Structure):
        translation = body.translation()
        modal_translation = modes.eigenvectors.T @ translation if isinstance(modes, CoupledModes) else translation
        places_m = np.array([mass.station.position_m for mass in attached])
        return modal_translation[:count] + np.array([mass.mass_kg for mass in attached]) @ modes.shapes(places_m, count)
    gauss_points, gauss_weights = leggauss(400)
    positions_m = (gauss_points + 1) / 2 * body.length_m
    places_m = np.concatenate([positions_m, [mass.station.position_m for mass in attached]])
    masses_kg = np.concatenate([gauss_weights / 2 * body.mass_kg, [mass.mass_kg for mass in attached]])
    return masses_kg @ modes.shapes(places_m, count)


def participation_or_empty(rig: Rig, body: Body, modes: Modes, count: int) -> Float[np.ndarray, " modes"]:
    """`participation`, in sqrt(kg); empty where the modal basis of a held body does not say it."""
    with suppress(RigError):
        return participation(rig, body, modes, count)
    return np.empty(0)


def matrices(
    rig: Rig, body: Meshed, nodes_m: Float[np.ndarray, " nodes"]
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n n"]]:
    """Mass and stiffness matrices with attachments, over the unconstrained (displacement, slope) of every node.

    The only coordinate of a single mass is its displacement.
    """
    mass_matrix, stiffness_matrix = _bare_mass_and_stiffness(body, nodes_m)
    for point_mass in rig.masses:
        if point_mass.station.body == body.name:
            weights = hermite_weights(nodes_m, point_mass.station.position_m)
            mass_matrix += point_mass.mass_kg * np.outer(weights, weights)
    for spring in springs_including_supports(rig):
        if spring.station.body == body.name:
            weights, slope_weights = (hermite_weights(nodes_m, spring.station.position_m, order) for order in (0, 1))
            stiffness_matrix += spring.stiffness_n_per_m * np.outer(weights, weights)
            stiffness_matrix += spring.rotational_n_m_per_rad * np.outer(slope_weights, slope_weights)
    for clamp in rig.clamps:
        if clamp.body == body.name:
            stiffness_matrix[1, 1] += clamp.rotational_n_m_per_rad
    return mass_matrix, stiffness_matrix


def held_coordinate_count(rig: Rig, body: Body) -> int:
    """Number of leading coordinates (displacement, slope) that the clamp of a body fixes."""
    if not isinstance(body, Beam) or body.ends == "free-free":
        return 0
    return 1 if any(clamp.body == body.name for clamp in rig.clamps) else 2


def hermite_weights(nodes_m: Float[np.ndarray, " nodes"], position_m: float, order: int = 0) -> Float[np.ndarray, " n"]:
    """Weights of (displacement, slope) of every node in the displacement at a position, its slope or its curvature.

    Cubic Hermite shapes; the order of the derivative is 0, 1 or 2. A single node is a mass: one coordinate, which has
    neither slope nor curvature.
    """
    if len(nodes_m) == 1:
        return np.full(1, float(order == 0))
    element_index = int(np.clip(np.searchsorted(nodes_m, position_m, side="right") - 1, 0, len(nodes_m) - 2))
    h = nodes_m[element_index + 1] - nodes_m[element_index]
    xi = (position_m - nodes_m[element_index]) / h
    weights = np.zeros(2 * len(nodes_m))
    weights[2 * element_index : 2 * element_index + 4] = (
        (1 - 3 * xi**2 + 2 * xi**3, h * (xi - 2 * xi**2 + xi**3), 3 * xi**2 - 2 * xi**3, h * (xi**3 - xi**2)),
        (6 * (xi**2 - xi) / h, 1 - 4 * xi + 3 * xi**2, 6 * (xi - xi**2) / h, 3 * xi**2 - 2 * xi),
        ((12 * xi - 6) / h**2, (6 * xi - 4) / h, (6 - 12 * xi) / h**2, (6 * xi - 2) / h),
    )[order]
    return weights


def _bare_mass_and_stiffness(
    body: Meshed, nodes_m: Float[np.ndarray, " nodes"]
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n n"]]:
    if isinstance(body, Oscillator):
        return np.full((1, 1), body.mass_kg), np.full((1, 1), body.stiffness_n_per_m)
    coordinate_count = 2 * len(nodes_m)
    mass, stiffness = np.zeros((coordinate_count, coordinate_count)), np.zeros((coordinate_count, coordinate_count))
    for element, h in enumerate(np.diff(nodes_m)):
        scaling = np.diag([1, h, 1, h])
        span = slice(2 * element, 2 * element + 4)
        mass[span, span] += body.mass_per_length_kg_per_m * h / 420 * scaling @ _BEAM_MASS @ scaling
        stiffness[span, span] += body.bending_stiffness_n_m2 / h**3 * scaling @ _BEAM_STIFFNESS @ scaling
    return mass, stiffness


def _rigid_mode_count(beam: Beam, nodes_m: Float[np.ndarray, " nodes"], stiffness: Float[np.ndarray, "n n"]) -> int:
    """Number of rigid motions of a free beam that no spring resists; rounding would give them a frequency."""
    if beam.ends != "free-free":
        return 0
    rotation = (nodes_m - beam.length_m / 2) / beam.length_m
    rotation_slopes = np.full(len(nodes_m), 1 / beam.length_m)
    rigid_motions = np.stack([np.tile([1.0, 0.0], len(nodes_m)), np.stack([rotation, rotation_slopes], axis=1).ravel()])
    rigid_stiffness = rigid_motions @ stiffness @ rigid_motions.T
    stiffness_scale = beam.bending_stiffness_n_m2 / beam.length_m**3
    return 2 - int(np.linalg.matrix_rank(rigid_stiffness, tol=1e-6 * stiffness_scale))


_BEAM_MASS = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]])
_BEAM_STIFFNESS = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])
