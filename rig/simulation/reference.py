"""The paper's two reference rigs and one in space, with the settings of `rig record SCENARIO --set KEY=VALUE`."""

from collections.abc import Callable
from functools import partial
from typing import Literal

import msgspec

from rig.errors import RigError, hint
from rig.model.beam import Beam
from rig.model.components import DIRECTIONS
from rig.model.contact_laws import ContactLaw
from rig.model.contact_laws.annular import Annular
from rig.model.contact_laws.dead_zone import symmetric_dead_zone
from rig.model.decoding import explained
from rig.model.description import Contact, Rig, Station
from rig.model.oscillator import Oscillator
from rig.model.quantities import QUANTITIES, QuantityName
from rig.model.sensing import named_sensor
from rig.simulation.excitation import Excitation, excitation_of


class _Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings that all reference rigs have: sensors, record and exciting force."""

    damping_ratio: float = 0.01
    """Damping ratio of every mode, of one mass that with open contacts."""
    sensors: str = "displacement+acceleration"
    """Quantities measured at every station, and in both directions of a rig in space, joined by +."""
    noise_density: float = 0.0
    """Noise density of the accelerometers, m/s^2/sqrt(Hz)."""
    sample_rate_hz: float = 4096.0
    """Rate of every channel, Hz."""
    step_s: float = 2.0**-14
    """Time step of the simulation, s."""
    duration_s: float = 60.0
    """Length of the recording, s."""
    excitation: str = "gaussian"
    """Kind of the force: gaussian, burst, sweep, stepped_sine, multisine, hammer or free_decay."""
    rms_n: float = 14.0
    """Root mean square of the force, N."""
    low_hz: float = 0.5
    """Lower end of the force's band, Hz."""
    high_hz: float = 100.0
    """Upper end of the force's band, Hz."""
    seed: int = 1
    """Seed of the random force; a force in each direction has one of its own."""

    def force(self) -> Excitation:
        """Exciting force of these settings."""
        band_limits = {"low_hz": self.low_hz, "high_hz": self.high_hz}
        return excitation_of(self.excitation, rms_n=self.rms_n, seed=self.seed, **band_limits)


class Sdof(_Settings, frozen=True, kw_only=True):
    """The one-mass rig (figure 1 and table 1): a mass on a spring between two stops."""

    mass_kg: float = 1.0
    """Mass, kg."""
    frequency_hz: float = 5.0
    """Natural frequency with open contacts, Hz."""
    clearance_m: float = 1e-3
    """Clearance on each side, m."""
    stiffness_n_per_m: float = 1e4
    """Stiffness of each stop, N/m."""
    contact_damping_n_s_per_m: float = 0.0
    """Damping of a closed stop, N s/m."""
    sample_rate_hz: float = 512.0
    """Rate of every channel, Hz."""
    step_s: float = 2.0**-13
    """Time step of the simulation, s."""
    duration_s: float = 825.0
    """Length of the recording, s."""
    rms_n: float = 0.5
    """Root mean square of the force, N."""
    low_hz: float = 0.0
    """Lower end of the force's band, Hz."""
    high_hz: float = 15.0
    """Upper end of the force's band, Hz."""

    def rig(self) -> Rig:
        """Rig of these settings."""
        mass_station = Station("mass")
        body = Oscillator(
            name="mass", mass_kg=self.mass_kg, frequency_hz=self.frequency_hz, damping_ratio=self.damping_ratio
        )
        law = symmetric_dead_zone(self.clearance_m, self.stiffness_n_per_m, self.contact_damping_n_s_per_m)
        return Rig(
            name="sdof",
            bodies=(body,),
            contacts=(Contact(name="stop", at=mass_station, against=None, law=law),),
            force_at=mass_station,
            sensors=tuple(
                named_sensor(mass_station, name, self.noise_density) for name in _quantities_from_text(self.sensors)
            ),
            sample_rate_hz=self.sample_rate_hz,
        )


class BarrelCradle(_Settings, frozen=True, kw_only=True):
    """The barrel in its cradle (figure 10 and table 2): a clamped and a free beam that meet at two contacts."""

    length_m: float = 1.0
    """Length of each beam, m."""
    overlap_start_m: float = 0.45
    """Position on the cradle of the barrel's left end (the paper's la)."""
    clearance_1_m: float = 5e-3
    """Clearance of contact_1 on each side, m."""
    clearance_2_m: float = 5e-3
    """Clearance of contact_2 on each side, m."""
    stiffness_1_n_per_m: float = 1e5
    """Stiffness of the stops of contact_1, N/m."""
    stiffness_2_n_per_m: float = 1e5
    """Stiffness of the stops of contact_2, N/m."""
    contact_damping_n_s_per_m: float = 0.0
    """Damping of a closed stop, N s/m."""
    stations: Literal[4, 6, 8, 10] = 6
    """Stations per beam; the contacts are always among them."""

    def rig(self) -> Rig:
        """Rig of these settings."""
        beam_of = partial(
            Beam, length_m=self.length_m, width_m=0.05, thickness_m=0.01, damping_ratio=self.damping_ratio
        )
        return Rig(
            name="barrel_cradle",
            bodies=tuple(beam_of(name=name, ends=ends) for name, ends in _END_CONDITIONS),
            contacts=_barrel_contacts(
                self, partial(symmetric_dead_zone, damping_n_s_per_m=self.contact_damping_n_s_per_m)
            ),
            force_at=Station("barrel", self.length_m),
            sensors=tuple(
                named_sensor(station, quantity, self.noise_density)
                for quantity in _quantities_from_text(self.sensors)
                for station in self._stations()
            ),
            sample_rate_hz=self.sample_rate_hz,
        )

    def _stations(self) -> list[Station]:
        """Stations of the sensors: the contacts and those that condition the modal transformation best."""
        cradle_m, barrel_m = ({share * self.length_m for share in shares} for shares in _STATION_SHARES[self.stations])
        cradle_m |= {self.overlap_start_m, self.length_m}
        barrel_m |= {0.0, self.length_m - self.overlap_start_m}
        return [
            Station(name, x_m) for name, all_m in (("cradle", cradle_m), ("barrel", barrel_m)) for x_m in sorted(all_m)
        ]


class BarrelCradleAnnular(_Settings, frozen=True, kw_only=True):
    """The barrel as a tube that lies in two rings of its cradle, a clamped tube, and moves up, down and sideways."""

    length_m: float = 1.0
    """Length of each tube, m."""
    overlap_start_m: float = 0.45
    """Position on the cradle of the barrel's left end."""
    barrel_outer_diameter_m: float = 0.06
    """Outer diameter of the barrel, m."""
    barrel_inner_diameter_m: float = 0.04
    """Inner diameter of the barrel, m."""
    cradle_outer_diameter_m: float = 0.08
    """Outer diameter of the cradle, m."""
    cradle_inner_diameter_m: float = 0.064
    """Inner diameter of the cradle, m."""
    clearance_1_m: float = 2e-3
    """Radial clearance of contact_1, m."""
    clearance_2_m: float = 2e-3
    """Radial clearance of contact_2, m."""
    stiffness_1_n_per_m: float = 5e5
    """Stiffness of contact_1, N/m."""
    stiffness_2_n_per_m: float = 5e5
    """Stiffness of contact_2, N/m."""
    contact_damping_n_s_per_m: float = 200.0
    """Damping of a closed contact, N s/m."""
    friction_coefficient: float = 0.1
    """Friction coefficient of both contacts."""
    gravity_m_per_s2: float = 9.81
    """Acceleration of gravity, m/s^2."""
    step_s: float = 2.0**-15
    """Time step of the simulation, s."""
    rms_n: float = 60.0
    """Root mean square of each force, N."""

    def rig(self) -> Rig:
        """Rig of these settings."""
        barrel_overlap_m = self.length_m - self.overlap_start_m
        sensor_positions_m = {
            "cradle": (0.25 * self.length_m, self.overlap_start_m, 0.75 * self.length_m, self.length_m),
            "barrel": (0.0, 0.25 * self.length_m, barrel_overlap_m, self.length_m),
        }
        tubes = (
            Beam(
                name=name,
                ends=ends,
                length_m=self.length_m,
                damping_ratio=self.damping_ratio,
                outer_diameter_m=getattr(self, f"{name}_outer_diameter_m"),
                inner_diameter_m=getattr(self, f"{name}_inner_diameter_m"),
            )
            for name, ends in _END_CONDITIONS
        )
        contact_damping, friction_coefficient = self.contact_damping_n_s_per_m, self.friction_coefficient
        law_of = partial(Annular, damping_n_s_per_m=contact_damping, friction_coefficient=friction_coefficient)
        return Rig(
            name="barrel_cradle_annular",
            bodies=tuple(tubes),
            contacts=_barrel_contacts(self, law_of),
            force_at=tuple(Station("barrel", self.length_m, direction) for direction in DIRECTIONS),
            sensors=tuple(
                named_sensor(Station(body_name, position_m, direction), quantity, self.noise_density)
                for quantity in _quantities_from_text(self.sensors)
                for direction in DIRECTIONS
                for body_name, positions_m in sensor_positions_m.items()
                for position_m in positions_m
            ),
            sample_rate_hz=self.sample_rate_hz,
            gravity_m_per_s2=self.gravity_m_per_s2,
        )


def _barrel_contacts(
    settings: BarrelCradle | BarrelCradleAnnular, law_of: Callable[..., ContactLaw]
) -> tuple[Contact, ...]:
    """Contacts at both ends of the overlap, whose laws take clearance_m and stiffness_n_per_m."""
    overlap_m = settings.length_m - settings.overlap_start_m
    return tuple(
        Contact(
            name=name,
            at=Station("barrel", barrel_position_m),
            against=Station("cradle", cradle_position_m),
            law=law_of(clearance_m=clearance_m, stiffness_n_per_m=stiffness_n_per_m),
        )
        for name, barrel_position_m, cradle_position_m, clearance_m, stiffness_n_per_m in (
            ("contact_1", 0.0, settings.overlap_start_m, settings.clearance_1_m, settings.stiffness_1_n_per_m),
            ("contact_2", overlap_m, settings.length_m, settings.clearance_2_m, settings.stiffness_2_n_per_m),
        )
    )


_END_CONDITIONS: tuple[tuple[str, Literal["clamped-free", "free-free"]], ...] = (
    ("cradle", "clamped-free"),
    ("barrel", "free-free"),
)
_STATION_SHARES: dict[int, tuple[tuple[float, ...], tuple[float, ...]]] = {
    4: ((0.25, 0.75), (0.25, 1.0)),
    6: ((0.2, 0.3, 0.65, 0.85), (0.2, 0.35, 0.8, 1.0)),
    8: ((0.15, 0.25, 0.35, 0.6, 0.75, 0.9), (0.1, 0.25, 0.4, 0.7, 0.85, 1.0)),
    10: ((0.1, 0.2, 0.3, 0.35, 0.55, 0.65, 0.75, 0.9), (0.1, 0.2, 0.3, 0.4, 0.7, 0.8, 0.9, 1.0)),
}

Reference = Sdof | BarrelCradle | BarrelCradleAnnular
REFERENCES: dict[str, type[Reference]] = {
    "sdof": Sdof,
    "barrel_cradle": BarrelCradle,
    "barrel_cradle_annular": BarrelCradleAnnular,
}


def settings_in_order(settings_type: type[msgspec.Struct]) -> list[msgspec.structs.FieldInfo]:
    """Settings of a rig, its own before those that all reference rigs have."""
    return sorted(msgspec.structs.fields(settings_type), key=lambda field: field.name in _Settings.__struct_fields__)


def reference(scenario: str, settings: dict[str, str]) -> Reference:
    """Reference rig of that name with settings given as text, each checked against its type.

    Raises RigError for an unknown scenario or key, and for a value that does not fit.
    """
    if scenario not in REFERENCES:
        raise RigError(f"no scenario {scenario!r}; there are {', '.join(REFERENCES)}")
    settings_type = REFERENCES[scenario]
    names = [field.name for field in settings_in_order(settings_type)]
    if unknown := sorted(set(settings) - set(names)):
        raise RigError(f"{scenario} has no setting {unknown[0]!r}{hint(unknown[0], names)}; it has {', '.join(names)}")
    try:
        return msgspec.convert(settings, settings_type, strict=False)
    except msgspec.ValidationError as error:
        raise RigError(f"{scenario}: {explained(error, settings, settings_type)}; see `rig record --help`") from error


def _quantities_from_text(sensors: str) -> list[QuantityName]:
    """Quantities from a text that joins them by +; "both" stands for displacement and acceleration."""
    quantity_names = ["displacement", "acceleration"] if sensors == "both" else sensors.split("+")
    if unknown := sorted(set(quantity_names) - set(QUANTITIES)):
        raise RigError(f"sensors is {sensors!r}: no quantity {unknown[0]!r}; join any of {', '.join(QUANTITIES)} by +")
    return quantity_names
