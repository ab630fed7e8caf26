"""A rig as finite elements in Exudyn: bodies of ANCF cable elements, attachments, damping, contacts and loads."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from jaxtyping import Int
from msgspec.structs import replace

from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.description import Body, Direction, PointSpring, Rig, Station
from rig.model.modes import held_coordinate_count, oscillator_with_attachments
from rig.model.oscillator import Oscillator
from rig.model.space import plane_rigs
from rig.model.supports import springs_including_supports
from rig.simulation.plants.connectors import ExtraPhysics, GroundedForce, Section, add_contact, add_grounded
from rig.simulation.plants.loading import connections
from rig.simulation.plants.mesh import Mesh, inertia_against_base, mesh_positions_m, static_load, vectors_by_body

AXIAL_STIFFNESS_FACTOR = 0.25
"""Factor on the axial stiffness, whose waves would otherwise limit the step. A much smaller factor would bring axial
resonances into the band of the force: at 0.01 the cradle's, at 129 Hz, changed its tip acceleration by a tenth."""


def build(
    exu: Any,
    mbs: Any,
    rig: Rig,
    first_forces_n: Sequence[float],
    min_element_count: int,
    extra_physics: tuple[ExtraPhysics, ...] = (),
) -> tuple[list[Mesh], list[int], list[int]]:
    """Add bodies, damping, contacts and loads; return the meshes, the connectors and the loads' numbers.

    The connectors are those of the contacts, an annular one twice, then those of cubic springs, dampers and the extra
    forces. The loads are the exciting forces, with their first values, and the tones.
    """
    sections = [section for section in extra_physics if isinstance(section, Section)]
    rig = _with_zero_stiffness_springs(rig, extra_physics)
    ground_node = mbs.AddNode(item("NodePointGround")())
    ground_marker = int(mbs.AddMarker(item("MarkerNodeCoordinate")(nodeNumber=ground_node, coordinate=0)))
    meshes = [_add_body(mbs, rig, body, ground_marker, min_element_count, sections) for body in rig.bodies]
    _add_attachments(mbs, rig, meshes)
    _add_damping(mbs, rig, meshes)

    def displacement_marker(station: Station | None) -> int:
        return ground_marker if station is None else _add_marker(mbs, meshes, station)

    def position_marker(station: Station | None) -> int:
        if station is None:
            ground_object = mbs.AddObject(item("ObjectGround")())
            return int(mbs.AddMarker(item("MarkerBodyPosition")(bodyNumber=ground_object)))
        mesh = next(mesh for mesh in meshes if mesh.body.name == station.body)
        return int(mbs.AddMarker(item("MarkerNodePosition")(nodeNumber=mesh.node_number_at(station.position_m))))

    connector_numbers: list[int] = []
    for contact in connections(rig):
        if contact.law.spatial and contact.at.direction != "y":
            continue
        marker_of = position_marker if contact.law.spatial else displacement_marker
        connector_number = add_contact(exu, mbs, marker_of(contact.against), marker_of(contact.at), contact.law)
        connector_numbers += [connector_number] * (len(rig.directions) if contact.law.spatial else 1)
    for extra in extra_physics:
        if isinstance(extra, GroundedForce):
            connector_numbers.append(add_grounded(exu, mbs, ground_marker, displacement_marker(extra.station), extra))
    loaded_stations = [*(None if rig.is_on_ground(station) else station for station in rig.forces)]
    loaded_stations += [tone.station for tone in rig.tones]
    load_numbers = []
    for station, first_force_n in zip(loaded_stations, [*first_forces_n, *(0.0 for _ in rig.tones)], strict=True):
        load = item("LoadCoordinate")(markerNumber=displacement_marker(station), load=first_force_n)
        load_numbers.append(int(mbs.AddLoad(load)))
    return meshes, connector_numbers, load_numbers


def _with_zero_stiffness_springs(rig: Rig, extra_physics: tuple[ExtraPhysics, ...]) -> Rig:
    """Rig with springs of zero stiffness where grounded forces act and sections end, so that nodes are placed there."""
    node_stations = [extra.station for extra in extra_physics if isinstance(extra, GroundedForce)]
    node_stations += [
        Station(section.beam, position_m)
        for section in extra_physics
        if isinstance(section, Section)
        for position_m in (section.start_m, section.end_m)
    ]
    return replace(rig, springs=(*rig.springs, *(PointSpring(station=station) for station in node_stations)))


def _add_marker(mbs: Any, meshes: list[Mesh], station: Station) -> int:
    """Add a marker on the displacement of the node at a station; return its number."""
    mesh = next(mesh for mesh in meshes if mesh.body.name == station.body)
    node, coordinate = mesh.node_number_at(station.position_m), mesh.node_coordinate_indices_of(station.direction)[0]
    return int(mbs.AddMarker(item("MarkerNodeCoordinate")(nodeNumber=node, coordinate=coordinate)))


def _add_body(mbs: Any, rig: Rig, body: Body, ground_marker: int, min_elements: int, sections: list[Section]) -> Mesh:
    add_mesh = _ADD_BODY_BY_TYPE.get(type(body))
    if add_mesh is None:
        raise RigError(f"the ancf plant meshes beams, and {body.name!r} is a modal basis; simulate it with modal")
    return add_mesh(mbs, rig, body, ground_marker, min_elements, sections)


def _add_mass(
    mbs: Any, rig: Rig, body: Oscillator, ground_marker: int, _min_element_count: int, _sections: list[Section]
) -> Mesh:
    if rig.in_space:
        node_number = int(mbs.AddNode(item("NodePoint")(referenceCoordinates=[0.0, 0.0, 0.0])))
        mbs.AddObject(
            item("MassPoint")(nodeNumber=node_number, physicsMass=oscillator_with_attachments(rig, body).mass_kg)
        )
    else:
        node_number = int(mbs.AddNode(item("Node1D")(referenceCoordinates=[0.0])))
        mbs.AddObject(
            item("Mass1D")(nodeNumber=node_number, physicsMass=oscillator_with_attachments(rig, body).mass_kg)
        )
    mesh = Mesh(body, np.zeros(1), (node_number,), rig.directions)
    for direction, plane_rig in plane_rigs(rig).items():
        loaded_mass, (coordinate_index,) = (
            oscillator_with_attachments(plane_rig, body),
            mesh.node_coordinate_indices_of(direction),
        )
        marker = mbs.AddMarker(item("MarkerNodeCoordinate")(nodeNumber=node_number, coordinate=coordinate_index))
        spring_constants = {"stiffness": loaded_mass.stiffness_n_per_m, "damping": loaded_mass.damping_n_s_per_m}
        mbs.AddObject(item("CoordinateSpringDamper")(markerNumbers=[ground_marker, marker], **spring_constants))
    return mesh


def _add_beam(mbs: Any, rig: Rig, body: Beam, ground_marker: int, min_elements: int, sections: list[Section]) -> Mesh:
    positions_m, (area_factor, other_factor) = mesh_positions_m(rig, body, min_elements), body.area_factors
    if rig.in_space and body.bending_stiffness_n_m2 != body.bending_in_z.bending_stiffness_n_m2:
        raise RigError(
            f"the ancf plant bends beams in space alike in y and z, and {body.name!r} is wider than thick; give a tube "
            "or a square, or simulate it with modal"
        )
    node_type, cable_type, other_coordinates = "NodePoint2DSlope1", "ObjectANCFCable2D", [0, 1, 0]
    if rig.in_space:
        node_type, cable_type, other_coordinates = "NodePointSlope1", "ObjectANCFCable", [0, 0, 1, 0, 0]
    node_numbers = tuple(
        int(mbs.AddNode(item(node_type)(referenceCoordinates=[position_m, *other_coordinates])))
        for position_m in positions_m
    )
    mesh = Mesh(body, positions_m, node_numbers, rig.directions)
    middles_m = (positions_m[1:] + positions_m[:-1]) / 2
    axial_stiffness_n = AXIAL_STIFFNESS_FACTOR * body.youngs_modulus_pa * area_factor * other_factor
    for end_nodes, element_m, middle_m in zip(pairwise(node_numbers), np.diff(positions_m), middles_m, strict=True):
        local_sections = [
            section for section in sections if section.beam == body.name and section.start_m < middle_m < section.end_m
        ]
        stiffness_factor = float(np.prod([section.stiffness_factor for section in local_sections]))
        mass_factor = float(np.prod([section.mass_factor for section in local_sections]))
        cable = item(cable_type)(
            nodeNumbers=[*end_nodes],
            length=element_m,
            massPerLength=mass_factor * body.mass_per_length_kg_per_m,
            bendingStiffness=stiffness_factor * body.bending_stiffness_n_m2,
            axialStiffness=mass_factor * axial_stiffness_n,
        )
        mbs.AddObject(cable)
    if body.clamped:  # a free beam needs no hold lengthwise: no force acts there, its centre stays
        held_count = held_coordinate_count(rig, body)
        held_indices = [
            k for direction in mesh.directions for k in mesh.node_coordinate_indices_of(direction)[:held_count]
        ]
        for coordinate in (0, *held_indices):
            marker = mbs.AddMarker(item("MarkerNodeCoordinate")(nodeNumber=node_numbers[0], coordinate=coordinate))
            mbs.AddObject(item("CoordinateConstraint")(markerNumbers=[ground_marker, marker]))
    return mesh


_ADD_BODY_BY_TYPE: dict[type, Callable[..., Mesh]] = {Beam: _add_beam, Oscillator: _add_mass}
"""Functions that mesh a body, by its type."""


def _add_attachments(mbs: Any, rig: Rig, meshes: list[Mesh]) -> None:
    """Add the beams' point masses, linear springs, supports and clamps as nodal mass and stiffness matrices."""

    def add_matrix(matrix_name: str, station: Station, displacement_value: float, slope_value: float = 0.0) -> None:
        mesh = next(mesh for mesh in meshes if mesh.body.name == station.body)
        if not mesh.body.is_mass:
            diagonal = np.zeros(mesh.coordinate_count_per_node)
            diagonal[mesh.node_coordinate_indices_of(station.direction)] = displacement_value, slope_value
            if matrix_name == "massMatrix" and station.direction == "y":
                diagonal[0] = displacement_value
            node_number = mesh.node_number_at(station.position_m)
            mbs.AddObject(item("ObjectGenericODE2")(nodeNumbers=[node_number], **{matrix_name: np.diag(diagonal)}))

    for direction, plane_rig in plane_rigs(rig).items():
        for point_mass in plane_rig.masses:
            add_matrix("massMatrix", replace(point_mass.station, direction=direction), point_mass.mass_kg)
        for spring in springs_including_supports(plane_rig):
            station = replace(spring.station, direction=direction)
            add_matrix("stiffnessMatrix", station, spring.stiffness_n_per_m, spring.rotational_n_m_per_rad)
        for clamp in plane_rig.clamps:
            add_matrix("stiffnessMatrix", Station(clamp.body, 0.0, direction), 0.0, clamp.rotational_n_m_per_rad)


def _add_damping(mbs: Any, rig: Rig, meshes: list[Mesh]) -> None:
    """Add the damping matrix M Phi diag(2 zeta omega) Phi' M of every beam: one damping ratio for all elastic modes."""
    mbs.Assemble()
    mass_matrix, stiffness_matrix, _ = mbs.ComputeLinearizedSystem()
    first_coordinate = 0
    for mesh in meshes:
        coordinate_count = mesh.coordinate_count_per_node * len(mesh.node_numbers)
        for direction in () if mesh.body.is_mass else mesh.directions:
            free_rows = free_coordinate_indices(rig, mesh, direction)
            block_indices = np.ix_(first_coordinate + free_rows, first_coordinate + free_rows)
            omega_squared, shapes = scipy.linalg.eigh(stiffness_matrix[block_indices], mass_matrix[block_indices])
            damping_rates = 2 * mesh.body.damping_ratio * np.sqrt(np.maximum(omega_squared, 0))
            damping_rates[: mesh.body.rigid_modes] = 0
            mass_times_shapes = mass_matrix[block_indices] @ shapes
            damping_matrix = np.zeros((coordinate_count, coordinate_count))
            damping_matrix[np.ix_(free_rows, free_rows)] = (mass_times_shapes * damping_rates) @ mass_times_shapes.T
            mbs.AddObject(item("ObjectGenericODE2")(nodeNumbers=list(mesh.node_numbers), dampingMatrix=damping_matrix))
        first_coordinate += coordinate_count


def free_coordinate_indices(rig: Rig, mesh: Mesh, direction: Direction = "y") -> Int[np.ndarray, " free"]:
    """Indices of the transverse coordinates of a beam's nodes in one direction that no clamp fixes."""
    node_first_indices = mesh.coordinate_count_per_node * np.arange(len(mesh.node_numbers))
    transverse_indices = (node_first_indices[:, None] + mesh.node_coordinate_indices_of(direction)).ravel()
    return transverse_indices[held_coordinate_count(rig, mesh.body) :]


def add_loads(mbs: Any, rig: Rig, meshes: list[Mesh]) -> Callable[[float], None]:
    """Add static loads and the base's inertial load; return a function that sets the base's acceleration."""
    static_loads, base_inertia = static_load(rig, meshes), inertia_against_base(rig, meshes)
    load_type = item("ObjectGenericODE2")
    load_object_numbers = [
        mbs.AddObject(load_type(nodeNumbers=list(mesh.node_numbers), forceVector=load_n))
        for mesh, load_n in zip(meshes, vectors_by_body(meshes, static_loads), strict=True)
    ]

    def set_base(acceleration_m_per_s2: float) -> None:
        loads_n = vectors_by_body(meshes, static_loads - base_inertia * acceleration_m_per_s2)
        for number, load_n in zip(load_object_numbers, loads_n, strict=True):
            mbs.SetObjectParameter(number, "forceVector", load_n)

    return set_base


def item(name: str) -> Any:
    """Class of that name in Exudyn's item interface, imported on first use."""
    from exudyn import itemInterface

    return getattr(itemInterface, name)
