"""MuJoCo's system identification (`mujoco.sysid`): rollouts over windows, least squares over clearance and stiffness.

Every mode is a slide joint of 1 kg with its stiffness and damping. A stop is a tendon over the joints, whose lengths
count by the mode shapes across the contact, and whose spring has a dead band (`springlength="-d d"`): the dead zone
exactly. MuJoCo's own joint limits replace accelerations rather than add forces. Modes above those that move lend each
stop their static compliance. The toolbox has no initial states among its parameters: each window begins at the measured
displacement and velocity, of as many modes a body as it has stations.
"""

from contextlib import redirect_stdout
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import CubicSpline

from scenarios.peers.peer_data import START_CLEARANCE, START_STIFFNESS, ContactAnswer, PeerData, dead_zone
from scenarios.peers.rollouts import stepper

WINDOWS_S = {1: (1 / 16, 1 / 4), 2: (1 / 64, 1 / 16)}
"""Windows by the number of contacts: of the first pass, within which a wrong clearance still lets the motion be
followed, and of the last."""
STEPS_S = {1: 2.0**-10, 2: 2.0**-12}
"""Step of the rollouts by the number of contacts."""


def mujoco_sysid(recording: PeerData) -> tuple[ContactAnswer, ...]:
    """Clearance and stiffness of every contact, with the toolbox's confidence intervals."""
    from mujoco import sysid

    contact_count = len(recording.names)
    parameters = _parameters(recording, sysid)
    for window_s in WINDOWS_S[contact_count]:
        parameters, half_widths = _fitted(recording, parameters, window_s)
    true_values = np.array([recording.true_clearance_m, recording.true_stiffness_n_per_m]).T
    values, half_widths = (true_values * v.reshape(contact_count, 2) for v in (parameters.as_vector(), half_widths))
    return tuple(
        ContactAnswer(
            contact=name,
            clearance_m=float(values[j, 0]),
            stiffness_n_per_m=float(values[j, 1]),
            clearance_half_width_m=float(half_widths[j, 0]),
            stiffness_half_width_n_per_m=float(half_widths[j, 1]),
        )
        for j, name in enumerate(recording.names)
    )


def _fitted(recording: PeerData, start: Any, window_s: float) -> tuple[Any, Float[np.ndarray, " parameters"]]:
    """Parameters that fit the displacements in windows of that length, and half-widths of their 95 % intervals."""
    import mujoco
    from mujoco import rollout, sysid

    spec = mujoco.MjSpec.from_string(_rig_xml(recording))
    model, modes = spec.compile(), _moving_modes(recording)
    window_sample_count = round(window_s * recording.sample_rate_hz)
    first_indices = np.arange(0, recording.force_n.size - window_sample_count, window_sample_count)
    to_modes = np.linalg.pinv(recording.model.sensor_rows[:, modes])
    positions, rates = (to_modes @ s[:, first_indices] for s in (recording.displacement_m, recording.velocity_m_per_s))
    states = np.array([sysid.create_initial_state(model, q, v) for q, v in zip(positions.T, rates.T, strict=True)])
    control_n, steps_a_sample = _control(recording, first_indices, window_s)
    times = first_indices[:, None] + np.arange(1, window_sample_count + 1)
    static = stepper(recording.model, np.isin(np.arange(recording.model.omega.size), modes), 1.0, False)
    measured_m = recording.displacement_m[:, times] - static.output_by_force[:, None, None] * recording.force_n[times]
    data, size_m = mujoco.MjData(model), np.std(recording.displacement_m)

    def residuals(values: Float[np.ndarray, "..."], parameters: Any, **_: Any) -> tuple[list[Any], None, None]:
        """Residuals of all windows, for one vector of parameters or for a matrix of such columns."""
        columns = []
        for column in np.atleast_2d(values.T):
            parameters.update_from_vector(column)
            rig = sysid.apply_param_modifiers(parameters, spec)
            state, _ = rollout.rollout(rig, data, states, control_n)
            mode_motion = state[:, steps_a_sample - 1 :: steps_a_sample, 1 : 1 + modes.size]
            predicted_m = np.einsum("om,wtm->owt", recording.model.sensor_rows[:, modes], mode_motion)
            for j, by_contact in enumerate(static.output_by_contact.T):
                eta_m = mode_motion @ recording.model.contact_rows[j, modes]
                contact_n = rig.tendon_stiffness[j] * dead_zone(eta_m, rig.tendon_lengthspring[j, 1])
                predicted_m += by_contact[:, None, None] * contact_n
            columns.append(((predicted_m - measured_m) / size_m).ravel())
        return [np.array(columns).T if values.ndim > 1 else columns[0]], None, None

    with redirect_stdout(None):  # the toolbox passes on no wish for silence
        fitted, optimum = sysid.optimize(start, residuals, optimizer="scipy", verbose=False, x_scale="jac")
    _, half_widths = sysid.calculate_intervals(residuals(fitted.as_vector(), fitted)[0], np.asarray(optimum.jac))
    return fitted, half_widths


def _moving_modes(recording: PeerData) -> Int[np.ndarray, " moving"]:
    """The lowest modes of every body, as many as it has stations."""
    bodies, stations = np.array(recording.model.bodies), np.array(recording.station_bodies)
    return np.concatenate(
        [np.flatnonzero(bodies == body)[: np.sum(stations == body)] for body in dict.fromkeys(recording.model.bodies)]
    )


def _control(
    recording: PeerData, first_indices: Int[np.ndarray, " windows"], window_s: float
) -> tuple[Float[np.ndarray, "windows steps 1"], int]:
    """Force at the middle of every step, which MuJoCo holds over it, and the number of steps in a sample."""
    samples, step_s = np.arange(recording.force_n.size) / recording.sample_rate_hz, STEPS_S[len(recording.names)]
    steps_a_sample = round(1 / (recording.sample_rate_hz * step_s))
    steps = np.arange(round(window_s / step_s)) + 0.5
    middles_s = first_indices[:, None] / recording.sample_rate_hz + step_s * steps
    return CubicSpline(samples, recording.force_n)(middles_s)[..., None], steps_a_sample


def _parameters(recording: PeerData, sysid: Any) -> Any:
    """Parameters of the toolbox, as shares of the true values so that their sizes are alike."""
    moving = np.isin(np.arange(recording.model.omega.size), _moving_modes(recording))
    compliance_m_per_n = -np.diag(stepper(recording.model, moving, 1.0, False).static_eta_by_contact)
    parameters = sysid.ParameterDict()
    for j, name in enumerate(recording.names):

        def set_clearance(spec: Any, parameter: Any, j: int = j, name: str = name) -> None:
            reach_m = parameter.value[0] * recording.true_clearance_m[j]
            spec.tendon(name).springlength = [-reach_m, reach_m]

        def set_stiffness(spec: Any, parameter: Any, j: int = j, name: str = name) -> None:
            stiffness_n_per_m = parameter.value[0] * recording.true_stiffness_n_per_m[j]
            spec.tendon(name).stiffness[0] = 1 / (1 / stiffness_n_per_m + compliance_m_per_n[j])

        clearance = sysid.Parameter(f"{name} clearance", START_CLEARANCE, 0.1, 3.0, modifier=set_clearance)
        stiffness = sysid.Parameter(f"{name} stiffness", START_STIFFNESS, 0.1, 10.0, modifier=set_stiffness)
        parameters.add(clearance)
        parameters.add(stiffness)
    return parameters


def _rig_xml(recording: PeerData) -> str:
    """The rig as MuJoCo's XML: a joint for every moving mode, tendons for the contacts and for the force."""
    model, modes = recording.model, _moving_modes(recording)
    inertia = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    bodies = "".join(
        f'<body><joint name="mode_{i}" type="slide" axis="1 0 0" stiffness="{model.omega[i] ** 2:.17g}" '
        f'damping="{2 * model.zeta[i] * model.omega[i]:.17g}"/>{inertia}</body>'
        for i in modes
    )

    def tendon(attributes: str, row: Float[np.ndarray, " modes"]) -> str:
        joints = "".join(f'<joint joint="mode_{i}" coef="{row[i]:.17g}"/>' for i in modes)
        return f"<fixed {attributes}>{joints}</fixed>"

    stops = "".join(
        tendon(f'name="{name}" stiffness="{k:.17g}" springlength="{-d:.17g} {d:.17g}"', row)
        for name, k, d, row in zip(
            recording.names,
            recording.true_stiffness_n_per_m,
            recording.true_clearance_m,
            model.contact_rows,
            strict=True,
        )
    )
    return f"""
<mujoco model="rig">
  <option timestep="{STEPS_S[len(recording.names)]}" integrator="RK4" gravity="0 0 0">
    <flag contact="disable" limit="disable"/>
  </option>
  <worldbody>{bodies}</worldbody>
  <tendon>{stops}{tendon('name="force"', model.force_row)}</tendon>
  <actuator><motor name="shaker" tendon="force"/></actuator>
</mujoco>"""
