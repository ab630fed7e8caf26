"""Finite-element mesh of a body: nodes, interpolation rows, and static and inertial loads on its coordinates."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from jaxtyping import Float, Int

from rig.model.beam import Beam
from rig.model.description import Direction, Rig, Station, contact_stations
from rig.model.modes import Meshed, held_coordinate_count, hermite_weights, matrices
from rig.model.space import plane_rigs
from rig.model.supports import springs_including_supports
from rig.simulation.plants.loading import connections, equilibrium

RIGID_OMEGA_SQUARED_RATIO = 1e-14
"""Relative omega^2 below which an eigenvalue is that of a rigid motion, up to rounding."""


@dataclass(frozen=True)
class Mesh:
    """Mesh of a body in Exudyn: node numbers, positions, and directions of motion.

    A node's transverse coordinates are (value, slope) in each direction; a mass has the value alone.
    """

    body: Meshed
    positions_m: Float[np.ndarray, " nodes"]
    node_numbers: tuple[int, ...]
    directions: tuple[Direction, ...] = ("y",)

    def node_number_at(self, position_m: float) -> int:
        return self.node_numbers[int(np.argmin(np.abs(self.positions_m - position_m)))]

    def interpolation_weights(
        self, position_m: float, derivative_order: int = 0, direction: Direction = "y"
    ) -> Float[np.ndarray, " transverse"]:
        """Weights of the transverse coordinates in the motion at a position, or a derivative along the body."""
        weights = np.zeros(self.transverse_per_node * len(self.node_numbers))
        weights[self.body_transverse_indices_of(direction)] = hermite_weights(
            self.positions_m, position_m, derivative_order
        )
        return weights

    def body_transverse_indices_of(self, direction: Direction) -> Int[np.ndarray, " some"]:
        """Places of one direction's coordinates, node by node, among the body's transverse ones."""
        node_count = len(self.node_numbers)
        indices = np.arange(self.transverse_per_node * node_count).reshape(node_count, len(self.directions), -1)
        return indices[:, self.directions.index(direction)].ravel()

    def node_coordinate_indices_of(self, direction: Direction) -> list[int]:
        """Indices of value and slope in one direction among a node's coordinates."""
        displacement_index = 1 + self.directions.index(direction)
        if self.body.is_mass:
            return [displacement_index if self.in_space else 0]
        return [displacement_index, displacement_index + self.coordinate_count_per_node // 2]

    @property
    def in_space(self) -> bool:
        return len(self.directions) > 1

    @property
    def node_transverse_indices(self) -> list[int]:
        """Indices of the transverse motion among a node's coordinates (x, y, z, slope x, slope y, slope z)."""
        return [index for direction in self.directions for index in self.node_coordinate_indices_of(direction)]

    @property
    def transverse_per_node(self) -> int:
        """Number of transverse coordinates of a node."""
        return len(self.directions) * (1 if self.body.is_mass else 2)

    @property
    def coordinate_count_per_node(self) -> int:
        """Number of coordinates of a node: in a plane without z."""
        if self.body.is_mass:
            return 3 if self.in_space else 1
        return 6 if self.in_space else 4


def mesh_positions_m(rig: Rig, beam: Beam, min_element_count: int) -> Float[np.ndarray, " nodes"]:
    """Node positions, m, of at least `min_element_count` elements, with one wherever something acts or is attached."""
    stations = [station for contact in rig.contacts for station in contact_stations(contact)]
    stations += [*rig.forces, *(mass.station for mass in rig.masses), *(load.station for load in rig.loads)]
    stations += [
        *(spring.station for spring in springs_including_supports(rig)),
        *(damper.station for damper in rig.dampers),
    ]
    stations += [tone.station for tone in rig.tones]
    station_positions_m = [station.position_m for station in stations if station.body == beam.name]
    max_element_m = beam.length_m / min_element_count * (1 + 1e-9)
    pieces_m = [
        np.linspace(left_m, right_m, int(np.ceil((right_m - left_m) / max_element_m)) + 1)[:-1]
        for left_m, right_m in pairwise(np.unique([0.0, beam.length_m, *station_positions_m]))
    ]
    return np.append(np.concatenate(pieces_m), beam.length_m)


def station_weights(meshes: list[Mesh], station: Station, derivative_order: int = 0) -> Float[np.ndarray, " rows"]:
    """Weights of all transverse coordinates of all bodies in the motion of a station, or a derivative along it."""
    return np.concatenate(
        [
            mesh.interpolation_weights(station.position_m, derivative_order, station.direction)
            if mesh.body.name == station.body
            else 0.0 * mesh.interpolation_weights(0.0)
            for mesh in meshes
        ]
    )


def static_load(rig: Rig, meshes: list[Mesh]) -> Float[np.ndarray, " rows"]:
    """Static loads and weights on every transverse coordinate, N and N m."""
    weight_n = np.zeros(station_weights(meshes, rig.forces[0]).size)
    if rig.gravity_m_per_s2:
        weight_n = -rig.gravity_m_per_s2 * inertia_against_base(rig, meshes)
    return weight_n + sum(load.force_n * station_weights(meshes, load.station) for load in rig.loads)


def inertia_against_base(rig: Rig, meshes: list[Mesh]) -> Float[np.ndarray, " rows"]:
    """Inertia of every transverse coordinate against a base moving in y: mass matrix times translation, kg and kg m."""
    inertia_by_body = []
    for mesh in meshes:
        body_mass_matrix, _ = matrices(rig, mesh.body, mesh.positions_m)
        body_inertia = np.zeros(mesh.transverse_per_node * len(mesh.node_numbers))
        body_inertia[mesh.body_transverse_indices_of("y")] = (
            body_mass_matrix @ np.tile([1.0, 0.0], len(mesh.node_numbers))[: len(body_mass_matrix)]
        )
        inertia_by_body.append(body_inertia)
    return np.concatenate(inertia_by_body)


def vectors_by_body(
    meshes: list[Mesh], transverse_values: Float[np.ndarray, " rows"]
) -> list[Float[np.ndarray, " coordinates"]]:
    """Vector over all transverse coordinates as one vector per body over all its coordinates; zero axially."""
    body_vectors, first_row = [], 0
    for mesh in meshes:
        node_count, row_count = len(mesh.node_numbers), mesh.transverse_per_node * len(mesh.node_numbers)
        node_values = np.zeros((node_count, mesh.coordinate_count_per_node))
        body_values = transverse_values[first_row : first_row + row_count]
        node_values[:, mesh.node_transverse_indices] = body_values.reshape(node_count, -1)
        body_vectors.append(node_values.ravel())
        first_row += row_count
    return body_vectors


def coordinates_at_rest(rig: Rig, meshes: list[Mesh]) -> Float[np.ndarray, " coordinates"]:
    """All coordinates in equilibrium under the static loads.

    A beam's nodes move inwards as its slope turns them, so that it is not stretched.
    """
    body_vectors = vectors_by_body(meshes, _transverse_at_rest(rig, meshes))
    for mesh, body_vector in zip(meshes, body_vectors, strict=True):
        if not mesh.body.is_mass:
            node_values = body_vector.reshape(len(mesh.node_numbers), -1)
            slope_x_index = mesh.coordinate_count_per_node // 2
            shortening_per_m = np.sum(node_values[:, slope_x_index + 1 :] ** 2, axis=1) / 2
            shortening_steps_m = np.diff(mesh.positions_m) * (shortening_per_m[1:] + shortening_per_m[:-1]) / 2
            node_values[:, slope_x_index] = -shortening_per_m
            node_values[:, 0] = -np.concatenate([[0.0], np.cumsum(shortening_steps_m)])
    return np.concatenate(body_vectors)


def _transverse_at_rest(rig: Rig, meshes: list[Mesh]) -> Float[np.ndarray, " rows"]:
    load_n = static_load(rig, meshes)
    mass_matrix, stiffness_matrix = np.zeros((2, load_n.size, load_n.size))
    clamped_rows, first_row, plane_by_direction = [], 0, plane_rigs(rig)
    for mesh in meshes:
        for direction in mesh.directions:
            row_indices = first_row + mesh.body_transverse_indices_of(direction)
            block_indices = np.ix_(row_indices, row_indices)
            mass_matrix[block_indices], stiffness_matrix[block_indices] = matrices(
                plane_by_direction[direction], mesh.body, mesh.positions_m
            )
            clamped_rows += row_indices[: held_coordinate_count(rig, mesh.body)].tolist()
        first_row += mesh.transverse_per_node * len(mesh.node_numbers)
    free_rows = np.setdiff1d(np.arange(load_n.size), clamped_rows)
    all_connections = connections(rig)
    eta_rows = np.array(
        [
            station_weights(meshes, contact.at) - (station_weights(meshes, contact.against) if contact.against else 0)
            for contact in all_connections
        ]
    ).reshape(len(all_connections), load_n.size)
    omega_squared, shapes = scipy.linalg.eigh(
        stiffness_matrix[np.ix_(free_rows, free_rows)], mass_matrix[np.ix_(free_rows, free_rows)]
    )
    omega_squared = np.where(omega_squared > RIGID_OMEGA_SQUARED_RATIO * omega_squared.max(), omega_squared, 0.0)
    laws = tuple(contact.law for contact in all_connections)
    rest_coordinates = np.zeros(load_n.size)
    rest_coordinates[free_rows] = shapes @ equilibrium(
        omega_squared, eta_rows[:, free_rows] @ shapes, laws, shapes.T @ load_n[free_rows]
    )
    return rest_coordinates
