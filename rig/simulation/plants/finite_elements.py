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
from rig.model.modes import held_coordinate_count, with_attachments
from rig.model.oscillator import Oscillator
from rig.model.space import plane_rigs
from rig.model.supports import attached_springs
from rig.simulation.plants.connectors import ExtraPhysics, GroundedForce, Section, add_contact, add_grounded
from rig.simulation.plants.loading import connections
from rig.simulation.plants.mesh import Mesh, by_node, inertia, mesh_positions, static_load

AXIAL_FACTOR = 0.25
"""Factor on the axial stiffness, whose waves would otherwise limit the step. A much smaller factor would bring axial
resonances into the band of the force: at 0.01 the cradle's, at 129 Hz, changed its tip acceleration by a tenth."""


def build(
    exu: Any,
    mbs: Any,
    rig: Rig,
    first_forces_n: Sequence[float],
    element_count: int,
    extra_physics: tuple[ExtraPhysics, ...] = (),
) -> tuple[list[Mesh], list[int], list[int]]:
    """Add bodies, damping, contacts and loads; return the meshes, the connectors and the loads' numbers.

    The connectors are those of the contacts, an annular one twice, then those of cubic springs, dampers and the extra
    forces. The loads are the exciting forces, with their first values, and the tones.
    """
    sections = [section for section in extra_physics if isinstance(section, Section)]
    rig = _with_nodes_for(rig, extra_physics)
    ground_node = mbs.AddNode(item("NodePointGround")())
    ground_marker = int(mbs.AddMarker(item("MarkerNodeCoordinate")(nodeNumber=ground_node, coordinate=0)))
    meshes = [_add_body(mbs, rig, body, ground_marker, element_count, sections) for body in rig.bodies]
    _add_attachments(mbs, rig, meshes)
    _add_damping(mbs, rig, meshes)

    def displacement_marker(station: Station | None) -> int:
        return ground_marker if station is None else _add_marker(mbs, meshes, station)

    def position_marker(station: Station | None) -> int:
        if station is None:
            ground_body = mbs.AddObject(item("ObjectGround")())
            return int(mbs.AddMarker(item("MarkerBodyPosition")(bodyNumber=ground_body)))
        mesh = next(mesh for mesh in meshes if mesh.body.name == station.body)
        return int(mbs.AddMarker(item("MarkerNodePosition")(nodeNumber=mesh.node_at(station.position_m))))

    connectors: list[int] = []
    for contact in connections(rig):
        if contact.law.spatial and contact.at.direction != "y":
            continue
        marker = position_marker if contact.law.spatial else displacement_marker
        connector = add_contact(exu, mbs, marker(contact.against), marker(contact.at), contact.law)
        connectors += [connector] * (len(rig.directions) if contact.law.spatial else 1)
    for force in extra_physics:
        if isinstance(force, GroundedForce):
            connectors.append(add_grounded(exu, mbs, ground_marker, displacement_marker(force.station), force))
    stations = [*(None if rig.is_on_ground(station) else station for station in rig.forces)]
    stations += [tone.station for tone in rig.tones]
    loads = []
    for station, force_n in zip(stations, [*first_forces_n, *(0.0 for _ in rig.tones)], strict=True):
        load = item("LoadCoordinate")(markerNumber=displacement_marker(station), load=force_n)
        loads.append(int(mbs.AddLoad(load)))
    return meshes, connectors, loads


def _with_nodes_for(rig: Rig, extra_physics: tuple[ExtraPhysics, ...]) -> Rig:
    """Rig with springs of zero stiffness where grounded forces act and sections end, so that nodes are placed there."""
    stations = [force.station for force in extra_physics if isinstance(force, GroundedForce)]
    stations += [
        Station(section.beam, position_m)
        for section in extra_physics
        if isinstance(section, Section)
        for position_m in (section.start_m, section.end_m)
    ]
    return replace(rig, springs=(*rig.springs, *(PointSpring(station=station) for station in stations)))


def _add_marker(mbs: Any, meshes: list[Mesh], station: Station) -> int:
    """Add a marker on the displacement of the node at a station; return its number."""
    mesh = next(mesh for mesh in meshes if mesh.body.name == station.body)
    node, coordinate = mesh.node_at(station.position_m), mesh.node_coordinates_of(station.direction)[0]
    return int(mbs.AddMarker(item("MarkerNodeCoordinate")(nodeNumber=node, coordinate=coordinate)))


def _add_body(mbs: Any, rig: Rig, body: Body, ground_marker: int, element_count: int, sections: list[Section]) -> Mesh:
    add_mesh = _ADD_BODY.get(type(body))
    if add_mesh is None:
        raise RigError(f"the ancf plant meshes beams, and {body.name!r} is a modal basis; simulate it with modal")
    return add_mesh(mbs, rig, body, ground_marker, element_count, sections)


def _add_mass(
    mbs: Any, rig: Rig, body: Oscillator, ground_marker: int, _element_count: int, _sections: list[Section]
) -> Mesh:
    if rig.in_space:
        node = int(mbs.AddNode(item("NodePoint")(referenceCoordinates=[0.0, 0.0, 0.0])))
        mbs.AddObject(item("MassPoint")(nodeNumber=node, physicsMass=with_attachments(rig, body).mass_kg))
    else:
        node = int(mbs.AddNode(item("Node1D")(referenceCoordinates=[0.0])))
        mbs.AddObject(item("Mass1D")(nodeNumber=node, physicsMass=with_attachments(rig, body).mass_kg))
    mesh = Mesh(body, np.zeros(1), (node,), rig.directions)
    for direction, plane in plane_rigs(rig).items():
        loaded_mass, (coordinate,) = with_attachments(plane, body), mesh.node_coordinates_of(direction)
        marker = mbs.AddMarker(item("MarkerNodeCoordinate")(nodeNumber=node, coordinate=coordinate))
        constants = {"stiffness": loaded_mass.stiffness_n_per_m, "damping": loaded_mass.damping_n_s_per_m}
        mbs.AddObject(item("CoordinateSpringDamper")(markerNumbers=[ground_marker, marker], **constants))
    return mesh


def _add_beam(mbs: Any, rig: Rig, body: Beam, ground_marker: int, element_count: int, sections: list[Section]) -> Mesh:
    positions_m, (width, thickness) = mesh_positions(rig, body, element_count), body.area_factors
    if rig.in_space and body.bending_stiffness_n_m2 != body.bending_in_z.bending_stiffness_n_m2:
        raise RigError(
            f"the ancf plant bends beams in space alike in y and z, and {body.name!r} is wider than thick; give a tube "
            "or a square, or simulate it with modal"
        )
    node_type, cable_type, other_references = "NodePoint2DSlope1", "ObjectANCFCable2D", [0, 1, 0]
    if rig.in_space:
        node_type, cable_type, other_references = "NodePointSlope1", "ObjectANCFCable", [0, 0, 1, 0, 0]
    nodes = tuple(
        int(mbs.AddNode(item(node_type)(referenceCoordinates=[position_m, *other_references])))
        for position_m in positions_m
    )
    mesh = Mesh(body, positions_m, nodes, rig.directions)
    middles_m = (positions_m[1:] + positions_m[:-1]) / 2
    axial_stiffness_n = AXIAL_FACTOR * body.youngs_modulus_pa * width * thickness
    for pair, length_m, middle_m in zip(pairwise(nodes), np.diff(positions_m), middles_m, strict=True):
        local = [
            section for section in sections if section.beam == body.name and section.start_m < middle_m < section.end_m
        ]
        stiffness_factor = float(np.prod([section.stiffness_factor for section in local]))
        mass_factor = float(np.prod([section.mass_factor for section in local]))
        cable = item(cable_type)(
            nodeNumbers=[*pair],
            length=length_m,
            massPerLength=mass_factor * body.mass_per_length_kg_per_m,
            bendingStiffness=stiffness_factor * body.bending_stiffness_n_m2,
            axialStiffness=mass_factor * axial_stiffness_n,
        )
        mbs.AddObject(cable)
    if body.clamped:  # a free beam needs no hold lengthwise: no force acts there, its centre stays
        held_count = held_coordinate_count(rig, body)
        held = [k for direction in mesh.directions for k in mesh.node_coordinates_of(direction)[:held_count]]
        for coordinate in (0, *held):
            marker = mbs.AddMarker(item("MarkerNodeCoordinate")(nodeNumber=nodes[0], coordinate=coordinate))
            mbs.AddObject(item("CoordinateConstraint")(markerNumbers=[ground_marker, marker]))
    return mesh


_ADD_BODY: dict[type, Callable[..., Mesh]] = {Beam: _add_beam, Oscillator: _add_mass}
"""Functions that mesh a body, by its type."""


def _add_attachments(mbs: Any, rig: Rig, meshes: list[Mesh]) -> None:
    """Add the beams' point masses, linear springs, supports and clamps as nodal mass and stiffness matrices."""

    def add_matrix(matrix_name: str, station: Station, diagonal_value: float, slope_value: float = 0.0) -> None:
        mesh = next(mesh for mesh in meshes if mesh.body.name == station.body)
        if not mesh.body.is_mass:
            diagonal = np.zeros(mesh.coordinates_per_node)
            diagonal[mesh.node_coordinates_of(station.direction)] = diagonal_value, slope_value
            if matrix_name == "massMatrix" and station.direction == "y":
                diagonal[0] = diagonal_value
            node = mesh.node_at(station.position_m)
            mbs.AddObject(item("ObjectGenericODE2")(nodeNumbers=[node], **{matrix_name: np.diag(diagonal)}))

    for direction, plane in plane_rigs(rig).items():
        for point_mass in plane.masses:
            add_matrix("massMatrix", replace(point_mass.station, direction=direction), point_mass.mass_kg)
        for spring in attached_springs(plane):
            station = replace(spring.station, direction=direction)
            add_matrix("stiffnessMatrix", station, spring.stiffness_n_per_m, spring.rotational_n_m_per_rad)
        for clamp in plane.clamps:
            add_matrix("stiffnessMatrix", Station(clamp.body, 0.0, direction), 0.0, clamp.rotational_n_m_per_rad)


def _add_damping(mbs: Any, rig: Rig, meshes: list[Mesh]) -> None:
    """Add the damping matrix M Phi diag(2 zeta omega) Phi' M of every beam: one damping ratio for all elastic modes."""
    mbs.Assemble()
    mass_matrix, stiffness_matrix, _ = mbs.ComputeLinearizedSystem()
    first_coordinate = 0
    for mesh in meshes:
        coordinate_count = mesh.coordinates_per_node * len(mesh.node_numbers)
        for direction in () if mesh.body.is_mass else mesh.directions:
            free = free_coordinates(rig, mesh, direction)
            block = np.ix_(first_coordinate + free, first_coordinate + free)
            omega_squared, shapes = scipy.linalg.eigh(stiffness_matrix[block], mass_matrix[block])
            damping_rates = 2 * mesh.body.damping_ratio * np.sqrt(np.maximum(omega_squared, 0))
            damping_rates[: mesh.body.rigid_modes] = 0
            mass_times_shapes = mass_matrix[block] @ shapes
            damping_matrix = np.zeros((coordinate_count, coordinate_count))
            damping_matrix[np.ix_(free, free)] = (mass_times_shapes * damping_rates) @ mass_times_shapes.T
            mbs.AddObject(item("ObjectGenericODE2")(nodeNumbers=list(mesh.node_numbers), dampingMatrix=damping_matrix))
        first_coordinate += coordinate_count


def free_coordinates(rig: Rig, mesh: Mesh, direction: Direction = "y") -> Int[np.ndarray, " free"]:
    """Indices of the transverse coordinates of a beam's nodes in one direction that no clamp fixes."""
    first_indices = mesh.coordinates_per_node * np.arange(len(mesh.node_numbers))
    indices = (first_indices[:, None] + mesh.node_coordinates_of(direction)).ravel()
    return indices[held_coordinate_count(rig, mesh.body) :]


def add_loads(mbs: Any, rig: Rig, meshes: list[Mesh]) -> Callable[[float], None]:
    """Add static loads and the base's inertial load; return a function that sets the base's acceleration."""
    static_n, base_inertia = static_load(rig, meshes), inertia(rig, meshes)
    load_type = item("ObjectGenericODE2")
    objects = [
        mbs.AddObject(load_type(nodeNumbers=list(mesh.node_numbers), forceVector=load_n))
        for mesh, load_n in zip(meshes, by_node(meshes, static_n), strict=True)
    ]

    def set_base(acceleration_m_per_s2: float) -> None:
        loads_n = by_node(meshes, static_n - base_inertia * acceleration_m_per_s2)
        for number, load_n in zip(objects, loads_n, strict=True):
            mbs.SetObjectParameter(number, "forceVector", load_n)

    return set_base


def item(name: str) -> Any:
    """Class of that name in Exudyn's item interface, imported on first use."""
    from exudyn import itemInterface

    return getattr(itemInterface, name)
