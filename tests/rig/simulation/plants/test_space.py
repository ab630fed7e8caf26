"""Physics of rigs in space: masses and tubes in rings, against closed forms, a solver, and between the plants."""

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.polynomial.legendre import leggauss
from scipy.integrate import cumulative_trapezoid, solve_ivp

from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.contact_laws import DeadZone
from rig.model.contact_laws.annular import Annular
from rig.model.description import Clamp, Contact, PointMass, PointSpring, Rig, Sensor, StaticLoad, Station, Support
from rig.model.oscillator import Oscillator
from rig.simulation.excitation import force_history
from rig.simulation.motion import Forces, concatenated
from rig.simulation.plants import PLANTS, ancf, modal, plant_named
from rig.simulation.reference import BarrelCradleAnnular

RING = Annular(clearance_m=1e-3, stiffness_n_per_m=2e4, damping_n_s_per_m=20.0, friction_coefficient=0.15)
MASS = Oscillator(name="mass", mass_kg=1.0, frequency_hz=5.0, damping_ratio=0.05)
YZ = ("y", "z")


def simulated(plant, rig, forces_n, step_s, **settings):
    return concatenated(plant(rig, Forces(tuple(forces_n)), step_s, lambda _: None, **settings))


@pytest.fixture(params=PLANTS)
def plant(request):
    return plant_named(request.param)


def mass_in_ring(law, body=MASS, gravity_m_per_s2=0.0, quantities=("displacement", "velocity")):
    return Rig(
        name="ring",
        bodies=(body,),
        contacts=(Contact(name="ring", at=Station("mass"), law=law),),
        force_at=tuple(Station("mass", 0.0, d) for d in YZ),
        sensors=tuple(
            Sensor(name=f"{q} {d}", station=Station("mass", 0.0, d), quantity=q) for q in quantities for d in YZ
        ),
        sample_rate_hz=512.0,
        gravity_m_per_s2=gravity_m_per_s2,
    )


def test_a_mass_driven_round_its_ring_whirls_as_the_closed_form_says(plant):
    """With r the radius and e the angle by which the force leads, in the frame that turns with the force::

    (k_m - m w^2) r + k (r - d) = F cos e,    c_m w r + mu k (r - d) tanh(w r / v_0) = F sin e
    """
    omega, force_n, step_s = 2 * np.pi * 4.0, 6.0, 2.0**-13
    time_s = np.arange(round(4.0 / step_s)) * step_s
    ramp = np.clip(time_s, 0, 1)
    motion = simulated(
        plant, mass_in_ring(RING), ramp * force_n * np.array([np.cos(omega * time_s), np.sin(omega * time_s)]), step_s
    )

    def parts_n(r):
        wall_n = RING.stiffness_n_per_m * (r - RING.clearance_m)
        rub_n = RING.friction_coefficient * wall_n * np.tanh(omega * r / RING.sliding_speed_m_per_s)
        inward = (MASS.stiffness_n_per_m - MASS.mass_kg * omega**2) * r + wall_n
        return inward, MASS.damping_n_s_per_m * omega * r + rub_n

    low, high = RING.clearance_m, 2 * RING.clearance_m
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if np.hypot(*parts_n(middle)) < force_n else (low, middle)
    late = time_s > 3.5
    turned = (motion.eta_m[0] + 1j * motion.eta_m[1])[late] * np.exp(-1j * omega * time_s[late])
    inward, against = parts_n(low)
    assert low > RING.clearance_m
    np.testing.assert_allclose(turned, low * np.exp(-1j * np.arctan2(against, inward)), rtol=1e-4)


def pushed(time_s):
    return np.array([5 * np.sin(2 * np.pi * 3.0 * time_s), 4 * np.sin(2 * np.pi * 4.1 * time_s)])


def test_a_mass_in_a_ring_keeps_its_angular_momentum_and_energy_where_nothing_rubs_or_damps(plant):
    """After a push the wall and the mass's spring pull towards the centre alone."""
    law, body = replace(RING, friction_coefficient=0.0, damping_n_s_per_m=0.0), replace(MASS, damping_ratio=0.0)
    step_s = 2.0**-14
    time_s = np.arange(2**14) * step_s
    push_n = np.where(time_s < 0.05, np.sin(np.pi * time_s / 0.05), 0.0) * np.array([[3.0], [0.0]])
    push_n[1] = np.where((time_s > 0.03) & (time_s < 0.08), 2.0 * np.sin(np.pi * (time_s - 0.03) / 0.05), 0.0)
    y, z, vy, vz = simulated(plant, mass_in_ring(law, body), push_n, step_s).sensed
    free = time_s > 0.08
    depth_m = np.maximum(np.hypot(y, z) - law.clearance_m, 0)
    assert np.count_nonzero(np.diff(depth_m > 0)) > 20
    momentum = (y * vz - z * vy)[free]
    energy_j = (vy**2 + vz**2 + body.stiffness_n_per_m * (y**2 + z**2) + law.stiffness_n_per_m * depth_m**2)[free] / 2
    np.testing.assert_allclose(momentum, momentum[0], rtol=2e-3)
    np.testing.assert_allclose(energy_j, energy_j[0], rtol=2e-3)


def test_what_the_forces_do_on_a_mass_in_a_ring_is_moved_stored_damped_or_rubbed_away(plant):
    step_s = 2.0**-14
    time_s = np.arange(2**14) * step_s
    forces_n = pushed(time_s)
    y, z, vy, vz = simulated(plant, mass_in_ring(RING), forces_n, step_s).sensed
    r = np.hypot(y, z) + 1e-30
    depth_m, out, along = np.maximum(r - RING.clearance_m, 0), (y * vy + z * vz) / r, (y * vz - z * vy) / r
    damping_n = 20.0 * np.minimum(1, depth_m / 1e-5) * out
    wall_n = np.maximum(2e4 * depth_m + damping_n, 0)
    stored_j = (vy**2 + vz**2 + MASS.stiffness_n_per_m * r**2 + 2e4 * depth_m**2) / 2
    lost_w = MASS.damping_n_s_per_m * (vy**2 + vz**2) + (wall_n - 2e4 * depth_m) * out
    lost_w += 0.15 * wall_n * np.abs(along) * np.tanh(np.abs(along) / 0.01)
    given_j, lost_j = (
        cumulative_trapezoid(p, dx=step_s, initial=0) for p in (forces_n[0] * vy + forces_n[1] * vz, lost_w)
    )
    np.testing.assert_allclose(stored_j + lost_j, given_j, atol=2e-3 * np.ptp(given_j))
    assert lost_j[-1] > 0.2 * np.ptp(given_j)


LAWS = (
    replace(RING, center_y_m=3e-4, center_z_m=-2e-4),
    replace(RING, clearance_m=8e-4, wear_m_per_s=2e-4, sliding_speed_m_per_s=0.05, damping_n_s_per_m=0.0),
)


@pytest.mark.parametrize("law", LAWS, ids=["off centre", "worn"])
@pytest.mark.parametrize("gravity", [0.0, 9.81])
def test_a_mass_in_a_ring_moves_as_a_solver_says(plant, law, gravity):
    """The law in complex numbers, integrated by scipy from rest in the ring."""
    step_s, level = 2.0**-14, 1 + gravity / 3
    time_s = np.arange(2**13) * step_s
    exact_m = solved_eta_m(law, gravity, level, time_s)
    motion = simulated(plant, mass_in_ring(law, gravity_m_per_s2=gravity), level * pushed(time_s), step_s)
    assert np.count_nonzero(np.diff(motion.contact_force_n.any(axis=0))) > 1
    np.testing.assert_allclose(motion.eta_m[:, 0], exact_m[:, 0], rtol=1e-6, atol=1e-12)
    assert np.linalg.norm(motion.eta_m - exact_m) < 1e-3 * np.linalg.norm(exact_m)


def test_a_mass_in_a_ring_converges_to_its_solution_at_least_with_the_square_of_the_step(plant):
    levels = np.linspace(0.8, 1.6, 5)  # the error depends on where in a step each contact falls: an average
    common_s = np.arange(2**9) * 2.0**-9
    exact_m = np.array([solved_eta_m(RING, 0.0, level, common_s) for level in levels])
    powers = np.arange(11, 14)
    errors = []
    for power in powers.tolist():
        time_s = np.arange(2**power) * 2.0**-power
        motions = [simulated(plant, mass_in_ring(RING), level * pushed(time_s), 2.0**-power) for level in levels]
        assert all(m.contact_force_n.any() for m in motions)
        errors.append(np.linalg.norm(np.array([m.eta_m[:, :: 2 ** (power - 9)] for m in motions]) - exact_m))
    assert errors[-1] < 1e-3 * np.linalg.norm(exact_m)
    assert -np.polyfit(powers, np.log2(errors), 1)[0] > 1.7


def solved_eta_m(law, gravity, level, time_s):
    """Motion of the mass in its ring from rest under `level` times the push."""
    centre, at_rest = complex(law.center_y_m, law.center_z_m), rest_of(law, gravity)

    def rates(now_s, state):
        eta, rate = complex(*state[:2]) - centre, complex(*state[2:])
        depth_m = abs(eta) - law.clearance_m - law.wear_m_per_s * now_s
        contact_n = 0.0
        if depth_m > 0:
            n = eta / abs(eta)
            radial, sliding = (rate * n.conjugate()).real, (rate * n.conjugate()).imag
            normal = max(0, 2e4 * depth_m + law.damping_n_s_per_m * min(1, depth_m / 1e-5) * radial)
            contact_n = normal * n * (1 + 1j * 0.15 * np.tanh(sliding / law.sliding_speed_m_per_s))
        spring_n = MASS.stiffness_n_per_m * complex(*state[:2]) + MASS.damping_n_s_per_m * rate
        total = complex(*(level * pushed(now_s))) - spring_n - contact_n - gravity
        return [rate.real, rate.imag, total.real, total.imag]

    start = [at_rest.real, at_rest.imag, 0.0, 0.0]
    return solve_ivp(rates, (0, time_s[-1]), start, t_eval=time_s, rtol=1e-9, atol=1e-12, max_step=1e-3).y[:2]


def rest_of(law, gravity):
    """Where the mass's spring and the frictionless ring carry its weight: a zero of the force by Newton's steps."""
    if not gravity:
        return 0j
    eta = np.array([-(law.clearance_m + gravity / 3e4) + law.center_y_m, law.center_z_m / 2])
    for _ in range(50):
        offset = eta - [law.center_y_m, law.center_z_m]
        r = np.hypot(*offset)
        depth_m, n = max(r - law.clearance_m, 0), offset / r
        force_n = MASS.stiffness_n_per_m * eta + 2e4 * depth_m * n + [gravity, 0]
        across = np.eye(2) - np.outer(n, n)
        stiffness = MASS.stiffness_n_per_m * np.eye(2) + 2e4 * (np.outer(n, n) + depth_m / r * across)
        eta = eta - np.linalg.solve(stiffness, force_n)
    return complex(*eta)


def test_a_free_mass_lies_at_the_bottom_of_its_ring(plant):
    """d + m g / k below the centre, at rest as long as no force acts."""
    law, body = replace(RING, center_y_m=2e-4, center_z_m=5e-4), replace(MASS, frequency_hz=0.0, damping_ratio=0.0)
    motion = simulated(plant, mass_in_ring(law, body, gravity_m_per_s2=9.81), np.zeros((2, 512)), 2.0**-13)
    expected_m = [2e-4 - 1e-3 - 9.81 / 2e4, 5e-4]
    np.testing.assert_allclose(motion.eta_m, np.repeat(np.array(expected_m)[:, None], 512, axis=1), atol=1e-9)
    np.testing.assert_allclose(motion.contact_force_n[0], -9.81, rtol=1e-6)


def tube_on_rings(contact_places_m, extra_n=0.0):
    tube = Beam(name="tube", ends="free-free", length_m=1.0, outer_diameter_m=0.03, inner_diameter_m=0.02)
    return Rig(
        name="tube",
        bodies=(tube,),
        contacts=tuple(
            Contact(name=f"ring {k}", at=Station("tube", x), law=replace(RING, stiffness_n_per_m=1e5))
            for k, x in enumerate(contact_places_m)
        ),
        force_at=Station("tube", 1.0, "z"),
        sensors=(Sensor(name="end", station=Station("tube", 1.0), quantity="acceleration"),),
        loads=(StaticLoad(station=Station("tube", 1.0, "z"), force_n=extra_n),) if extra_n else (),
        sample_rate_hz=512.0,
        gravity_m_per_s2=9.81,
    )


def test_a_tube_presses_on_two_rings_by_the_rule_of_the_lever(plant):
    """Its weight, and a force across at its end, divided between the rings by their distances."""
    a, b = 0.1, 0.7
    rig = tube_on_rings((a, b), extra_n=5.0)
    weight_n = rig.bodies[0].mass_kg * 9.81
    motion = simulated(plant, rig, np.zeros((1, 256)), 2.0**-13)
    second_y, second_z = -weight_n * (0.5 - a) / (b - a), 5.0 * (1.0 - a) / (b - a)
    expected_n = [-weight_n - second_y, 5.0 - second_z, second_y, second_z]
    np.testing.assert_allclose(motion.contact_force_n[:, 0], expected_n, rtol=1e-5)
    np.testing.assert_allclose(motion.contact_force_n[:, -1], expected_n, rtol=1e-5)
    assert np.abs(motion.sensed).max() < 1e-3


def test_a_tube_bends_under_its_weight_between_two_stiff_rings(plant):
    """5 w l^4 / (384 E I) at its middle, where the rings hold its ends."""
    rig = tube_on_rings((0.0, 1.0))
    stiff = tuple(replace(c, law=replace(RING, stiffness_n_per_m=1e7)) for c in rig.contacts)
    tube = rig.bodies[0]
    places = (0.0, 0.5, 1.0)
    sensors = tuple(Sensor(name=str(x), station=Station("tube", x), quantity="displacement") for x in places)
    rig = replace(rig, contacts=stiff, sensors=sensors)
    left, middle, right = simulated(plant, rig, np.zeros((1, 16)), 2.0**-16).sensed[:, 0]
    inertia_m4 = np.pi / 64 * (0.03**4 - 0.02**4)
    line_n_per_m = 7850 * np.pi / 4 * (0.03**2 - 0.02**2) * 9.81
    assert middle - (left + right) / 2 == pytest.approx(-5 * line_n_per_m / (384 * 210e9 * inertia_m4), rel=2e-3)
    assert tube.mass_kg * 9.81 == pytest.approx(line_n_per_m)


SHORT = BarrelCradleAnnular(sensors="displacement")
DRIVE_HZ, DRIVE_N = (17.0, 23.0), (150.0, 120.0)


@cache
def short_motion(power, plant_name, **settings):
    step_s = 2.0**-power
    time_s = np.arange(round(5 / 32 / step_s)) * step_s
    ramp = np.sin(np.pi / 2 * np.clip(time_s / 0.05, 0, 1))
    forces_n = [n * ramp * np.sin(2 * np.pi * hz * time_s) for n, hz in zip(DRIVE_N, DRIVE_HZ, strict=True)]
    return simulated(plant_named(plant_name), SHORT.rig(), forces_n, step_s, **settings)


def test_the_modal_plant_comes_to_its_solution_as_the_step_goes_to_zero():
    """Within 1e-4 from 2^-12 s on; friction settles within a step, so that the order shows below 2^-15 s alone."""
    exact_m = short_motion(18, "modal", modes_per_beam=8).eta_m
    errors = []
    for power in (12, 14, 16):
        expected_m = exact_m[:, :: 2 ** (18 - power)]
        error_m = short_motion(power, "modal", modes_per_beam=8).eta_m - expected_m
        errors.append(np.linalg.norm(error_m) / np.linalg.norm(expected_m))
    assert max(errors) < 1e-4
    assert errors[2] < 1e-5


def test_friction_too_sharp_for_the_step_is_refused():
    """A speed of 1 um/s turns the friction round within a share of a step: nothing is delivered that is not solved."""
    rig = SHORT.rig()
    sharp = tuple(replace(c, law=replace(c.law, sliding_speed_m_per_s=1e-6)) for c in rig.contacts)
    time_s = np.arange(2**13) * 2.0**-14
    forces_n = [n * np.sin(2 * np.pi * hz * time_s) for n, hz in zip(DRIVE_N, DRIVE_HZ, strict=True)]
    with pytest.raises(RigError, match=r"diverged near .* s at step .* s; use a smaller step"):
        simulated(modal.simulate, replace(rig, contacts=sharp), forces_n, 2.0**-14)


def test_both_plants_move_the_barrel_in_its_rings_alike_until_chaos_parts_them():
    fast, reference = short_motion(14, "modal"), short_motion(14, "ancf")
    force_n = fast.contact_force_n
    assert np.count_nonzero(force_n.any(axis=0)) > 500
    moved_m = fast.eta_m - fast.eta_m[:, :1]
    assert np.abs(fast.eta_m - reference.eta_m).max() < 5e-3 * np.abs(moved_m).max()
    assert np.linalg.norm(force_n - reference.contact_force_n) < 0.02 * np.linalg.norm(force_n)


def test_weightless_tubes_that_begin_at_rest_are_simulated(plant):
    """While nothing moves, what rounding leaves of the stiff tubes' forces is all that the equations hold."""
    rig, step_s = BarrelCradleAnnular(gravity_m_per_s2=0.0).rig(), 2.0**-15
    time_s = np.arange(400) * step_s
    forces_n = np.array([1e-3 * np.sin(2 * np.pi * 50 * time_s), np.zeros(time_s.size)])
    motion = simulated(plant, rig, forces_n, step_s)
    assert np.isfinite(motion.eta_m).all()
    assert 0 < np.abs(motion.eta_m).max() < 1e-6


def test_a_rig_in_space_that_moves_in_y_alone_is_the_plane_rig_with_dead_zones(plant):
    """Pushed in y, centred, without weight: the ring is a dead zone that does not pull."""
    rig = replace(SHORT.rig(), gravity_m_per_s2=0.0)
    in_y = tuple(s for s in rig.sensors if s.station.direction == "y")
    space = replace(rig, force_at=rig.forces[0])
    zone = DeadZone(
        lower_clearance_m=2e-3, upper_clearance_m=2e-3, stiffness_n_per_m=5e5, damping_n_s_per_m=200.0, pulls=False
    )
    plane = replace(space, contacts=tuple(replace(c, law=zone) for c in rig.contacts), sensors=in_y)
    step_s = 2.0**-14
    time_s = np.arange(2**11) * step_s
    force_n = [200 * np.sin(2 * np.pi * 20 * time_s)]
    expected, motion = (simulated(plant, r, force_n, step_s) for r in (plane, space))
    assert np.count_nonzero(np.diff(expected.contact_force_n != 0)) > 2
    np.testing.assert_allclose(motion.eta_m[::2], expected.eta_m, atol=1e-6 * np.abs(expected.eta_m).max())
    np.testing.assert_allclose(
        motion.contact_force_n[::2], expected.contact_force_n, atol=1e-5 * np.abs(expected.contact_force_n).max()
    )
    assert np.abs(motion.eta_m[1::2]).max() < 1e-12


def test_a_flat_beam_bends_over_its_width_in_z_and_a_spring_there_holds_it_there_alone():
    """The tip of a cantilever gives by l^3 / (3 E I) in each direction, beside its spring in z."""
    beam = Beam(name="beam", ends="clamped-free", length_m=0.5, width_m=0.03, thickness_m=0.01)
    tip = {d: Station("beam", 0.5, d) for d in YZ}
    rig = Rig(
        name="flat",
        bodies=(beam,),
        contacts=(),
        force_at=tip["z"],
        loads=tuple(StaticLoad(station=s, force_n=10.0) for s in tip.values()),
        springs=(PointSpring(station=tip["z"], stiffness_n_per_m=3e4),),
        sensors=tuple(Sensor(name=d, station=s, quantity="displacement") for d, s in tip.items()),
        sample_rate_hz=512.0,
    )
    stiffness = {
        d: 3 * 210e9 * inertia / 0.5**3 for d, inertia in (("y", 0.03 * 0.01**3 / 12), ("z", 0.01 * 0.03**3 / 12))
    }
    at_rest = simulated(modal.simulate, rig, np.zeros((1, 4)), 2.0**-13, modes_per_beam=40).sensed[:, 0]
    np.testing.assert_allclose(at_rest, [10 / stiffness["y"], 10 / (stiffness["z"] + 3e4)], rtol=1e-4)
    with pytest.raises(RigError, match="bends beams in space alike in y and z, and 'beam' is wider than thick; give"):
        simulated(ancf.simulate, rig, np.zeros((1, 4)), 2.0**-13)


def test_a_square_beam_with_a_mass_a_spring_a_support_and_a_clamp_moves_alike_in_both_plants():
    bar = Beam(name="bar", ends="clamped-free", length_m=0.8, width_m=0.02, thickness_m=0.02)
    rig = Rig(
        name="bar",
        bodies=(bar,),
        contacts=(Contact(name="ring", at=Station("bar", 0.8), law=RING),),
        force_at=(Station("bar", 0.8), Station("bar", 0.6, "z")),
        masses=(PointMass(station=Station("bar", 0.4), mass_kg=0.5),),
        springs=(PointSpring(station=Station("bar", 0.6, "z"), stiffness_n_per_m=5e3, rotational_n_m_per_rad=50.0),),
        supports=(Support(station=Station("bar", 0.2), stiffness_n_per_m=1e5),),
        clamps=(Clamp(body="bar", rotational_n_m_per_rad=2e3),),
        sensors=tuple(
            Sensor(name=f"{x} {d}", station=Station("bar", x, d), quantity="displacement")
            for x in (0.5, 0.8)
            for d in YZ
        ),
        sample_rate_hz=512.0,
        gravity_m_per_s2=9.81,
    )
    step_s = 2.0**-14
    time_s = np.arange(2**11) * step_s
    forces_n = [60 * np.sin(2 * np.pi * 12 * time_s), 80 * np.sin(2 * np.pi * 17 * time_s)]
    fast, reference = (simulated(p.simulate, rig, forces_n, step_s) for p in (modal, ancf))
    assert fast.contact_force_n.all(axis=0).any()
    assert np.linalg.norm(fast.sensed - reference.sensed) < 3e-3 * np.linalg.norm(fast.sensed)


def test_the_reference_rig_opens_and_touches_all_around():
    """Each contact is open 20 to 70 % of the time and touches over at least 270 degrees."""
    settings = BarrelCradleAnnular(sensors="displacement")
    rig, step_s = settings.rig(), settings.step_s
    forces_n = [force_history(replace(settings.force(), seed=seed), 9.0, step_s) for seed in (1, 2)]
    motion = simulated(modal.simulate, rig, forces_n, step_s)
    shaken = slice(round(1 / step_s), None)
    for row in (0, 2):
        eta, force_n = (rows[row : row + 2, shaken] for rows in (motion.eta_m, motion.contact_force_n))
        closed = force_n.any(axis=0)
        assert 0.3 < closed.mean() < 0.8
        angles = np.degrees(np.arctan2(eta[1], eta[0]))[closed] % 360
        assert np.unique((angles // 5).astype(int)).size >= 54


def test_a_tube_weighs_and_bends_as_its_ring_of_material():
    """By a quadrature over the radius."""
    tube = Beam(name="tube", ends="free-free", length_m=0.7, outer_diameter_m=0.06, inner_diameter_m=0.04)
    points, weights = leggauss(4)
    radii_m = 0.02 + (points + 1) / 2 * 0.01
    ring_m2, inertia_m4 = (weights / 2 * 0.01 @ (2 * np.pi * radii_m ** (1 + p)) for p in (0, 2))
    assert tube.mass_kg == pytest.approx(7850 * 0.7 * ring_m2)
    assert tube.bending_stiffness_n_m2 == pytest.approx(210e9 * inertia_m4 / 2)
    assert tube.half_thickness_m == 0.03
