"""The modal basis of a beam of several sections, from its finite elements in Exudyn."""

import numpy as np
import scipy
from jaxtyping import Float

from rig.extras import needs_extra
from rig.model.beam import Beam
from rig.model.description import Rig, Station
from rig.model.modes import held_coordinate_count, hermite_weights
from rig.model.structure import Structure, structure_of
from rig.simulation.plants.connectors import Section
from rig.simulation.plants.finite_elements import build, free_coordinate_indices
from rig.simulation.plants.mesh import Mesh

ELEMENT_COUNT = 60


def modal_basis(
    beam: Beam,
    sections: tuple[Section, ...],
    positions_m: Float[np.ndarray, " places"],
    mode_count: int,
    min_element_count: int = ELEMENT_COUNT,
) -> Structure:
    """Beam with its sections as a `Structure`: the first modes at rest, with their shapes at the given positions.

    Elastic modes have the beam's damping ratio. The rigid-body modes of a free beam, which its finite elements give in
    any mixture, become a translation and a rotation about the centre of mass.
    """
    mesh, omega_squared, node_shapes = _bending_modes(beam, sections, min_element_count)
    rigid_count = beam.rigid_modes
    frequencies_hz = np.sqrt(np.maximum(omega_squared[:mode_count], 0)) / (2 * np.pi)
    frequencies_hz[:rigid_count] = 0
    shapes = (
        np.array([hermite_weights(mesh.positions_m, float(position_m)) for position_m in positions_m])
        @ node_shapes[:, :mode_count]
    )
    shapes[:, :rigid_count] = shapes[:, :rigid_count] @ _separating_rotation(node_shapes[0::2, :rigid_count])
    end_signs = np.where(shapes[-1] < 0, -1.0, 1.0)  # at the right end
    return structure_of(
        beam.name, beam.length_m, frequencies_hz, beam.damping_ratios(mode_count), positions_m, shapes * end_signs
    )


def _bending_modes(
    beam: Beam, sections: tuple[Section, ...], min_element_count: int
) -> tuple[Mesh, Float[np.ndarray, " modes"], Float[np.ndarray, "transverse modes"]]:
    """Mesh, omega^2, and mass-normalised shapes over (displacement, slope) of every node."""
    with needs_extra("simulate", "the modal basis of a stepped beam (Exudyn)"):
        import exudyn as exu

    exu.config.printToConsole = False
    exu.config.suppressWarnings = True
    system_container = exu.SystemContainer()
    rig = Rig(name=beam.name, bodies=(beam,), contacts=(), force_at=Station(beam.name), sensors=(), sample_rate_hz=1.0)
    try:
        mbs = system_container.AddSystem()
        (mesh,), _, _ = build(exu, mbs, rig, [0.0], min_element_count, sections)
        mbs.Assemble()
        mass_matrix, stiffness_matrix, _ = mbs.ComputeLinearizedSystem()
    finally:
        system_container.Reset()
    free_indices = free_coordinate_indices(rig, mesh)
    omega_squared, free_shapes = scipy.linalg.eigh(
        stiffness_matrix[np.ix_(free_indices, free_indices)], mass_matrix[np.ix_(free_indices, free_indices)]
    )
    clamped_shapes = np.zeros((held_coordinate_count(rig, beam), omega_squared.size))
    return mesh, omega_squared, np.concatenate([clamped_shapes, free_shapes])


def _separating_rotation(rigid_shapes: Float[np.ndarray, "nodes rigid"]) -> Float[np.ndarray, "rigid rigid"]:
    """Orthogonal matrix that turns two rigid modes into a translation and a rotation; identity without rigid modes."""
    if not rigid_shapes.size:
        return np.eye(rigid_shapes.shape[1])
    translation_weights = np.linalg.lstsq(rigid_shapes, np.ones(len(rigid_shapes)), rcond=None)[0]
    translation_unit_weights = translation_weights / np.linalg.norm(translation_weights)
    return np.stack([translation_unit_weights, [-translation_unit_weights[1], translation_unit_weights[0]]], axis=1)
