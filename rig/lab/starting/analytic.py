"""First rigs of bodies with analytic modes: one mass, a cantilever, or a barrel in its cradle."""

from typing import Annotated, Literal

import msgspec

from rig.errors import RigError
from rig.lab.starting.base import StartWithStops, spread_positions
from rig.model.beam import Beam
from rig.model.description import Rig, Station
from rig.model.oscillator import Oscillator


class MassRig(StartWithStops, frozen=True, kw_only=True):
    """One mass on a spring between two stops."""

    mass_kg: Annotated[float, msgspec.Meta(description="The mass, kg.")]
    frequency_hz: Annotated[float, msgspec.Meta(description="Natural frequency of the mass on its spring, Hz.")]
    damping_ratio: Annotated[float, msgspec.Meta(description="Its damping ratio.")] = 0.01

    def rig_and_notes(self) -> tuple[Rig, tuple[str, ...]]:
        body = Oscillator(
            name="mass", mass_kg=self.mass_kg, frequency_hz=self.frequency_hz, damping_ratio=self.damping_ratio
        )
        mass_station = Station("mass")
        rig = self._rig((body,), [(mass_station, None)], mass_station, [mass_station])
        return rig, self.notes()


class UniformBeams(StartWithStops, frozen=True, kw_only=True):
    """Options of the material of uniform beams."""

    youngs_modulus_pa: Annotated[float, msgspec.Meta(description="Young's modulus of the beams, Pa.")] = 210e9
    density_kg_per_m3: Annotated[float, msgspec.Meta(description="Density of the beams, kg/m^3.")] = 7850.0
    damping_ratio: Annotated[float, msgspec.Meta(description="Damping ratio of every mode.")] = 0.01


class CantileverRig(UniformBeams, frozen=True, kw_only=True):
    """A uniform beam, clamped at its left end, that meets stops on the ground."""

    length_m: Annotated[float, msgspec.Meta(description="Length of the beam, m.")]
    width_m: Annotated[float, msgspec.Meta(description="Its width, m.")]
    thickness_m: Annotated[float, msgspec.Meta(description="Its thickness, over which it bends, m.")]
    contacts_m: Annotated[
        tuple[float, ...], msgspec.Meta(description="Places that meet the stops, m; otherwise the free end.")
    ] = ()
    force_m: Annotated[float | None, msgspec.Meta(description="Place of the force, m; otherwise the free end.")] = None
    stations_m: Annotated[
        tuple[float, ...], msgspec.Meta(description="Sensors; otherwise 6, the contacts and the force among them.")
    ] = ()

    def rig_and_notes(self) -> tuple[Rig, tuple[str, ...]]:
        beam = Beam(
            name="beam",
            ends="clamped-free",
            length_m=self.length_m,
            width_m=self.width_m,
            thickness_m=self.thickness_m,
            youngs_modulus_pa=self.youngs_modulus_pa,
            density_kg_per_m3=self.density_kg_per_m3,
            damping_ratio=self.damping_ratio,
        )
        contacts_m = self.contacts_m or (self.length_m,)
        force_m = self.length_m if self.force_m is None else self.force_m
        stations_m = self.stations_m or spread_positions([*contacts_m, force_m], self.length_m, avoided_m=(0.0,))
        meeting_stations = [(Station("beam", position_m), None) for position_m in contacts_m]
        rig = self._rig(
            (beam,),
            meeting_stations,
            Station("beam", force_m),
            [Station("beam", position_m) for position_m in stations_m],
        )
        return rig, self.notes()


class BeamsRig(UniformBeams, frozen=True, kw_only=True):
    """Two uniform beams: a free barrel that meets a cradle, clamped at its left end, at contacts."""

    cradle_length_m: Annotated[float, msgspec.Meta(description="Length of the cradle, m.")]
    cradle_width_m: Annotated[float, msgspec.Meta(description="Width of the cradle, m.")]
    cradle_thickness_m: Annotated[float, msgspec.Meta(description="Its thickness, over which it bends, m.")]
    barrel_length_m: Annotated[float, msgspec.Meta(description="Length of the barrel, m.")]
    barrel_width_m: Annotated[float, msgspec.Meta(description="Width of the barrel, m.")]
    barrel_thickness_m: Annotated[float, msgspec.Meta(description="Its thickness, over which it bends, m.")]
    overlap_start_m: Annotated[float, msgspec.Meta(description="Place on the cradle of the barrel's left end, m.")]
    contacts_m: Annotated[
        tuple[float, ...],
        msgspec.Meta(description="Contacts, places on the cradle; otherwise both ends of the overlap."),
    ] = ()
    force_m: Annotated[
        float | None, msgspec.Meta(description="Place of the force on the barrel; otherwise its right end.")
    ] = None
    cradle_stations_m: Annotated[
        tuple[float, ...], msgspec.Meta(description="Sensors on the cradle; otherwise 6, the contacts among them.")
    ] = ()
    barrel_stations_m: Annotated[
        tuple[float, ...], msgspec.Meta(description="Sensors on the barrel; otherwise 6, the contacts among them.")
    ] = ()

    def rig_and_notes(self) -> tuple[Rig, tuple[str, ...]]:
        cradle = self._beam("cradle", "clamped-free")
        barrel = self._beam("barrel", "free-free")
        overlap_start_m = self.overlap_start_m
        overlap_end_m = min(self.cradle_length_m, self.overlap_start_m + self.barrel_length_m)
        if not 0 <= overlap_start_m < overlap_end_m:
            raise RigError(
                f"overlap_start_m is {overlap_start_m}; give a place on the cradle, 0 to below {self.cradle_length_m} m"
            )
        contacts_on_cradle_m = self.contacts_m or (overlap_start_m, overlap_end_m)
        if off_overlap_m := [
            position_m for position_m in contacts_on_cradle_m if not overlap_start_m <= position_m <= overlap_end_m
        ]:
            raise RigError(
                f"contacts_m has {off_overlap_m[0]} m, where the beams do not lie side by side; give "
                f"{overlap_start_m:g} to {overlap_end_m:g} m"
            )
        contacts_on_barrel_m = [round(position_m - overlap_start_m, 12) for position_m in contacts_on_cradle_m]
        force_m = self.barrel_length_m if self.force_m is None else self.force_m
        stations_by_body = {
            "cradle": self.cradle_stations_m
            or spread_positions(list(contacts_on_cradle_m), cradle.length_m, avoided_m=(0.0,)),
            "barrel": self.barrel_stations_m or spread_positions([*contacts_on_barrel_m, force_m], barrel.length_m),
        }
        rig = self._rig(
            (cradle, barrel),
            [
                (Station("barrel", on_barrel_m), Station("cradle", on_cradle_m))
                for on_barrel_m, on_cradle_m in zip(contacts_on_barrel_m, contacts_on_cradle_m, strict=True)
            ],
            Station("barrel", force_m),
            [
                Station(body_name, position_m)
                for body_name, positions_m in stations_by_body.items()
                for position_m in positions_m
            ],
        )
        return rig, self.notes()

    def _beam(self, name: str, end_condition: Literal["clamped-free", "free-free"]) -> Beam:
        return Beam(
            name=name,
            ends=end_condition,
            length_m=getattr(self, f"{name}_length_m"),
            width_m=getattr(self, f"{name}_width_m"),
            thickness_m=getattr(self, f"{name}_thickness_m"),
            youngs_modulus_pa=self.youngs_modulus_pa,
            density_kg_per_m3=self.density_kg_per_m3,
            damping_ratio=self.damping_ratio,
        )
