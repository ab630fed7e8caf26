"""The finite elements against beam theory."""

import exudyn as exu
import numpy as np
import pytest

from rig.model.beam import Beam
from rig.model.description import Rig, Sensor, Station
from rig.simulation.plants.ancf import ELEMENT_COUNT
from rig.simulation.plants.finite_elements import build
from rig.simulation.reference import BarrelCradle

exu.config.printToConsole = False


def one_beam(end_condition, damping_ratio=0.01):
    tip = Station("beam", 1.0)
    return Rig(
        name="one beam",
        bodies=(
            Beam(
                name="beam",
                ends=end_condition,
                length_m=1.0,
                width_m=0.05,
                thickness_m=0.01,
                damping_ratio=damping_ratio,
            ),
        ),
        contacts=(),
        force_at=tip,
        sensors=(Sensor(name="tip", station=tip, quantity="displacement"),),
        sample_rate_hz=1024.0,
    )


@pytest.fixture
def system():
    container = exu.SystemContainer()
    yield container.AddSystem()
    container.Reset()


@pytest.mark.parametrize("end_condition", ["clamped-free", "free-free"])
def test_first_four_elastic_frequencies_are_within_a_thousandth(system, end_condition):
    rig = one_beam(end_condition)
    beam = rig.bodies[0]
    build(exu, system, rig, [0.0], ELEMENT_COUNT)
    system.Assemble()
    found_hz, _ = system.ComputeODE2Eigenvalues(convert2Frequencies=True)
    assert np.count_nonzero(np.asarray(found_hz) < 1) == (
        3 if end_condition == "free-free" else 0
    )  # rigid in the plane
    errors = [np.abs(found_hz / f - 1).min() for f in beam.frequencies_hz(beam.rigid_modes + 4)[beam.rigid_modes :]]
    print(f"{end_condition}: first four elastic frequencies off by at most {100 * max(errors):.2g} %")
    assert max(errors) < 1e-3


def test_static_tip_deflection_is_within_a_thousandth(system):
    rig = one_beam("clamped-free")
    force_n = 1.0
    meshes, _, _ = build(exu, system, rig, [force_n], ELEMENT_COUNT)
    system.Assemble()
    settings = exu.SimulationSettings()
    settings.solutionSettings.writeSolutionToFile = False
    settings.staticSolver.newton.absoluteTolerance = 1e-6  # newtons; rounding leaves some 1e-8
    assert system.SolveStatic(settings)
    tip = system.GetNodeOutput(meshes[0].node_numbers[-1], exu.OutputVariableType.Displacement)[1]
    expected = force_n / (3 * rig.bodies[0].bending_stiffness_n_m2)
    print(f"static tip deflection off by {100 * (tip / expected - 1):.2g} %")
    assert tip == pytest.approx(expected, rel=1e-3)


def test_nodes_stand_at_contacts_and_force():
    rig = BarrelCradle(overlap_start_m=0.437).rig()
    for station in [s for c in rig.contacts for s in (c.at, c.against)] + [rig.force_at]:
        mesh = next(m for m in meshes_of(rig) if m.body.name == station.body)
        assert np.abs(mesh.positions_m - station.position_m).min() < 1e-12
        node_index = mesh.node_numbers.index(mesh.node_number_at(station.position_m))
        assert mesh.positions_m[node_index] == pytest.approx(station.position_m)
        assert np.diff(mesh.positions_m).max() < 1.001 / ELEMENT_COUNT


def meshes_of(rig):
    container = exu.SystemContainer()
    meshes, _, _ = build(exu, container.AddSystem(), rig, [0.0], ELEMENT_COUNT)
    container.Reset()
    return meshes
