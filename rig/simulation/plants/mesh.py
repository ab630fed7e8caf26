"""Finite-element mesh of a body: nodes, interpolation rows, and static and inertial loads on its coordinates."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from jaxtyping import Float, Int

from rig.model.beam import Beam
from rig.model.description import Direction, Rig, Station, contact_stations
from rig.model.modes import Meshed, held_coordinates, hermite, matrices
from rig.model.space import plane_rigs
from rig.model.supports import attached_springs
from rig.simulation.plants.loading import connections, equilibrium

ROUNDING = 1e-14
"""Relative omega^2 below which an eigenvalue is that of a rigid motion, up to rounding."""


@dataclass(frozen=True)
class Mesh:
    """Mesh of a body in Exudyn: node numbers, positions, and directions of motion.

    A node's transverse coordinates are (value, slope) in each direction; a mass has the value alone.
    """

    body: Meshed
    positions_m: Float[np.ndarray, " nodes"]
    nodes: tuple[int, ...]
    directions: tuple[Direction, ...] = ("y",)

    def node_at(self, position_m: float) -> int:
        return self.nodes[int(np.argmin(np.abs(self.positions_m - position_m)))]

    def row(self, position_m: float, order: int = 0, direction: Direction = "y") -> Float[np.ndarray, " transverse"]:
        """Weights of the transverse coordinates in the motion at a position, or a derivative along the body."""
        weights = np.zeros(self.per_node_transverse * len(self.nodes))
        weights[self.places_of(direction)] = hermite(self.positions_m, position_m, order)
        return weights

    def places_of(self, direction: Direction) -> Int[np.ndarray, " some"]:
        """Places of one direction's coordinates, node by node, among the body's transverse ones."""
        direction_count = len(self.directions)
        places = np.arange(self.per_node_transverse * len(self.nodes)).reshape(len(self.nodes), direction_count, -1)
        return places[:, self.directions.index(direction)].ravel()

    def coordinates_of(self, direction: Direction) -> list[int]:
        """Indices of value and slope in one direction among a node's coordinates."""
        axis = 1 + self.directions.index(direction)
        if self.body.is_mass:
            return [axis if self.in_space else 0]
        return [axis, axis + self.per_node // 2]

    @property
    def in_space(self) -> bool:
        return len(self.directions) > 1

    @property
    def transverse(self) -> list[int]:
        """Indices of the transverse motion among a node's coordinates (x, y, z, slope x, slope y, slope z)."""
        return [index for direction in self.directions for index in self.coordinates_of(direction)]

    @property
    def per_node_transverse(self) -> int:
        """Number of transverse coordinates of a node."""
        return len(self.directions) * (1 if self.body.is_mass else 2)

    @property
    def per_node(self) -> int:
        """Number of coordinates of a node: in a plane without z."""
        if self.body.is_mass:
            return 3 if self.in_space else 1
        return 6 if self.in_space else 4


def mesh_positions(rig: Rig, beam: Beam, element_count: int) -> Float[np.ndarray, " nodes"]:
    """Node positions of about `element_count` elements, and one wherever something acts on the beam or is attached."""
    stations = [s for contact in rig.contacts for s in contact_stations(contact)]
    stations += [*rig.forces, *(mass.station for mass in rig.masses), *(s.station for s in attached_springs(rig))]
    stations += [*(x.station for x in rig.loads), *(x.station for x in rig.dampers), *(x.station for x in rig.tones)]
    corners_m = np.unique([0.0, beam.length_m, *(s.position_m for s in stations if s.body == beam.name)])
    max_element_m = beam.length_m / element_count * (1 + 1e-9)
    pieces_m = [np.linspace(a, b, int(np.ceil((b - a) / max_element_m)) + 1)[:-1] for a, b in pairwise(corners_m)]
    return np.append(np.concatenate(pieces_m), beam.length_m)


def station_row(meshes: list[Mesh], station: Station, order: int = 0) -> Float[np.ndarray, " rows"]:
    """Weights of all transverse coordinates of all bodies in the motion of a station, or a derivative along it."""
    return np.concatenate(
        [
            mesh.row(station.position_m, order, station.direction)
            if mesh.body.name == station.body
            else 0.0 * mesh.row(0.0)
            for mesh in meshes
        ]
    )


def static_load(rig: Rig, meshes: list[Mesh]) -> Float[np.ndarray, " rows"]:
    """Static loads and weights on every transverse coordinate, N and N m."""
    weight = np.zeros(station_row(meshes, rig.forces[0]).size)
    if rig.gravity_m_per_s2:
        weight = -rig.gravity_m_per_s2 * inertia(rig, meshes)
    return weight + sum(weight.force_n * station_row(meshes, weight.station) for weight in rig.loads)


def inertia(rig: Rig, meshes: list[Mesh]) -> Float[np.ndarray, " rows"]:
    """Inertia of every transverse coordinate against a base moving in y: mass matrix times translation, kg and kg m."""
    rows = []
    for mesh in meshes:
        mass, _ = matrices(rig, mesh.body, mesh.positions_m)
        row = np.zeros(mesh.per_node_transverse * len(mesh.nodes))
        row[mesh.places_of("y")] = mass @ np.tile([1.0, 0.0], len(mesh.nodes))[: len(mass)]
        rows.append(row)
    return np.concatenate(rows)


def by_node(meshes: list[Mesh], transverse: Float[np.ndarray, " rows"]) -> list[Float[np.ndarray, " coordinates"]]:
    """Vector over all transverse coordinates as one vector per body over all its coordinates; zero axially."""
    vectors, first_row = [], 0
    for mesh in meshes:
        row_count = mesh.per_node_transverse * len(mesh.nodes)
        node_values = np.zeros((len(mesh.nodes), mesh.per_node))
        node_values[:, mesh.transverse] = transverse[first_row : first_row + row_count].reshape(len(mesh.nodes), -1)
        vectors.append(node_values.ravel())
        first_row += row_count
    return vectors


def coordinates_at_rest(rig: Rig, meshes: list[Mesh]) -> Float[np.ndarray, " coordinates"]:
    """All coordinates in equilibrium under the static loads.

    A beam's nodes move inwards as its slope turns them, so that it is not stretched.
    """
    vectors = by_node(meshes, _at_rest(rig, meshes))
    for mesh, values in zip(meshes, vectors, strict=True):
        if not mesh.body.is_mass:
            by_node_values = values.reshape(len(mesh.nodes), -1)
            slope_x = mesh.per_node // 2
            shortening_per_m = np.sum(by_node_values[:, slope_x + 1 :] ** 2, axis=1) / 2
            shortening_steps_m = np.diff(mesh.positions_m) * (shortening_per_m[1:] + shortening_per_m[:-1]) / 2
            by_node_values[:, slope_x] = -shortening_per_m
            by_node_values[:, 0] = -np.concatenate([[0.0], np.cumsum(shortening_steps_m)])
    return np.concatenate(vectors)


def _at_rest(rig: Rig, meshes: list[Mesh]) -> Float[np.ndarray, " rows"]:
    load = static_load(rig, meshes)
    mass, stiffness = np.zeros((2, load.size, load.size))
    clamped_rows, first_row, planes = [], 0, plane_rigs(rig)
    for mesh in meshes:
        for direction in mesh.directions:
            places = first_row + mesh.places_of(direction)
            block = np.ix_(places, places)
            mass[block], stiffness[block] = matrices(planes[direction], mesh.body, mesh.positions_m)
            clamped_rows += places[: held_coordinates(rig, mesh.body)].tolist()
        first_row += mesh.per_node_transverse * len(mesh.nodes)
    free = np.setdiff1d(np.arange(load.size), clamped_rows)
    contacts = connections(rig)
    eta_rows = np.array(
        [station_row(meshes, c.at) - (station_row(meshes, c.against) if c.against else 0) for c in contacts]
    ).reshape(len(contacts), load.size)
    omega_squared, shapes = scipy.linalg.eigh(stiffness[np.ix_(free, free)], mass[np.ix_(free, free)])
    omega_squared = np.where(omega_squared > ROUNDING * omega_squared.max(), omega_squared, 0.0)
    laws = tuple(contact.law for contact in contacts)
    coordinates = np.zeros(load.size)
    coordinates[free] = shapes @ equilibrium(omega_squared, eta_rows[:, free] @ shapes, laws, shapes.T @ load[free])
    return coordinates
