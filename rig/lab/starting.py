"""Rigs from a few numbers: what `rig init` writes as the first rig.json, and the import map beside it."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from rig.errors import RigError
from rig.files import write_bytes
from rig.lab.exporting import map_of
from rig.lab.modal_uff import Axis, Choice, structure_from_uff
from rig.model.beam import Beam
from rig.model.contact_laws.dead_zone import equal_sides
from rig.model.description import Body, Contact, Rig, Station, to_json
from rig.model.oscillator import Oscillator
from rig.model.quantities import QuantityName
from rig.model.sensing import named_sensor
from rig.model.structure import Structure, structure_of
from rig.recording import RIG_NAME, channel_groups

MAP_NAME = "map.toml"
STATIONS = 6
"""Of a body's sensors, the contacts among them: as many as the reference rig has."""
NEAR = 1e-3
"""A place so near to a given one of a modal basis, in lengths of the body, is that one."""
_HEAD = """# Which column of a measured file is which sensor, for `rig import FILE --map {name}`; see rig/lab/README.md.
# Change each column to its name (or number) in the file, each unit to the file's.
"""


class _Start(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What every rig needs beside its bodies. Places are metres from a body's left end."""

    clearance_m: Annotated[float, msgspec.Meta(description="Clearance on each side of a contact, m.")]
    stiffness_n_per_m: Annotated[float, msgspec.Meta(description="Contact stiffness, N/m.")]
    sample_rate_hz: Annotated[float, msgspec.Meta(description="Sampling rate of the records, Hz.")]
    damping_n_s_per_m: Annotated[float, msgspec.Meta(description="Contact damping, N s/m.")] = 0.0
    quantity: Annotated[
        tuple[QuantityName, ...],
        msgspec.Meta(description="What the sensors measure, with commas: acceleration, velocity, displacement."),
    ] = ("acceleration",)
    noise_density: Annotated[float, msgspec.Meta(description="Noise of the accelerometers, m/s^2/sqrt(Hz).")] = 0.0
    name: Annotated[str, msgspec.Meta(description="Name of the rig.")] = "rig"

    def rig(self) -> Rig:
        """The rig that these numbers describe; raises RigError where they do not fit."""
        raise NotImplementedError

    def _rig(
        self,
        bodies: tuple[Body, ...],
        meetings: Sequence[tuple[Station, Station | None]],
        force_at: Station,
        stations: Sequence[Station],
    ) -> Rig:
        law = equal_sides(self.clearance_m, self.stiffness_n_per_m, self.damping_n_s_per_m)
        return Rig(
            name=self.name,
            bodies=bodies,
            contacts=tuple(
                Contact(name=f"contact_{k}", at=at, against=against, law=law)
                for k, (at, against) in enumerate(meetings, start=1)
            ),
            force_at=force_at,
            sensors=tuple(named_sensor(s, q, self.noise_density) for q, s in product(self.quantity, stations)),
            sample_rate_hz=self.sample_rate_hz,
        )


class MassRig(_Start, frozen=True, kw_only=True):
    """One mass on a spring between two stops."""

    mass_kg: Annotated[float, msgspec.Meta(description="The mass, kg.")]
    frequency_hz: Annotated[float, msgspec.Meta(description="Natural frequency of the mass on its spring, Hz.")]
    damping_ratio: Annotated[float, msgspec.Meta(description="Its damping ratio.")] = 0.01

    def rig(self) -> Rig:
        body = Oscillator(
            name="mass",
            mass_kg=self.mass_kg,
            frequency_hz=self.frequency_hz,
            damping_ratio=self.damping_ratio,
        )
        mass = Station("mass")
        return self._rig((body,), [(mass, None)], mass, [mass])


class BeamsRig(_Start, frozen=True, kw_only=True):
    """Two uniform beams: a free barrel that meets a cradle, clamped at its left end, at contacts."""

    cradle_length_m: Annotated[float, msgspec.Meta(description="Length of the cradle, m.")]
    cradle_width_m: Annotated[float, msgspec.Meta(description="Width of the cradle, m.")]
    cradle_thickness_m: Annotated[float, msgspec.Meta(description="Its thickness, over which it bends, m.")]
    barrel_length_m: Annotated[float, msgspec.Meta(description="Length of the barrel, m.")]
    barrel_width_m: Annotated[float, msgspec.Meta(description="Width of the barrel, m.")]
    barrel_thickness_m: Annotated[float, msgspec.Meta(description="Its thickness, over which it bends, m.")]
    overlap_start_m: Annotated[float, msgspec.Meta(description="Place on the cradle of the barrel's left end, m.")]
    youngs_modulus_pa: Annotated[float, msgspec.Meta(description="Young's modulus of both beams, Pa.")] = 210e9
    density_kg_per_m3: Annotated[float, msgspec.Meta(description="Density of both beams, kg/m^3.")] = 7850.0
    damping_ratio: Annotated[float, msgspec.Meta(description="Damping ratio of every mode.")] = 0.01
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

    def rig(self) -> Rig:
        cradle = self._beam("cradle", "clamped-free")
        barrel = self._beam("barrel", "free-free")
        start, end = self.overlap_start_m, min(self.cradle_length_m, self.overlap_start_m + self.barrel_length_m)
        if not 0 <= start < end:
            raise RigError(
                f"overlap_start_m is {start}; give a place on the cradle, 0 to below {self.cradle_length_m} m"
            )
        places = self.contacts_m or (start, end)
        if outside := [p for p in places if not start <= p <= end]:
            raise RigError(
                f"contacts_m has {outside[0]} m, where the beams do not lie side by side; give {start:g} to {end:g} m"
            )
        on_barrel = [round(p - start, 12) for p in places]
        force_m = self.barrel_length_m if self.force_m is None else self.force_m
        sensed = {
            "cradle": self.cradle_stations_m or spread(list(places), cradle.length_m, without=(0.0,)),
            "barrel": self.barrel_stations_m or spread([*on_barrel, force_m], barrel.length_m),
        }
        return self._rig(
            (cradle, barrel),
            [(Station("barrel", b), Station("cradle", c)) for b, c in zip(on_barrel, places, strict=True)],
            Station("barrel", force_m),
            [Station(name, x) for name, positions in sensed.items() for x in positions],
        )

    def _beam(self, name: str, ends: Literal["clamped-free", "free-free"]) -> Beam:
        return Beam(
            name=name,
            ends=ends,
            length_m=getattr(self, f"{name}_length_m"),
            width_m=getattr(self, f"{name}_width_m"),
            thickness_m=getattr(self, f"{name}_thickness_m"),
            youngs_modulus_pa=self.youngs_modulus_pa,
            density_kg_per_m3=self.density_kg_per_m3,
            damping_ratio=self.damping_ratio,
        )


class StructureRig(_Start, frozen=True, kw_only=True):
    """A body of any shape, given by its modal basis, that meets stops on the ground."""

    contacts_m: Annotated[tuple[float, ...], msgspec.Meta(description="Places that meet the stops, m, with commas.")]
    force_m: Annotated[float, msgspec.Meta(description="Place of the force, m.")]
    from_uff: Annotated[
        Path | None,
        msgspec.Meta(description="UFF file of a modal analysis: mode shapes (dataset 55), or FRFs (dataset 58)."),
    ] = None
    body: Annotated[
        Path | None, msgspec.Meta(description="JSON file of a structure, as it stands in rig.json; or --from-uff.")
    ] = None
    along: Annotated[
        Axis | None,
        msgspec.Meta(description="Axis of the UFF file along the body; otherwise the longest."),
    ] = None
    direction: Annotated[
        Axis | None,
        msgspec.Meta(description="Axis in which it vibrates; otherwise that of the largest shapes or of the FRFs."),
    ] = None
    nodes: Annotated[
        tuple[int, ...], msgspec.Meta(description="Nodes of the UFF file that are taken; otherwise all.")
    ] = ()
    positions_m: Annotated[
        tuple[float, ...],
        msgspec.Meta(description="Their places, m, where the UFF file has no coordinates; in the order of the nodes."),
    ] = ()
    length_m: Annotated[
        float | None, msgspec.Meta(description="Length of the body, m; otherwise up to the last node.")
    ] = None
    band_hz: Annotated[
        tuple[float, ...], msgspec.Meta(description="LOW,HIGH: the band in which FRFs are fitted; otherwise all.")
    ] = ()
    mass_kg: Annotated[
        float | None, msgspec.Meta(description="Of a free body whose analysis has no rigid-body modes: its mass, kg.")
    ] = None
    centre_m: Annotated[float | None, msgspec.Meta(description="With mass_kg: its centre of mass, m.")] = None
    inertia_kg_m2: Annotated[
        float | None, msgspec.Meta(description="With mass_kg: its moment of inertia about that centre, kg m^2.")
    ] = None
    stations_m: Annotated[
        tuple[float, ...], msgspec.Meta(description="Sensors; otherwise 6, the contacts and the force among them.")
    ] = ()

    def rig(self) -> Rig:
        return self.rig_of(self.structure()[0])

    def structure(self) -> tuple[Structure, tuple[str, ...]]:
        """The body from its file, and what is to be said of it; raises RigError if it cannot be used."""
        if (self.from_uff is None) == (self.body is None):
            raise RigError("give the body of the structure by one file: --from-uff FILE, or --body FILE.json")
        if self.from_uff is None:
            return self._with_rigid_modes(self._from_json()), ()
        told = (self.along, self.direction, self.nodes, self.positions_m, self.length_m, self.band_hz)
        found, notes = structure_from_uff(self.from_uff, Choice(*told))
        return self._with_rigid_modes(found), notes

    def rig_of(self, body: Structure) -> Rig:
        """The rig with this body."""
        contacts, stations = (
            [_given(body, x, what) for x in places]
            for what, places in (("contacts_m", self.contacts_m), ("stations_m", self.stations_m))
        )
        force_m = _given(body, self.force_m, "force_m")
        places = stations or spread([*contacts, force_m], body.length_m, among_m=body.positions_m.tolist())
        meetings = [(Station(body.name, x), None) for x in contacts]
        return self._rig((body,), meetings, Station(body.name, force_m), [Station(body.name, x) for x in places])

    def _from_json(self) -> Structure:
        path = self.body or Path()
        try:
            return msgspec.json.decode(path.read_bytes(), type=Structure)
        except OSError as error:
            raise RigError(f"{path}: cannot be opened ({error.strerror or error}); check the name") from error
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise RigError(f"{path}: is no structure ({error}); see rig/model/README.md") from error

    def _with_rigid_modes(self, body: Structure) -> Structure:
        """With translation, 1/sqrt(m), and rotation, (x - centre)/sqrt(J), as modes of 0 Hz before the others."""
        told = (self.mass_kg, self.centre_m, self.inertia_kg_m2)
        if told == (None, None, None):
            return body
        if self.mass_kg is None or self.centre_m is None or self.inertia_kg_m2 is None:
            raise RigError("mass_kg, centre_m and inertia_kg_m2 belong together; give all three, or none")
        if body.rigid_modes:
            raise RigError(f"{body.name!r} has {body.rigid_modes} rigid-body modes already; leave mass_kg out")
        if not (0 < self.mass_kg < np.inf and 0 < self.inertia_kg_m2 < np.inf):
            raise RigError(
                f"mass_kg is {self.mass_kg} and inertia_kg_m2 {self.inertia_kg_m2}; give finite values above zero"
            )
        places = body.positions_m
        turning = (places - self.centre_m) / np.sqrt(self.inertia_kg_m2)
        rigid = np.stack([np.full(len(places), 1 / np.sqrt(self.mass_kg)), turning], axis=1)
        return structure_of(
            body.name,
            body.length_m,
            np.append(np.zeros(2), body.natural_hz),
            np.append(np.zeros(2), body.ratios),
            places,
            np.append(rigid, body.shapes(places, body.max_modes), axis=1),
        )


KINDS: dict[str, type[MassRig] | type[BeamsRig] | type[StructureRig]] = {
    "mass": MassRig,
    "beams": BeamsRig,
    "structure": StructureRig,
}


def _given(body: Structure, place_m: float, what: str) -> float:
    """The place of the modal basis that is meant; raises RigError if there is none near."""
    nearest = float(body.positions_m[np.argmin(np.abs(body.positions_m - place_m))])
    if not abs(nearest - place_m) <= NEAR * body.length_m:
        raise RigError(
            f"{what} has {place_m} m, where {body.name!r} has no shapes; the nearest place that has is {nearest:g} m"
        )
    return nearest


def spread(
    taken_m: Sequence[float],
    length_m: float,
    without: Sequence[float] = (),
    among_m: Sequence[float] | None = None,
    count: int = STATIONS,
) -> tuple[float, ...]:
    """The places taken and more, `count` in all, each as far as can be from those before it and from `without`.

    More are chosen on a grid of a fortieth of the length, or among the places given.
    """
    chosen = sorted(set(taken_m))
    offered = np.linspace(0, length_m, 41) if among_m is None else np.array(among_m)
    while len(chosen) < min(count, len(offered)):
        away = np.abs(offered[:, None] - np.array([*chosen, *without])).min(axis=1)
        chosen.append(float(f"{offered[np.argmax(away)]:.9g}") if among_m is None else float(offered[np.argmax(away)]))
    return tuple(sorted(chosen))


def write_start(rig: Rig, folder: Path) -> tuple[Path, Path]:
    """Writes rig.json and the map of a CSV file with its channels; returns both paths."""
    told = _HEAD.format(name=MAP_NAME) + map_of(channel_groups(rig), "csv")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{folder}: cannot be made a folder ({error.strerror}); choose another place") from error
    rig_path, map_path = folder / RIG_NAME, folder / MAP_NAME
    write_bytes(to_json(rig) + b"\n", rig_path)
    write_bytes(told.encode(), map_path)
    return rig_path, map_path
