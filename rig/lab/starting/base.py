"""Options that all first rigs share, besides their bodies."""

from collections.abc import Sequence
from itertools import product
from typing import Annotated, Literal

import msgspec
import numpy as np

from rig.lab.exporting import import_map
from rig.model.contact_laws import AnyLaw
from rig.model.contact_laws.dead_zone import symmetric_dead_zone
from rig.model.description import Body, Contact, Rig, Station
from rig.model.quantities import QuantityName
from rig.model.sensing import named_sensor
from rig.recording import channel_groups

STATION_COUNT = 6
"""Sensor stations of a body, including the contacts, as in the reference rig."""


class Start(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options that describe a rig. Places are metres from a body's left end."""

    quantity: Annotated[
        tuple[QuantityName, ...],
        msgspec.Meta(description="What the sensors measure, with commas: acceleration, velocity, displacement."),
    ] = ("acceleration",)
    name: Annotated[str, msgspec.Meta(description="Name of the rig.")] = "rig"

    def rig(self) -> Rig:
        """Rig that the options describe; raises RigError where they are inconsistent."""
        return self.rig_and_notes()[0]

    def rig_and_notes(self) -> tuple[Rig, tuple[str, ...]]:
        """Rig, and sentences on the origin of its numbers."""
        raise NotImplementedError

    def map_text(self, rig: Rig) -> str:
        """Import map of a CSV file with the rig's channels."""
        return import_map(channel_groups(rig), "csv")


class StartWithStops(Start, frozen=True, kw_only=True):
    """Options of a rig with contacts beside its bodies."""

    clearance_m: Annotated[float, msgspec.Meta(description="Clearance on each side of a contact, m.")]
    stiffness_n_per_m: Annotated[float, msgspec.Meta(description="Contact stiffness, N/m.")]
    sample_rate_hz: Annotated[float, msgspec.Meta(description="Sampling rate of the records, Hz.")]
    damping_n_s_per_m: Annotated[float, msgspec.Meta(description="Contact damping, N s/m.")] = 0.0
    stops: Annotated[
        Literal["both", "upper", "lower"], msgspec.Meta(description="Stops that are there: both, upper or lower.")
    ] = "both"
    noise_density: Annotated[float, msgspec.Meta(description="Noise of the accelerometers, m/s^2/sqrt(Hz).")] = 0.0

    def notes(self) -> tuple[str, ...]:
        """Note on what a single stop needs to be identified; none otherwise."""
        if self.stops == "both" or "displacement" in self.quantity:
            return ()
        return (
            "accelerometers alone tell the clearance of a single stop poorly, of a free body not at all; add "
            "displacement sensors, at the contacts at least: --quantity acceleration,displacement",
        )

    def _rig(
        self,
        bodies: tuple[Body, ...],
        meeting_stations: Sequence[tuple[Station, Station | None]],
        force_at: Station,
        stations: Sequence[Station],
    ) -> Rig:
        law = symmetric_dead_zone(self.clearance_m, self.stiffness_n_per_m, self.damping_n_s_per_m)
        if self.stops != "both":
            absent_field = "lower_clearance_m" if self.stops == "upper" else "upper_clearance_m"
            law = msgspec.structs.replace(law, **{absent_field: np.inf})
        return Rig(
            name=self.name,
            bodies=bodies,
            contacts=contacts_of(meeting_stations, law),
            force_at=force_at,
            sensors=tuple(
                named_sensor(station, quantity, self.noise_density)
                for quantity, station in product(self.quantity, stations)
            ),
            sample_rate_hz=self.sample_rate_hz,
        )


def contacts_of(meeting_stations: Sequence[tuple[Station, Station | None]], law: AnyLaw) -> tuple[Contact, ...]:
    """Numbered contacts with one law, from pairs of stations."""
    return tuple(
        Contact(name=f"contact_{contact_number}", at=station, against=against, law=law)
        for contact_number, (station, against) in enumerate(meeting_stations, 1)
    )


def spread_positions(
    required_m: Sequence[float],
    length_m: float,
    avoided_m: Sequence[float] = (),
    among_m: Sequence[float] | None = None,
    position_count: int = STATION_COUNT,
) -> tuple[float, ...]:
    """Required and further positions, `position_count` in all, each as far as possible from the others and avoided_m.

    Further ones are chosen from a grid of a fortieth of the length, or from among_m.
    """
    chosen_positions_m = sorted(set(required_m))
    offered_positions_m = np.linspace(0, length_m, 41) if among_m is None else np.array(among_m)
    while len(chosen_positions_m) < min(position_count, len(offered_positions_m)):
        min_distances_m = np.abs(offered_positions_m[:, None] - np.array([*chosen_positions_m, *avoided_m])).min(axis=1)
        farthest_m = float(offered_positions_m[np.argmax(min_distances_m)])
        chosen_positions_m.append(float(f"{farthest_m:.9g}") if among_m is None else farthest_m)
    return tuple(sorted(chosen_positions_m))
