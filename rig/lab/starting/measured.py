"""A first rig of a body whose modes are fitted to a recording of it."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec.structs import replace

from rig.errors import RigError
from rig.lab.clock import samples_on_one_clock
from rig.lab.csv_text import TextForm
from rig.lab.import_map import Source, TimeSource
from rig.lab.importing import columns_and_si_factors, timed_channels
from rig.lab.modal.record import MeasuredResponse, fit_record
from rig.lab.starting.base import Start, contacts_of
from rig.lab.tables import read_table
from rig.model.contact_laws.dead_zone import symmetric_dead_zone
from rig.model.description import Rig, Station
from rig.model.quantities import QUANTITIES
from rig.model.sensing import named_sensor
from rig.model.structure import Structure
from rig.model.tolerances import Tolerances
from rig.recording import RIG_NAME


class MeasuredRig(Start, frozen=True, kw_only=True):
    """A body whose modes are fitted to a recording at a low level, at which no contact closes."""

    from_record: Annotated[Path, msgspec.Meta(description="The recording: CSV, UFF, MATLAB or TDMS.")]
    force_column: Annotated[str, msgspec.Meta(description="Its column of the force, by name or number.")]
    columns: Annotated[tuple[str, ...], msgspec.Meta(description="Those of the sensors, with commas.")]
    positions_m: Annotated[tuple[float, ...], msgspec.Meta(description="Places of these sensors, m, in their order.")]
    force_m: Annotated[float, msgspec.Meta(description="Place of the force, m, where a sensor must be.")]
    force_unit: Annotated[str, msgspec.Meta(description="Unit of the force.")] = "N"
    unit: Annotated[str | None, msgspec.Meta(description="Unit of the sensors, where the file does not say it.")] = None
    time_column: Annotated[
        str | None, msgspec.Meta(description="Column of the time, s, where the file does not say its rate.")
    ] = None
    sample_rate_hz: Annotated[float | None, msgspec.Meta(description="... or its sampling rate, Hz.")] = None
    band_hz: Annotated[
        tuple[float, ...], msgspec.Meta(description="LOW,HIGH: the band that is fitted; otherwise the force's.")
    ] = ()
    length_m: Annotated[float | None, msgspec.Meta(description="Length; otherwise up to the last sensor.")] = None
    contacts_m: Annotated[
        tuple[float, ...],
        msgspec.Meta(description="Places of sensors that meet stops on the ground, if there are any."),
    ] = ()
    clearance_m: Annotated[
        float | None, msgspec.Meta(description="Clearance on each side of a contact, m, if there are any.")
    ] = None
    stiffness_n_per_m: Annotated[
        float | None, msgspec.Meta(description="Contact stiffness, N/m, if there are contacts.")
    ] = None
    damping_n_s_per_m: Annotated[float, msgspec.Meta(description="Contact damping, N s/m.")] = 0.0
    noise_density: Annotated[
        float | None, msgspec.Meta(description="Noise of the accelerometers; otherwise that of the recording.")
    ] = None

    def rig_and_notes(self) -> tuple[Rig, tuple[str, ...]]:
        self._check_options()
        measured = self._measured_response()
        driving_index = self.positions_m.index(self.force_m)
        length_m = max(self.positions_m) if self.length_m is None else self.length_m
        try:
            fit = fit_record(measured, self.positions_m, driving_index, length_m, self.band_hz, self.name)
        except RigError as error:
            raise RigError(f"{self.from_record}: {error}") from error
        noise_densities = fit.noise_density.tolist()
        if self.noise_density is not None:
            noise_densities = [self.noise_density] * len(noise_densities)
        law = symmetric_dead_zone(self.clearance_m or 0.0, self.stiffness_n_per_m or 0.0, self.damping_n_s_per_m)
        stations = [Station(self.name, position_m) for position_m in self.positions_m]
        sensors = (
            replace(named_sensor(station, self.quantity[0]), noise_density=float(f"{noise_density:.3g}"))
            for station, noise_density in zip(stations, noise_densities, strict=True)
        )
        rig = Rig(
            name=self.name,
            bodies=(fit.body,),
            contacts=contacts_of([(Station(self.name, position_m), None) for position_m in self.contacts_m], law),
            force_at=stations[driving_index],
            sensors=tuple(sensors),
            sample_rate_hz=measured.sample_rate_hz,
            tolerances=Tolerances(
                unmodelled=max(float(f"{fit.unmodelled_share:.2g}"), Tolerances().unmodelled),
                highest_hz=float(f"{fit.band_hz[1]:.4g}"),
            ),
        )
        repetition_words = f"repeats every {fit.period_s:.6g} s" if fit.period_s else "does not repeat"
        first_note = (
            f"{fit.body.max_modes} modes fitted to {len(self.columns)} responses of {self.from_record.name}, "
            f"{fit.band_hz[0]:.4g} to {fit.band_hz[1]:.4g} Hz; its force {repetition_words}"
        )
        misfit_notes = (
            f"{sensor.name}: a free run misses {misfit:.2%} rms of the response ({frf_misfit:.2%} by the FRFs' modes)"
            for sensor, misfit, frf_misfit in zip(rig.sensors, fit.misfits, fit.frf_fit_misfits, strict=True)
        )
        return rig, (first_note, *_mode_notes(fit.body, fit.band_hz), *misfit_notes)

    def map_text(self, rig: Rig) -> str:
        map_lines = [f"rig = {json.dumps(RIG_NAME)}"]
        if self.time_column:
            map_lines.append(f"time = {_map_entry(self.time_column, 's')}")
        else:
            map_lines.append(f"sample_rate_hz = {rig.sample_rate_hz!r}")
        map_lines.append(f"force = {_map_entry(self.force_column, self.force_unit)}")
        sensor_lines = (
            f"{json.dumps(sensor.name)} = {_map_entry(column, self.unit)}"
            for sensor, column in zip(rig.sensors, self.columns, strict=True)
        )
        return "\n".join([*map_lines, "", "[sensors]", *sensor_lines, ""])

    def _check_options(self) -> None:
        if len(self.columns) != len(self.positions_m):
            raise RigError(f"{len(self.columns)} columns and {len(self.positions_m)} positions_m are given; give each")
        if len(set(self.positions_m)) < len(self.positions_m):
            raise RigError("two positions_m are the same; the sensors of a body stand at different places")
        if len(self.quantity) != 1:
            raise RigError("quantity names more than one; fit the modes to sensors of one")
        if self.force_m not in self.positions_m:
            raise RigError(
                f"force_m is {self.force_m:g}, where no sensor is; shapes have no scale without the response there"
            )
        if self.contacts_m and (self.clearance_m is None or self.stiffness_n_per_m is None):
            raise RigError("contacts_m is given; give clearance_m and stiffness_n_per_m too")
        if unsensed_m := [position_m for position_m in self.contacts_m if position_m not in self.positions_m]:
            raise RigError(
                f"contacts_m has {unsensed_m[0]:g} m, where no sensor is; the shapes are known at sensors alone"
            )

    def _measured_response(self) -> MeasuredResponse:
        column_names = (self.force_column, *self.columns, self.time_column)
        table = read_table(self.from_record, TextForm(), [_source(name, None).column for name in column_names if name])
        source_by_name = {"force": ("force", _source(self.force_column, self.force_unit))}
        for sensor_number, name in enumerate(self.columns, start=1):
            source_by_name[f"sensor {sensor_number}"] = (self.quantity[0], _source(name, self.unit))
        try:
            column_by_name, si_factors = columns_and_si_factors(table, source_by_name)
            time_source = TimeSource(_source(self.time_column, None).column, "s") if self.time_column else None
            time_by_name = dict.fromkeys(column_by_name, time_source)
            groups, _ = timed_channels(table, column_by_name, si_factors, time_by_name, self.sample_rate_hz)
            rate_hz = self.sample_rate_hz or float(f"{groups[0].times.rate_hz:.9g}")
            row_by_name, _ = samples_on_one_clock(groups, rate_hz, resample=False)
            si_rows = np.stack([row_by_name[name] for name in column_by_name])
        except RigError as error:
            raise RigError(f"{self.from_record}: {error}") from error
        return MeasuredResponse(si_rows[0], si_rows[1:], QUANTITIES[self.quantity[0]].order, rate_hz)


def _source(column: str, unit: str | None) -> Source:
    return Source(int(column) if column.isdecimal() else column, unit)


def _map_entry(column: str, unit: str | None) -> str:
    """Entry of the import map; JSON strings are valid TOML strings."""
    source = _source(column, unit)
    return f"{{ column = {json.dumps(source.column)}{f', unit = {json.dumps(unit)}' if unit else ''} }}"


def _mode_notes(body: Structure, band_hz: tuple[float, float]) -> Iterator[str]:
    for natural_hz, damping_ratio in zip(body.natural_hz, body.ratios, strict=True):
        band_note = "" if band_hz[0] <= natural_hz <= band_hz[1] else ", stands for those outside the band"
        yield f"mode: {natural_hz:.6g} Hz, damping ratio {damping_ratio:.4g}{band_note}"
