"""The finite elements against beam theory."""

import exudyn as exu
import numpy as np
import pytest
from scipy.signal import find_peaks

from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.description import Rig, Sensor, Station
from rig.simulation.motion import joined
from rig.simulation.plants import ancf
from rig.simulation.reference import BarrelCradle

exu.config.printToConsole = False


def one_beam(ends, damping_ratio=0.01):
    tip = Station("beam", 1.0)
    return Rig(
        name="one beam",
        bodies=(
            Beam(name="beam", ends=ends, length_m=1.0, width_m=0.05, thickness_m=0.01, damping_ratio=damping_ratio),
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


def simulated(rig, force_n, step_s):
    return joined(ancf.simulate(rig, force_n, step_s, lambda _: None))


@pytest.mark.parametrize("ends", ["clamped-free", "free-free"])
def test_first_four_elastic_frequencies_are_within_a_thousandth(system, ends):
    rig = one_beam(ends)
    beam = rig.bodies[0]
    ancf.build(exu, system, rig, [0.0], ancf.ELEMENTS)
    system.Assemble()
    found_hz, _ = system.ComputeODE2Eigenvalues(convert2Frequencies=True)
    assert np.count_nonzero(np.asarray(found_hz) < 1) == (3 if ends == "free-free" else 0)  # rigid in the plane
    errors = [np.abs(found_hz / f - 1).min() for f in beam.frequencies_hz(beam.rigid_modes + 4)[beam.rigid_modes :]]
    print(f"{ends}: first four elastic frequencies off by at most {100 * max(errors):.2g} %")
    assert max(errors) < 1e-3


def test_static_tip_deflection_is_within_a_thousandth(system):
    rig = one_beam("clamped-free")
    force_n = 1.0
    meshes, _, _ = ancf.build(exu, system, rig, [force_n], ancf.ELEMENTS)
    system.Assemble()
    settings = exu.SimulationSettings()
    settings.solutionSettings.writeSolutionToFile = False
    settings.staticSolver.newton.absoluteTolerance = 1e-6  # newtons; rounding leaves some 1e-8
    assert system.SolveStatic(settings)
    tip = system.GetNodeOutput(meshes[0].nodes[-1], exu.OutputVariableType.Displacement)[1]
    expected = force_n / (3 * rig.bodies[0].bending_stiffness_n_m2)
    print(f"static tip deflection off by {100 * (tip / expected - 1):.2g} %")
    assert tip == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("damping_ratio", [0.005, 0.02])
def test_the_first_mode_decays_at_the_set_damping(damping_ratio):
    rig = one_beam("clamped-free", damping_ratio)
    step_s = 2.0**-11
    time_s = np.arange(round(3 / step_s)) * step_s
    blow = np.where(time_s < 0.125, np.sin(np.pi * time_s / 0.125) ** 2, 0.0)
    tip = simulated(rig, blow, step_s).sensed[0]
    late = slice(round(1 / step_s), None)  # the higher modes have gone
    peaks, _ = find_peaks(np.abs(tip[late]))
    decrement = -np.polyfit(time_s[late][peaks], np.log(np.abs(tip[late][peaks])), 1)[0]
    omega = 2 * np.pi * rig.bodies[0].frequencies_hz(1)[0]
    print(f"free decay at {damping_ratio}: damping off by {100 * (decrement / omega / damping_ratio - 1):.2g} %")
    assert decrement / omega == pytest.approx(damping_ratio, rel=0.02)


def test_a_free_beam_keeps_its_momentum():
    rig = one_beam("free-free")
    step_s = 2.0**-11
    force_n = np.zeros(2000)
    force_n[1:40] = 1.0
    motion = simulated(rig, force_n, step_s)
    beam = rig.bodies[0]
    # pushed at its end a free body leaves with F t / m at the centre and turns with 3 times that more at the end
    rate = np.polyfit(np.arange(1000) * step_s, motion.sensed[0, 1000:], 1)[0]
    assert rate == pytest.approx(4 * np.sum(force_n) * step_s / beam.mass_kg, rel=5e-3)


def test_segments_hardly_show(monkeypatch):
    rig = BarrelCradle(stations=4, clearance_1_m=1.0, clearance_2_m=1.0).rig()  # no contact: it would amplify rounding
    step_s = 2.0**-12
    force_n = 40 * np.sin(2 * np.pi * 10 * np.arange(700) * step_s)
    whole = simulated(rig, force_n, step_s)
    monkeypatch.setattr(ancf, "BLOCK_STEPS", 128)
    blocks = list(ancf.simulate(rig, force_n, step_s, lambda _: None))
    assert [round(b.start_s / step_s) for b in blocks] == [0, 129, 257, 385, 513, 641]
    pieces = joined(iter(blocks))
    np.testing.assert_array_equal(pieces.force_n, force_n)
    for name, tolerance in (("displacement_m", 1e-6), ("sensed", 1e-3)):  # displacements and accelerations
        one, other = getattr(whole, name), getattr(pieces, name)
        np.testing.assert_allclose(one, other, atol=tolerance * np.abs(one).max())


def test_nodes_stand_at_contacts_and_force():
    rig = BarrelCradle(overlap_start_m=0.437).rig()
    for station in [s for c in rig.contacts for s in (c.at, c.against)] + [rig.force_at]:
        mesh = next(m for m in meshes_of(rig) if m.body.name == station.body)
        assert np.abs(mesh.positions_m - station.position_m).min() < 1e-12
        assert mesh.positions_m[mesh.nodes.index(mesh.node_at(station.position_m))] == pytest.approx(station.position_m)
        assert np.diff(mesh.positions_m).max() < 1.001 / ancf.ELEMENTS


def meshes_of(rig):
    container = exu.SystemContainer()
    meshes, _, _ = ancf.build(exu, container.AddSystem(), rig, [0.0], ancf.ELEMENTS)
    container.Reset()
    return meshes


def test_a_step_that_the_solver_cannot_take_is_one_clear_sentence(capfd):
    rng = np.random.default_rng(1)
    with pytest.raises(RigError) as caught:
        simulated(BarrelCradle().rig(), 14 * rng.standard_normal(600), 2.0**-5)
    assert "the ancf plant failed between 0.000 and 18.719 s at step 0.03125 s" in str(caught.value)
    assert "use a smaller step or a softer contact" in str(caught.value)
    assert "\n" not in str(caught.value)
    output = capfd.readouterr()
    assert output.out + output.err == ""  # nothing from the solver on the screen
