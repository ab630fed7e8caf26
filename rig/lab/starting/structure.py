"""A first rig of a body that is known by its modes."""

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from rig.errors import RigError
from rig.lab.modal import Axis, UffSelection, structure_from_uff
from rig.lab.starting.base import StartWithStops, contact_tolerances, spread_positions
from rig.model.decoding import converted
from rig.model.description import Rig, Station
from rig.model.structure import Structure, structure_of
from rig.model.tolerances import Tolerances

SAME_PLACE_SHARE = 1e-3
"""Distance, relative to the body's length, within which a place is taken as one of the modal basis."""


class StructureRig(StartWithStops, frozen=True, kw_only=True):
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
        Axis | None, msgspec.Meta(description="Axis of the UFF file along the body; otherwise the longest.")
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
    exponential_window_s: Annotated[
        float | None,
        msgspec.Meta(description="Time in which the analyser's exponential window falls to 37 %, s; it is taken off."),
    ] = None
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

    def rig_and_notes(self) -> tuple[Rig, tuple[str, ...]]:
        body, notes, tolerances = self.structure()
        tolerances = contact_tolerances(self.clearance_m, self.stiffness_n_per_m, tolerances)
        rig = msgspec.structs.replace(self._rig_of(body), tolerances=tolerances)
        return rig, (*notes, *_apparent_mass_note(body), *self.notes())

    def structure(self) -> tuple[Structure, tuple[str, ...], Tolerances | None]:
        """Body from its file, notes on it, and its tolerances if the file determines them.

        Raises RigError if the file cannot be used.
        """
        if (self.from_uff is None) == (self.body is None):
            raise RigError("give the body of the structure by one file: --from-uff FILE, or --body FILE.json")
        if self.from_uff is None:
            if self.exponential_window_s is not None:
                raise RigError("exponential_window_s goes with --from-uff; a structure by --body has its own damping")
            return self._with_rigid_modes(self._from_json()), (), None
        choice = UffSelection(
            axis=self.along,
            direction=self.direction,
            nodes=self.nodes,
            positions_m=self.positions_m,
            length_m=self.length_m,
            band_hz=self.band_hz,
            exponential_window_s=self.exponential_window_s,
        )
        body, notes, tolerances = structure_from_uff(self.from_uff, choice)
        return self._with_rigid_modes(body), notes, tolerances

    def _rig_of(self, body: Structure) -> Rig:
        contacts_m, stations_m = (
            [_nearest_basis_position_m(body, position_m, option) for position_m in positions_m]
            for option, positions_m in (("contacts_m", self.contacts_m), ("stations_m", self.stations_m))
        )
        force_m = _nearest_basis_position_m(body, self.force_m, "force_m")
        sensor_positions_m = stations_m or spread_positions(
            [*contacts_m, force_m], body.length_m, among_m=body.positions_m.tolist()
        )
        meeting_stations = [(Station(body.name, position_m), None) for position_m in contacts_m]
        return self._rig(
            (body,), meeting_stations, Station(body.name, force_m), [Station(body.name, x) for x in sensor_positions_m]
        )

    def _from_json(self) -> Structure:
        path = self.body or Path()
        try:
            decoded = msgspec.json.decode(path.read_bytes())
        except OSError as error:
            raise RigError(f"{path}: cannot be opened ({error.strerror or error}); check the name") from error
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise RigError(f"{path}: is no structure ({error}); see rig/model/README.md") from error
        return converted(decoded, Structure, f"{path}: is no structure")

    def _with_rigid_modes(self, body: Structure) -> Structure:
        """Body with a translation, 1/sqrt(m), and a rotation, (x - centre)/sqrt(J), prepended as modes of 0 Hz."""
        rigid_options = (self.mass_kg, self.centre_m, self.inertia_kg_m2)
        if rigid_options == (None, None, None):
            return body
        if self.mass_kg is None or self.centre_m is None or self.inertia_kg_m2 is None:
            raise RigError("mass_kg, centre_m and inertia_kg_m2 belong together; give all three, or none")
        if body.rigid_modes:
            raise RigError(f"{body.name!r} has {body.rigid_modes} rigid-body modes already; leave mass_kg out")
        if not (0 < self.mass_kg < np.inf and 0 < self.inertia_kg_m2 < np.inf):
            raise RigError(
                f"mass_kg is {self.mass_kg} and inertia_kg_m2 {self.inertia_kg_m2}; give finite values above zero"
            )
        positions_m = body.positions_m
        rotation_shape = (positions_m - self.centre_m) / np.sqrt(self.inertia_kg_m2)
        rigid_shapes = np.stack([np.full(len(positions_m), 1 / np.sqrt(self.mass_kg)), rotation_shape], axis=1)
        return structure_of(
            body.name,
            body.length_m,
            np.append(np.zeros(2), body.natural_hz),
            np.append(np.zeros(2), body.ratios),
            positions_m,
            np.append(rigid_shapes, body.shapes(positions_m, body.max_modes), axis=1),
            [row.node for row in body.rows],
        )


def _apparent_mass_note(body: Structure) -> tuple[str, ...]:
    """Note on the apparent mass of the first elastic mode, which reveals wrong units of shapes or modal masses."""
    if body.max_modes <= body.rigid_modes:
        return ()
    shapes = body.shapes(body.positions_m, body.max_modes)[:, body.rigid_modes]
    largest_index = int(np.argmax(np.abs(shapes)))
    return (
        f"the mode at {body.natural_hz[body.rigid_modes]:.4g} Hz moves like a mass of "
        f"{1 / shapes[largest_index] ** 2:.3g} kg at {body.positions_m[largest_index]:.4g} m: compare that with the "
        "part's weight (the end of a uniform beam moves like a quarter of it); else the units of shapes or modal "
        "masses are wrong",
    )


def _nearest_basis_position_m(body: Structure, position_m: float, option: str) -> float:
    """Place of the modal basis nearest to position_m; raises RigError if it is too far."""
    nearest_m = float(body.positions_m[np.argmin(np.abs(body.positions_m - position_m))])
    if not abs(nearest_m - position_m) <= SAME_PLACE_SHARE * body.length_m:
        raise RigError(
            f"{option} has {position_m} m, where {body.name!r} has no shapes; the nearest place that has is "
            f"{nearest_m:g} m (places begin at the first of its nodes or stations)"
        )
    return nearest_m
