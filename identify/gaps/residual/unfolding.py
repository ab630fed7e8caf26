"""A rig in space unfolded into one plane rig: every body stands there twice, once for each of its directions.

y and z couple in annular contacts alone. Without a law for these, the residual of a record in space is the linear one
of its two plane rigs together: body "barrel" moves in y, "barrel in z" as the plane rig of z does, and so on for
contacts. What acts in both directions stands on the body and on its twin.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace as with_fields

from msgspec.structs import replace

from identify.contacts.space_contacts import recording_relative_to_rest
from rig.errors import RigError
from rig.model.contact_laws.annular import Annular
from rig.model.description import Contact, Rig, Station
from rig.model.space import in_plane, station_in_y
from rig.model.tolerances import Tolerances
from rig.recording import Recording, Signals, channel_groups

IN_Z = " in z"
"""Words behind the name of a body or contact for its twin."""
FREE_CONTACT_SHARE = 1e3
"""Share of a contact force that no law explains, in the residual of a rig in space: its weight is next to nothing.
Numerical."""
ELEMENTS = ("springs", "loads", "dampers", "tones")
"""Fields of a rig for what acts in one direction."""


def check_unfolds(rig: Rig) -> None:
    """Raise RigError unless `identify gap` takes a rig in space: what it cannot do there is refused by name."""
    one_way_contacts = [c.name for c in rig.contacts if not c.law.spatial]
    y_rig, z_rig = in_plane(rig, "y"), in_plane(rig, "z")
    flat = [y_body.name for y_body, z_body in zip(y_rig.bodies, z_rig.bodies, strict=True) if y_body != z_body]
    unequally_held_bodies = [spring.station.body for spring in {*y_rig.springs} ^ {*z_rig.springs}]
    twin_like_names = [x.name for x in (*rig.bodies, *rig.contacts) if x.name.endswith(IN_Z)]
    reasons = [f"contact {name!r} acts in one direction" for name in one_way_contacts[:1]]
    reasons += [f"body {name!r} bends in z otherwise than in y" for name in flat[:1]]
    reasons += [f"a spring holds body {name!r} in y otherwise than in z" for name in unequally_held_bodies[:1]]
    reasons += [f"{name!r} ends as the names of its twins do" for name in twin_like_names[:1]]
    if reasons:
        raise RigError(
            f"rig {rig.name!r} moves in two directions, and {reasons[0]}: identify gap takes bodies that are held and "
            "bend alike in both, with annular contacts alone; describe one direction by itself, or use identify contact"
        )


def free_contact_tolerances(tolerances: Tolerances) -> Tolerances:
    """Tolerances of an unfolded rig, whose contact forces no law explains; twins have the modes' tolerances, too."""
    mode_tolerances = dict(tolerances.modes)
    for key, of_mode in tolerances.modes.items():
        body_name, number = key.rsplit(" ", 1)
        mode_tolerances[f"{body_name}{IN_Z} {number}"] = of_mode
    return replace(tolerances, unmodelled_contact=FREE_CONTACT_SHARE, modes=mode_tolerances)


@dataclass(frozen=True)
class Unfolding:
    """Nominal rig in space, with the ways to its unfolded rig and back."""

    space_rig: Rig

    @property
    def unfolded_rig(self) -> Rig:
        """Unfolded rig: a plane one, without weight, which changes no linear residual."""
        y_rig, z_rig = in_plane(self.space_rig, "y"), in_plane(self.space_rig, "z")
        twin_contacts = tuple(
            replace(
                c,
                name=c.name + IN_Z,
                at=_z_twin_station(c.at),
                against=None if c.against is None else _z_twin_station(c.against),
            )
            for c in z_rig.contacts
        )
        sensor_by_name = {s.name: replace(s, station=_z_twin_station(s.station)) for s in z_rig.sensors}
        sensor_by_name |= {s.name: s for s in y_rig.sensors}
        force_stations = tuple(
            _z_twin_station(station_in_y(s)) if s.direction == "z" else s for s in self.space_rig.forces
        )
        return replace(
            y_rig,
            bodies=(*y_rig.bodies, *(replace(b, name=b.name + IN_Z) for b in z_rig.bodies)),
            contacts=(*y_rig.contacts, *twin_contacts),
            force_at=force_stations if len(force_stations) > 1 else force_stations[0],
            sensors=tuple(sensor_by_name[s.name] for s in self.space_rig.sensors),
            masses=(*y_rig.masses, *(replace(m, station=_z_twin_station(m.station)) for m in y_rig.masses)),
            supports=(*y_rig.supports, *(replace(s, station=_z_twin_station(s.station)) for s in y_rig.supports)),
            clamps=(*y_rig.clamps, *(replace(c, body=c.body + IN_Z) for c in y_rig.clamps)),
            gravity_m_per_s2=0.0,
            **{
                field: (
                    *getattr(y_rig, field),
                    *(replace(x, station=_z_twin_station(x.station)) for x in getattr(z_rig, field)),
                )
                for field in ELEMENTS
            },
        )

    def unfolded_recording(self, space_recording: Recording) -> Recording:
        """Recording of the unfolded rig; displacements count from the rest position."""
        return with_rig(recording_relative_to_rest(space_recording), self.unfolded_rig)

    def space_rig_of(self, rig: Rig) -> Rig:
        """Rig in space of an unfolded rig with effects or drawn bodies; what twins share is that of the body in y."""
        contacts_by_name = {c.name: c for c in rig.contacts}

        def station(unfolded: Station) -> Station:
            is_twin = unfolded.body.endswith(IN_Z)
            return replace(unfolded, body=unfolded.body.removesuffix(IN_Z), direction="z" if is_twin else "y")

        def contact(nominal_contact: Contact) -> Contact:
            annular_law, unfolded_contact = nominal_contact.law, contacts_by_name[nominal_contact.name]
            assert isinstance(annular_law, Annular)
            law = replace(
                annular_law,
                clearance_m=unfolded_contact.law.lower_clearance_m,
                stiffness_n_per_m=unfolded_contact.law.stiffness_n_per_m,
                damping_n_s_per_m=unfolded_contact.law.damping_n_s_per_m,
            )
            return replace(unfolded_contact, law=law)

        force_stations = tuple(map(station, rig.forces))
        return replace(
            rig,
            bodies=tuple(b for b in rig.bodies if not b.name.endswith(IN_Z)),
            contacts=tuple(map(contact, self.space_rig.contacts)),
            force_at=force_stations if len(force_stations) > 1 else force_stations[0],
            sensors=tuple(replace(s, station=station(s.station)) for s in rig.sensors),
            masses=tuple(m for m in rig.masses if not m.station.body.endswith(IN_Z)),
            supports=tuple(s for s in rig.supports if not s.station.body.endswith(IN_Z)),
            clamps=tuple(c for c in rig.clamps if not c.body.endswith(IN_Z)),
            gravity_m_per_s2=self.space_rig.gravity_m_per_s2,
            **{field: tuple(replace(x, station=station(x.station)) for x in getattr(rig, field)) for field in ELEMENTS},
        )


def transverse_station_indices(stations: Sequence[Station]) -> dict[int, int]:
    """Index of the station of the other direction at the same place, by the index of each that has one."""
    index_by_place = {(station.body, station.position_m): k for k, station in enumerate(stations)}
    index_pairs = [(k, index_by_place.get((s.body + IN_Z, s.position_m))) for k, s in enumerate(stations)]
    return {i: j for k, twin in index_pairs if twin is not None for i, j in ((k, twin), (twin, k))}


def with_rig(recording: Recording, rig: Rig) -> Recording:
    """Recording with another rig of the same channels, which may stand in another order."""
    signals = {}
    for quantity, channels in channel_groups(rig).items():
        measured_signals = recording.signals[quantity]
        row_indices = [measured_signals.channels.names.index(name) for name in channels.names]
        signals[quantity] = Signals(channels, measured_signals.start_s, measured_signals.values[row_indices])
    return with_fields(recording, rig=rig, signals=signals)


def _z_twin_station(station: Station) -> Station:
    return replace(station, body=station.body + IN_Z)
