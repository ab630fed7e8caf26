"""Stiffness that differs between the two stops of a contact."""

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

from msgspec.structs import replace

from rig.effects.base import Effect
from rig.model.contact_laws import DeadZone
from rig.model.description import Rig
from rig.model.parameters import Parameter


class OneStopStiffness(Effect, frozen=True):
    """One stop of a contact alone, the upper or the lower, is `factor` times as stiff as believed."""

    name: ClassVar[str] = "one_stop"
    words: ClassVar[str] = "a stiffness of the {side} stop of {contact} that is {factor}"
    separating_test: ClassVar[str] = "press the parts to either side with a static force and compare"
    factor: Annotated[float, Parameter("1", 0.1, 10.0, 1.0)] = 1.5
    contact: str | None = None
    side: Literal["upper", "lower"] = "upper"

    @classmethod
    def placements(cls, rig: Rig, sensors: Sequence[str]) -> list[dict[str, str | None]]:
        """Either side that has a stop, of every contact and of all."""
        contact_placements = super().placements(rig, sensors)
        stop_sides_by_contact = {
            placement["contact"]: _stop_sides(rig, placement["contact"]) for placement in contact_placements
        }
        return [
            {**placement, "side": side_name}
            for placement in contact_placements
            for side_name, side in (("upper", 1), ("lower", -1))
            if side in stop_sides_by_contact[placement["contact"]]
        ]

    def applied_to(self, rig: Rig) -> Rig:
        return self.with_laws(rig, self.contact, DeadZone, self._changed_law)

    def _changed_law(self, law: DeadZone) -> DeadZone:
        if self.side == "lower":
            return replace(law, lower_stiffness_ratio=law.lower_stiffness_ratio * self.factor)
        return replace(
            law,
            stiffness_n_per_m=law.stiffness_n_per_m * self.factor,
            lower_stiffness_ratio=law.lower_stiffness_ratio / self.factor,
        )


def _stop_sides(rig: Rig, contact_name: str | None) -> set[int]:
    """Sides on which the contact of that name, or any contact, has a stop."""
    return {side for contact in rig.contacts if contact_name in (None, contact.name) for side in contact.law.sides}
