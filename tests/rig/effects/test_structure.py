"""Effects on the structure: frequencies, damping and static deflection."""

import exudyn as exu
import msgspec
import numpy as np
import pytest
from scipy.optimize import brentq

from rig.effects import effect_named, effects
from rig.effects.base import Scale
from rig.errors import RigError
from rig.model.description import PointMass, PointSpring, StaticLoad, Station, Support
from rig.model.modes import FiniteElementModes, modes_of, participation
from rig.simulation.plants.ancf import ELEMENT_COUNT
from rig.simulation.plants.finite_elements import build
from rig.simulation.reference import BarrelCradle, Sdof

MACHINE = BarrelCradle(stations=4).rig()
SDOF = Sdof().rig()


def frequencies_hz(machine, name, count=8):
    return modes_of(machine, machine.body(name)).frequencies_hz(count)


@pytest.mark.parametrize("body", ["cradle", "barrel"])
def test_a_small_mass_lowers_every_frequency_by_its_share_of_the_kinetic_energy(body):
    """Rayleigh: omega^2 falls by m phi(x)^2 of itself, to first order in m."""
    mass_kg, share = 1e-3, 0.8
    machine = effect_named(f"added_mass:mass_kg={mass_kg},relative_position={share},body={body}").applied_to(MACHINE)
    bare = MACHINE.body(body)
    shapes = bare.shapes(np.array([share]), 8)[0, bare.rigid_modes :]
    before, after = (frequencies_hz(m, body)[bare.rigid_modes :] for m in (reference_of(bare), machine))
    fall = 1 - (after / before) ** 2
    np.testing.assert_allclose(fall, mass_kg * shapes**2, rtol=0.01, atol=2e-3 * mass_kg * np.max(shapes**2))
    assert frequencies_hz(machine, body)[: bare.rigid_modes] == pytest.approx(0)


def reference_of(bare):
    """The same beam without an effect, but by the same finite elements: with a mass of next to nothing."""
    station = Station(bare.name, 0.5)
    return msgspec.structs.replace(MACHINE, masses=(PointMass(station=station, mass_kg=1e-12),))


@pytest.mark.parametrize(
    "carried",
    [
        {"masses": (PointMass(station=Station("barrel", 0.3), mass_kg=1e100),)},
        {"springs": (PointSpring(station=Station("barrel", 0.3), stiffness_n_per_m=1e300),)},
    ],
)
def test_a_beam_whose_modes_are_lost_in_rounding_is_refused(carried):
    machine = msgspec.structs.replace(MACHINE, **carried)
    with pytest.raises(RigError, match="the modes of 'barrel' are lost in rounding"):
        modes_of(machine, machine.body("barrel"))


@pytest.mark.parametrize("stiffness_n_per_m", np.logspace(-12, 0, 25))
def test_a_free_beam_on_a_spring_of_next_to_nothing_floats(stiffness_n_per_m):
    spring = PointSpring(station=Station("barrel", 0.0), stiffness_n_per_m=stiffness_n_per_m)
    machine = msgspec.structs.replace(MACHINE, springs=(spring,))
    barrel = machine.body("barrel")
    lowest_hz = modes_of(machine, barrel).frequencies_hz(3)
    assert lowest_hz[1] < 2 * np.sqrt(4 * stiffness_n_per_m / barrel.mass_kg) / (2 * np.pi) + 0.02
    assert lowest_hz[2] == pytest.approx(barrel.frequencies_hz(3)[2], rel=1e-3)


@pytest.mark.parametrize("body", ["cradle", "barrel"])
def test_finite_elements_agree_with_the_analytic_modes(body):
    bare = MACHINE.body(body)
    modes = modes_of(reference_of(bare), bare)
    assert isinstance(modes, FiniteElementModes)
    np.testing.assert_allclose(modes.frequencies_hz(16), bare.frequencies_hz(16), rtol=2e-4, atol=1e-9)
    positions = np.linspace(0, 1, 33)
    elastic = slice(bare.rigid_modes, 16)  # rigid modes may mix
    shapes, exact = (np.abs(m.shapes(positions, 16)[:, elastic]) for m in (modes, bare))
    np.testing.assert_allclose(shapes, exact, atol=2e-3 * exact.max())
    np.testing.assert_allclose(
        np.sum(participation(MACHINE, bare, modes, 40) ** 2),
        np.sum(participation(MACHINE, bare, bare, 40) ** 2),
        rtol=1e-5,
    )


def test_the_participations_of_all_modes_add_up_to_the_mass():
    free, clamped = MACHINE.body("barrel"), MACHINE.body("cradle")
    assert np.sum(participation(MACHINE, free, free, 16) ** 2) == pytest.approx(free.mass_kg)
    remainder = 4 / np.pi**2 / 40  # of the modes beyond: the sum of (2 / beta)^2
    mass_kg = np.sum(participation(MACHINE, clamped, clamped, 40) ** 2)
    assert mass_kg == pytest.approx(clamped.mass_kg * (1 - remainder), rel=1e-3)
    heavier = effect_named("added_mass:mass_kg=0.5").applied_to(MACHINE)
    modes = modes_of(heavier, free)
    assert np.sum(participation(heavier, free, modes, 16) ** 2) == pytest.approx(free.mass_kg + 0.5)


@pytest.mark.parametrize("compliance", [0.003, 0.03, 0.3])
def test_a_clamp_that_gives_has_the_frequencies_of_its_equation(compliance):
    """A beam held at 0 by a rotational spring, free at l: w = A sin + D (cosh - cos) + C sinh of beta x / l."""
    machine = effect_named(f"clamp_compliance:compliance={compliance}").applied_to(MACHINE)
    beam = machine.body("cradle")

    def characteristic(b):
        s, c, sh, ch = np.sin(b), np.cos(b), np.sinh(b), np.cosh(b)
        moment_at_clamp = [1 / compliance, 1 / compliance, -2 * b]
        moment_at_end = [-s, sh, c + ch]
        shear_at_end = [-c, ch, sh - s]
        return np.linalg.det([moment_at_clamp, moment_at_end, shear_at_end]) / ch

    scale = np.sqrt(beam.bending_stiffness_n_m2 / beam.mass_per_length_kg_per_m) / (2 * np.pi * beam.length_m**2)
    for found_hz in frequencies_hz(machine, "cradle", 5):
        beta = np.sqrt(found_hz / scale)
        assert brentq(characteristic, 0.99 * beta, 1.01 * beta, xtol=1e-12) == pytest.approx(beta, rel=1e-5)
    assert np.all(frequencies_hz(machine, "cradle") < frequencies_hz(MACHINE, "cradle"))


def test_a_soft_suspension_moves_a_free_beam_as_a_rigid_body():
    springs = [PointSpring(station=Station("barrel", x), stiffness_n_per_m=10.0) for x in (0.0, 1.0)]
    machine = msgspec.structs.replace(MACHINE, springs=tuple(springs))
    mass_kg = machine.body("barrel").mass_kg
    expected = np.sqrt(np.array([20.0, 60.0]) / mass_kg) / (2 * np.pi)  # k/m and k (l/2)^2 / (m l^2 / 12)
    np.testing.assert_allclose(frequencies_hz(machine, "barrel")[:2], expected, rtol=1e-3)
    hinged = msgspec.structs.replace(
        MACHINE, springs=(PointSpring(station=Station("barrel", 0.5), rotational_n_m_per_rad=5.0),)
    )
    turning = np.sqrt(5.0 / (mass_kg / 12)) / (2 * np.pi)
    np.testing.assert_allclose(frequencies_hz(hinged, "barrel")[:2], [0, turning], rtol=1e-2)


def test_one_mass_with_a_mass_and_a_spring():
    machine = effect_named("added_mass:mass_kg=0.3").applied_to(SDOF)
    machine = msgspec.structs.replace(machine, springs=(PointSpring(station=Station("mass"), stiffness_n_per_m=200.0),))
    body = machine.bodies[0]
    modes = modes_of(machine, body)
    expected = np.sqrt((body.stiffness_n_per_m + 200) / (body.mass_kg + 0.3)) / (2 * np.pi)
    assert modes.frequencies_hz(1)[0] == pytest.approx(expected)
    assert modes.damping_ratios(1)[0] == body.damping_ratio
    assert modes.shapes(np.zeros(1), 1)[0, 0] == pytest.approx(1 / np.sqrt(body.mass_kg + 0.3))


def test_modulus_and_damping():
    stiffer = effect_named("youngs_modulus:factor=1.1,beam=cradle").applied_to(MACHINE)
    ratio = frequencies_hz(stiffer, "cradle") / frequencies_hz(MACHINE, "cradle")
    np.testing.assert_allclose(ratio, np.sqrt(1.1))
    for machine in (MACHINE, SDOF):
        damped = effect_named("structural_damping:factor=2.5").applied_to(machine)
        for body, damped_body in zip(machine.bodies, damped.bodies, strict=True):
            assert damped_body.damping_ratio == pytest.approx(2.5 * body.damping_ratio)


SUPPORTED = msgspec.structs.replace(
    MACHINE, supports=tuple(Support(station=Station(body, 0.35)) for body in ("barrel", "cradle"))
)


@pytest.mark.parametrize(
    "machine",
    [
        *(
            effect_named(text).applied_to(MACHINE)
            for text in (
                "added_mass:relative_position=0.37",
                "added_mass:body=cradle",
                "clamp_compliance",
                "youngs_modulus",
            )
        ),
        SUPPORTED,
        effect_named("support_position").applied_to(SUPPORTED),
    ],
)
def test_the_finite_elements_of_exudyn_have_the_same_frequencies(machine):
    container = exu.SystemContainer()
    system = container.AddSystem()
    build(exu, system, machine, [0.0], ELEMENT_COUNT)
    system.Assemble()
    found_hz, _ = system.ComputeODE2Eigenvalues(convert2Frequencies=True)
    container.Reset()
    for body in machine.bodies:
        for frequency_hz in frequencies_hz(machine, body.name, body.rigid_modes + 4)[body.rigid_modes :]:
            assert np.abs(found_hz / frequency_hz - 1).min() < 1e-3


@pytest.mark.parametrize("machine", [MACHINE, SDOF], ids=["barrel_cradle", "sdof"])
def test_a_hardening_spring_at_rest(run, machine):
    """k w + k3 w^3 = F, with the stiffness of the cantilever's end or of the mass's spring."""
    body = machine.bodies[0]
    cradle = body.name == "cradle"
    stiffness = 3 * body.bending_stiffness_n_m2 / body.length_m**3 if cradle else body.stiffness_n_per_m
    station = Station(body.name, body.length_m)
    hard = effect_named(f"hardening_spring:cubic_n_per_m3={1e4 * stiffness},body={body.name}").applied_to(machine)
    hard = msgspec.structs.replace(
        hard,
        contacts=(),
        loads=(StaticLoad(station=station, force_n=0.01 * stiffness),),
        sensors=tuple(s for s in hard.sensors if s.station == station and s.quantity == "displacement"),
    )
    displacement_m = run(hard, np.zeros(9), 2.0**-13).sensed[0]
    expected = brentq(lambda w: w + 1e4 * w**3 - 0.01, 0, 0.01)
    assert expected < 0.007
    np.testing.assert_allclose(displacement_m, expected, rtol=2e-4)


def test_a_support_that_stands_elsewhere_is_a_spring_there():
    held, moved = (
        msgspec.structs.replace(MACHINE, springs=(PointSpring(station=Station("cradle", at_m), stiffness_n_per_m=1e8),))
        for at_m in (0.6, 0.6 - 0.05)
    )
    assert effect_named("support_position:shift_m=-0.05").applied_to(held) == moved
    assert frequencies_hz(moved, "cradle")[0] < 0.99 * frequencies_hz(held, "cradle")[0]


def test_of_a_body_with_supports_these_move_and_its_springs_stay():
    spring = PointSpring(station=Station("cradle", 0.3), stiffness_n_per_m=1e3)
    held, moved = (
        msgspec.structs.replace(MACHINE, springs=(spring,), supports=(Support(station=Station("cradle", at_m)),))
        for at_m in (0.6, 0.65)
    )
    assert effect_named("support_position:shift_m=0.05").applied_to(held) == moved


def test_supports_stay_on_their_body():
    near_the_end = PointSpring(station=Station("cradle", 0.97), stiffness_n_per_m=1e6)
    machine = msgspec.structs.replace(MACHINE, springs=(near_the_end,))
    kind = effects()["support_position"]
    (place,) = kind.placements(machine, [])
    scale = Scale(machine, 14.0, 60.0).with_place(place)
    shift = kind.parameters(scale)["shift_m"]
    assert (shift.low, shift.high) == pytest.approx((-0.1, 0.03))
    assert kind.typical(scale).shift_m == pytest.approx(-0.01)
    with pytest.raises(RigError, match=r"a point spring stands at 1\.07 m, off 'cradle'"):
        effect_named("support_position:shift_m=0.1").applied_to(machine)
    with pytest.raises(RigError, match="has no support or spring along 'barrel'; choose another place"):
        effect_named("support_position:body=barrel").applied_to(machine)
