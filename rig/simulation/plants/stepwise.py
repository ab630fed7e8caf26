"""Modal plant step by step, for programs that compute the force during the run."""

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.model.description import Rig
from rig.model.space import check_plane
from rig.simulation.plants.loading import check_softening_limits, has_static_load, softening_limits_m
from rig.simulation.plants.modal import model_of, sensed_quantities, stepping_constants


class Stepwise:
    """Rig simulated from rest as in `modal.simulate`, with a force that is known step by step.

    Over every step of step_s the force goes linearly from the last value to the given one. Raises RigError if
    several forces act, the base shakes, or a contact is too stiff for the step.
    """

    def __init__(self, rig: Rig, step_s: float, modes_per_beam: int = 16) -> None:
        check_plane(rig, "a run step by step, as in an FMU,")
        if len(rig.forces) > 1:
            raise RigError(
                f"rig {rig.name!r}: {len(rig.forces)} forces act on it, and one is given step by step; leave one in "
                "force_at"
            )
        if rig.base_motion or rig.base_sensors:
            raise RigError(
                f"rig {rig.name!r}: its base shakes, and the force alone is given step by step; leave it out"
            )
        self.rig, self.step_s = rig, step_s
        self._softening_limits_m = softening_limits_m(rig)
        self._model = model_of(rig, False, modes_per_beam)
        self._constants = stepping_constants(self._model, step_s)
        self._state, self._contact_state = self._model.start()
        self._step_count, self._inputs = 0, self._input_values(0.0, 0)

    @property
    def time_s(self) -> float:
        return self._step_count * self.step_s

    @property
    def eta_m(self) -> Float[np.ndarray, " contacts"]:
        """Relative displacement of every contact, m."""
        return self._contact_state[1, : len(self.rig.contacts)].copy()

    @property
    def contact_force_n(self) -> Float[np.ndarray, " contacts"]:
        return self._contact_state[0, : len(self.rig.contacts)].copy()

    @property
    def sensed(self) -> Float[np.ndarray, " sensors"]:
        """Quantity at every sensor, before any instrument."""
        states = self._state[None]
        return np.asarray(
            sensed_quantities(self.rig, self._model, states, self._inputs[:, None], self._contact_state[:1].T)[:, 0]
        )

    def advance(self, force_n: float, step_count: int = 1) -> None:
        """Advance by `step_count` steps, at whose end the force has this value; RigError if the motion diverges."""
        from rig.simulation.plants.stepping import advance

        start_inputs, contact_count = self._inputs, len(self._model.eta_rows)
        end_inputs = self._input_values(force_n, self._step_count + step_count)
        elapsed_share = np.linspace(0.0, 1.0, step_count + 1)
        inputs = start_inputs[:, None] + elapsed_share * (end_inputs - start_inputs)[:, None]
        for input_row, tone in enumerate(self.rig.tones, start=len(end_inputs) - len(self.rig.tones)):
            inputs[input_row] = tone.force_n((self._step_count + np.arange(step_count + 1)) * self.step_s)
        states = np.empty((step_count + 1, self._state.size))
        states[0] = self._state
        contact_forces, contact_bends = np.empty((2, contact_count, step_count))
        input_bends = np.zeros(inputs.shape)
        advance(
            states,
            self._contact_state,
            contact_forces,
            contact_bends,
            inputs,
            input_bends,
            *self._constants,
            self._step_count + 1,
            self.step_s,
        )
        self._state, self._inputs, self._step_count = states[-1], end_inputs, self._step_count + step_count
        if not np.all(np.isfinite(self._state)):
            raise RigError(
                f"the modal plant diverged near {self.time_s:.3f} s at step {self.step_s} s; use a smaller step"
            )
        check_softening_limits(self._softening_limits_m, self._model.eta_rows @ states[1:, : self._model.omega.size].T)

    def _input_values(self, force_n: float, step_count: int) -> Float[np.ndarray, " inputs"]:
        """Known inputs after a number of steps, in the order of the model's gains."""
        static_input = [1.0] if has_static_load(self.rig) else []
        time_s = np.array([step_count * self.step_s])
        return np.array([force_n, *static_input, *(float(tone.force_n(time_s)[0]) for tone in self.rig.tones)])
