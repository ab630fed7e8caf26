"""A first rig of one mass."""

from typing import Annotated

import msgspec

from rig.lab.starting.base import StartWithStops
from rig.model.description import Rig, Station
from rig.model.oscillator import Oscillator


class MassRig(StartWithStops, frozen=True, kw_only=True):
    """One mass on a spring between two stops."""

    mass_kg: Annotated[float, msgspec.Meta(description="The mass, kg.")]
    frequency_hz: Annotated[float, msgspec.Meta(description="Natural frequency of the mass on its spring, Hz.")]
    damping_ratio: Annotated[float, msgspec.Meta(description="Its damping ratio.")] = 0.01

    def described(self) -> tuple[Rig, tuple[str, ...]]:
        body = Oscillator(
            name="mass",
            mass_kg=self.mass_kg,
            frequency_hz=self.frequency_hz,
            damping_ratio=self.damping_ratio,
        )
        mass = Station("mass")
        return self._rig((body,), [(mass, None)], mass, [mass]), ()
