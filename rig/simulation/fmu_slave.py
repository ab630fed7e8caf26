"""Script inside an FMU of `rig fmu`, with `rig.json` and `step.txt` beside it.

It runs in the Python of the importing tool, which needs this package's core (`pip install rig-identify`).
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pythonfmu3 import Float64, Fmi3Causality, Fmi3Slave, Fmi3Variability

from rig.model.description import read_rig
from rig.simulation.plants.stepwise import Stepwise


class RigFmu(Fmi3Slave):  # type: ignore[misc]
    """A rig that starts at rest: inputs a force, outputs the quantities of all sensors and contacts."""

    def __init__(self, **keywords: Any) -> None:
        super().__init__(**keywords)
        folder = Path(self.resources)
        rig, step_s = read_rig(folder / "rig.json"), float((folder / "step.txt").read_text())
        self.description, self.author = f"{rig.name}, made by rig fmu", "rig-identify"
        self._stepwise = Stepwise(rig, step_s)
        self.force = 0.0
        self._register_float_variable("time", Fmi3Causality.independent, "time, s", lambda: self._stepwise.time_s)
        force_description = "force on the rig, N; the value given before a step is that at its end"
        self._register_float_variable(
            "force", Fmi3Causality.input, force_description, lambda: self.force, start_value=0.0
        )
        for index, sensor in enumerate(rig.sensors):
            self._register_output(
                f"sensors.{sensor.name}", f"{sensor.quantity}, {sensor.measures.unit}", "sensed", index
            )
        for index, contact in enumerate(rig.contacts):
            self._register_output(f"contacts.{contact.name}.eta", "relative displacement, m", "eta_m", index)
            self._register_output(f"contacts.{contact.name}.force", "contact force, N", "contact_force_n", index)

    def _register_output(self, variable_name: str, description: str, array_attribute: str, array_index: int) -> None:
        def read_value() -> float:
            return float(getattr(self._stepwise, array_attribute)[array_index])

        self._register_float_variable(variable_name, Fmi3Causality.output, description, read_value)

    def _register_float_variable(
        self,
        variable_name: str,
        causality: Any,
        description: str,
        read_value: Callable[[], float],
        start_value: float | None = None,
    ) -> None:
        continuous = Fmi3Variability.continuous
        self.register_variable(
            Float64(
                variable_name,
                start=start_value,
                causality=causality,
                variability=continuous,
                description=description,
                getter=read_value,
            ),
            nested=False,
        )

    def do_step(self, current_time: float, step_size: float) -> bool:  # noqa: ARG002
        """Advance by a multiple of the plant's step, over which the force goes linearly to its given value."""
        step_count = round(step_size / self._stepwise.step_s)
        if step_count < 1 or abs(step_count * self._stepwise.step_s - step_size) > 1e-6 * step_size:
            raise ValueError(f"a step of {step_size} s is no multiple of {self._stepwise.step_s} s; choose one")
        self._stepwise.advance(self.force, step_count)
        return True
