"""Options that all first rigs share, besides their bodies."""

from collections.abc import Sequence
from itertools import product
from typing import Annotated, Literal

import msgspec
import numpy as np

from rig.lab.exporting import import_map
from rig.model.contact_laws import AnyLaw
from rig.model.contact_laws.dead_zone import DeadZone, symmetric_dead_zone
from rig.model.description import Body, Contact, Rig, Station
from rig.model.quantities import QuantityName
from rig.model.sensing import named_sensor
from rig.model.tolerances import UNKNOWN, Tolerances
from rig.recording import channel_groups

STATION_COUNT = 6
"""Sensor stations of a body, including the contacts, as in the reference rig."""
START_CLEARANCE_M = 1e-3
START_STIFFNESS_N_PER_M = 1e5
"""What stands in rig.json for an unknown clearance and stiffness."""


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

    clearance_m: Annotated[
        float | None, msgspec.Meta(description="Clearance on each side of a contact, m (or 0.5mm); otherwise unknown.")
    ] = None
    stiffness_n_per_m: Annotated[
        float | None, msgspec.Meta(description="Contact stiffness, N/m (or 100N/mm); otherwise unknown.")
    ] = None
    sample_rate_hz: Annotated[float, msgspec.Meta(description="Sampling rate of the records, Hz.")]
    damping_n_s_per_m: Annotated[float, msgspec.Meta(description="Contact damping, N s/m.")] = 0.0
    stops: Annotated[
        Literal["both", "upper", "lower"], msgspec.Meta(description="Stops that are there: both, upper or lower.")
    ] = "both"
    noise_density: Annotated[float, msgspec.Meta(description="Noise of the accelerometers, m/s^2/sqrt(Hz).")] = 0.0

    def notes(self) -> tuple[str, ...]:
        """Notes on what is unknown of a contact, and on what a single stop needs to be identified."""
        unknown_notes = contact_notes(self.clearance_m, self.stiffness_n_per_m)
        if self.stops == "both" or "displacement" in self.quantity:
            return unknown_notes
        return (
            *unknown_notes,
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
        law = starting_law(self.clearance_m, self.stiffness_n_per_m, self.damping_n_s_per_m)
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
            tolerances=contact_tolerances(self.clearance_m, self.stiffness_n_per_m),
        )


def starting_law(clearance_m: float | None, stiffness_n_per_m: float | None, damping_n_s_per_m: float) -> DeadZone:
    """Contact law with START_CLEARANCE_M and START_STIFFNESS_N_PER_M in place of what is None, unknown."""
    return symmetric_dead_zone(
        START_CLEARANCE_M if clearance_m is None else clearance_m,
        START_STIFFNESS_N_PER_M if stiffness_n_per_m is None else stiffness_n_per_m,
        damping_n_s_per_m,
    )


def contact_tolerances(
    clearance_m: float | None, stiffness_n_per_m: float | None, others: Tolerances | None = None
) -> Tolerances | None:
    """Other tolerances, with what is None of every contact as UNKNOWN."""
    values = {"clearance": clearance_m, "stiffness": stiffness_n_per_m}
    unknown = {field: UNKNOWN for field, value in values.items() if value is None}
    return msgspec.structs.replace(others or Tolerances(), **unknown) if unknown else others


def contact_notes(clearance_m: float | None, stiffness_n_per_m: float | None) -> tuple[str, ...]:
    """Note on what is None, unknown, of every contact."""
    starts = []
    if clearance_m is None:
        starts.append(f"clearance is unknown and starts from {1e3 * START_CLEARANCE_M:g} mm")
    if stiffness_n_per_m is None:
        starts.append(f"stiffness is unknown and starts from {START_STIFFNESS_N_PER_M:g} N/m")
    if not starts:
        return ()
    return (
        f"{'; '.join(starts)}: nobody's belief, which tolerances of 100 % in rig.json say; identify contact finds what "
        "it is, wherever it starts, and writes a rig.json with it for identify plan and gap",
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
