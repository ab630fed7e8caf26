"""MuJoCo's system identification (`mujoco.sysid`): rollouts over windows, least squares over clearance and stiffness.

The stop is a tendon over the slide joint whose spring has a dead band (`springlength="-d d"`), which is the dead zone
exactly. MuJoCo's own joint limits replace accelerations rather than add forces. The toolbox has no initial states among
its parameters: each window begins at the measured displacement and velocity.
"""

from contextlib import redirect_stdout
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import CubicSpline

from scenarios.peers.peer_data import START_CLEARANCE, START_STIFFNESS, ContactAnswer, PeerData

WINDOWS_S = (1 / 16, 1 / 4)
"""Windows of the first pass, within which a wrong clearance still lets the motion be followed, and of the last."""
STEP_S = 2.0**-10


def mujoco_sysid(recording: PeerData) -> tuple[ContactAnswer, ...]:
    """Clearance and stiffness of the one-mass rig, with the toolbox's confidence intervals."""
    from mujoco import sysid

    parameters = _parameters(recording, sysid)
    for window_s in WINDOWS_S:
        parameters, half_widths = _fit_windows(recording, parameters, window_s)
    true_values = np.array([recording.true_clearance_m[0], recording.true_stiffness_n_per_m[0]])
    clearance_m, stiffness_n_per_m = true_values * parameters.as_vector()
    clearance_half_width_m, stiffness_half_width_n_per_m = true_values * half_widths
    return (
        ContactAnswer(
            contact=recording.names[0],
            clearance_m=float(clearance_m),
            stiffness_n_per_m=float(stiffness_n_per_m),
            clearance_half_width_m=float(clearance_half_width_m),
            stiffness_half_width_n_per_m=float(stiffness_half_width_n_per_m),
        ),
    )


def _fit_windows(
    recording: PeerData, start_parameters: Any, window_s: float
) -> tuple[Any, Float[np.ndarray, " parameters"]]:
    """Parameters that fit the displacement in windows of that length, and half-widths of their 95 % intervals."""
    import mujoco
    from mujoco import rollout, sysid

    spec = mujoco.MjSpec.from_string(_rig_xml(recording))
    model = spec.compile()
    window_samples = round(window_s * recording.sample_rate_hz)
    first_samples = np.arange(0, recording.force_n.size - window_samples, window_samples)
    states = np.array(
        [
            sysid.create_initial_state(model, recording.displacement_m[:, i], recording.velocity_m_per_s[:, i])
            for i in first_samples
        ]
    )
    control_n, steps_per_sample = _control(recording, first_samples, window_s)
    measured_m = recording.displacement_m[0, first_samples[:, None] + np.arange(1, window_samples + 1)]
    data, scale_m = mujoco.MjData(model), np.std(recording.displacement_m)

    def residuals(values: Float[np.ndarray, "..."], parameters: Any, **_: Any) -> tuple[list[Any], None, None]:
        """Residuals of all windows, for one vector of parameters or for a matrix of such columns."""
        residual_columns = []
        for parameter_vector in np.atleast_2d(values.T):
            parameters.update_from_vector(parameter_vector)
            state, _ = rollout.rollout(sysid.apply_param_modifiers(parameters, spec), data, states, control_n)
            predicted_m = state[:, steps_per_sample - 1 :: steps_per_sample, 1]
            residual_columns.append(((predicted_m - measured_m) / scale_m).ravel())
        return [np.array(residual_columns).T if values.ndim > 1 else residual_columns[0]], None, None

    with redirect_stdout(None):  # the toolbox passes on no wish for silence
        fitted, optimum = sysid.optimize(start_parameters, residuals, optimizer="scipy", verbose=False, x_scale="jac")
    _, half_widths = sysid.calculate_intervals(residuals(fitted.as_vector(), fitted)[0], np.asarray(optimum.jac))
    return fitted, half_widths


def _control(
    recording: PeerData, first_samples: Int[np.ndarray, " windows"], window_s: float
) -> tuple[Float[np.ndarray, "windows steps 1"], int]:
    """Force at the middle of every step, which MuJoCo holds over it, and the number of steps in a sample."""
    sample_times_s = np.arange(recording.force_n.size) / recording.sample_rate_hz
    steps_per_sample = round(1 / (recording.sample_rate_hz * STEP_S))
    step_middles = np.arange(round(window_s / STEP_S)) + 0.5
    middles_s = first_samples[:, None] / recording.sample_rate_hz + STEP_S * step_middles
    return CubicSpline(sample_times_s, recording.force_n)(middles_s)[..., None], steps_per_sample


def _parameters(recording: PeerData, sysid: Any) -> Any:
    """Parameters of the toolbox, as shares of the true values so that their sizes are alike."""
    clearance_m, stiffness_n_per_m = recording.true_clearance_m[0], recording.true_stiffness_n_per_m[0]

    def set_clearance(spec: Any, parameter: Any) -> None:
        clearance = parameter.value[0] * clearance_m
        spec.tendon("stop").springlength = [-clearance, clearance]

    def set_stiffness(spec: Any, parameter: Any) -> None:
        spec.tendon("stop").stiffness[0] = parameter.value[0] * stiffness_n_per_m

    parameters = sysid.ParameterDict()
    parameters.add(sysid.Parameter("clearance", START_CLEARANCE, 0.1, 3.0, modifier=set_clearance))
    parameters.add(sysid.Parameter("stiffness", START_STIFFNESS, 0.1, 10.0, modifier=set_stiffness))
    return parameters


def _rig_xml(recording: PeerData) -> str:
    """One-mass rig as MuJoCo's XML."""
    omega, zeta = recording.model.omega[0], recording.model.zeta[0]
    mass_kg = 1 / recording.model.sensor_rows[0, 0] ** 2
    return f"""
<mujoco model="one_mass">
  <option timestep="{STEP_S}" integrator="RK4" gravity="0 0 0"><flag contact="disable" limit="disable"/></option>
  <worldbody>
    <body name="mass">
      <joint name="slide" type="slide" axis="1 0 0" stiffness="{mass_kg * omega**2:.17g}"
             damping="{2 * mass_kg * zeta * omega:.17g}"/>
      <inertial pos="0 0 0" mass="{mass_kg:.17g}" diaginertia="1 1 1"/>
    </body>
  </worldbody>
  <tendon>
    <fixed name="stop" stiffness="{recording.true_stiffness_n_per_m[0]:.17g}"
           springlength="{-recording.true_clearance_m[0]:.17g} {recording.true_clearance_m[0]:.17g}">
      <joint joint="slide" coef="1"/>
    </fixed>
  </tendon>
  <actuator><motor name="shaker" joint="slide"/></actuator>
  <sensor><jointpos name="displacement" joint="slide"/></sensor>
</mujoco>"""
