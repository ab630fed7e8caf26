"""Blueprint of the rerun viewer: the moving rig and its contacts left, plots right; prediction and spectra in tabs."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from rig.model.description import UNITS, Contact, Rig
from rig.model.quantities import QUANTITIES, QuantityName, printed_unit
from rig.model.sensing import quantities_of, sensors_of
from rig.viewer.axes import axes_view
from rig.viewer.drawing import DIAGNOSIS, GAP_OVER_TIME, KEY, LEGEND_ROW_COUNT, PREDICTION, TIMELINE, entity, legend_of
from rig.viewer.palette import ColourMeaning
from rig.viewer.spectra import ShownSpectra

HALF_WINDOW_S = 0.5
"""Time that plots show before and after the cursor, s."""
DISPLACEMENT, DISTANCE = "relative displacement", "distance from the centre"
"""Motion of a contact in words: of an annular one, which is an orbit, how far it is from the centre of its ring."""
PREDICTED_RIGS = "model/prediction"
"""Entities of the predicted rigs."""
MAX_PLOTS_SIDE_BY_SIDE = 2
"""Plots of force over displacement that have room for their labels side by side; more stand behind tabs."""
TRAIL_S = 0.1
"""Time that a close-up shows before the cursor, s."""


@dataclass(frozen=True)
class Layout:
    """Content of a recording that is shown, and how it is drawn."""

    rig: Rig
    contact_force: Literal["true", "separated"] | None
    magnification: float
    is_approximate: bool
    stride: int
    """Decimation of the time series, in samples."""
    centre_m: float
    extent_m: float
    frame_rate_hz: float
    reach_by_contact_mm: dict[str, float]
    """Half width of the views of each contact, mm."""
    spectra: tuple[ShownSpectra, ...]
    has_diagnosis: bool
    meanings: tuple[ColourMeaning, ...]
    """Meanings of the colours that are shown."""
    masses_alone: bool = False
    predicted_station_name: str | None = None
    """Name of the station whose predicted displacement is shown, if a prediction is."""


def plotted_quantities(rig: Rig) -> list[QuantityName]:
    """Measured quantities that have plots: all except displacements, which the moving bodies show."""
    return [name for name in quantities_of(rig) if QUANTITIES[name].order or not QUANTITIES[name].translates]


def blueprint(layout: Layout) -> rrb.Blueprint:
    """Blueprint of the viewer, paused and slowed down so that every frame is visible."""
    close_ups = [
        _close_up_view(contact, layout.reach_by_contact_mm[contact.name], _approximation_note(layout, of_contact=True))
        for contact in layout.rig.contacts
    ]
    model_view = _model_view(layout)
    left_column = rrb.Vertical(model_view, rrb.Horizontal(*close_ups), row_shares=[5, 3]) if close_ups else model_view
    row_shares = [1.0] * len(close_ups) + [max(1.0, len(close_ups) / MAX_PLOTS_SIDE_BY_SIDE)]
    motion_view = rrb.Horizontal(
        left_column, rrb.Vertical(*_plot_views(layout), row_shares=row_shares), column_shares=[3, 2]
    )
    tabs = [rrb.Vertical(_colour_key_view(layout), motion_view, row_shares=[1, 14], name="Motion")]
    if layout.predicted_station_name is not None:
        tabs.append(_prediction_tab(layout, layout.predicted_station_name))
    tabs.append(rrb.Grid(*(axes_view(spectra.origin, spectra.title) for spectra in layout.spectra), name="Spectra"))
    playback_speed = float(f"{60 / layout.frame_rate_hz:.1g}")
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=0 if layout.predicted_station_name is None else 1),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused", playback_speed=playback_speed),
        auto_layout=False,
        auto_views=False,
    )


def _colour_key_view(layout: Layout) -> rrb.Spatial2DView:
    visual_bounds = rrb.VisualBounds2D(x_range=[0.0, len(layout.meanings)], y_range=[-0.02, 0.12])
    return rrb.Spatial2DView(origin=KEY, name="What the colours mean", visual_bounds=visual_bounds)


def _model_view(
    layout: Layout, view_name: str = "", hidden_path: str = PREDICTED_RIGS, distance_factor: float = 1.0
) -> rrb.Spatial3DView:
    """View of the moving rig, from farther away where it is narrow; another tab shows the entities of hidden_path."""
    centre_m, extent_m = layout.centre_m, layout.extent_m
    distance_share, height_share = (
        (0.8 if len(layout.rig.bodies) > 1 else 0.9, 0.12) if layout.masses_alone else (0.72, 0.16)
    )
    return rrb.Spatial3DView(
        origin="/model",
        contents=["+ $origin/**", f"- /{hidden_path}/**"],
        name=view_name
        or f"{layout.rig.name}: motion and play magnified {layout.magnification:g} times{_approximation_note(layout)}",
        eye_controls=rrb.EyeControls3D(
            position=(
                centre_m,
                -distance_factor * distance_share * extent_m,
                distance_factor * height_share * extent_m,
            ),
            look_target=(centre_m, -0.05 * extent_m, 0),
            eye_up=(0, 0, 1),
        ),
        line_grid=rrb.LineGrid3D(visible=False),
    )


def _prediction_tab(layout: Layout, station_name: str) -> rrb.Vertical:
    """Tab of the prediction: both rigs over the measured one left, displacement and errors over time right."""
    view_name = f"{layout.rig.name}: measured, and predicted by both rigs; magnified {layout.magnification:g} times"
    words_view = rrb.TextDocumentView(origin=f"{PREDICTION}/words", name="How well both rigs predict")
    plot_views = (
        _plot_view(
            layout, f"{PREDICTION}/displacement", f"{station_name}: displacement, mm{_approximation_note(layout)}"
        ),
        _plot_view(layout, f"{PREDICTION}/error", "Error of the displacement over all stations, mm rms"),
    )
    model_view = rrb.Vertical(_model_view(layout, view_name, "model/gap", 1.2), words_view, row_shares=[4, 1])
    motion_view = rrb.Horizontal(model_view, rrb.Vertical(*plot_views), column_shares=[3, 2])
    return rrb.Vertical(_colour_key_view(layout), motion_view, row_shares=[1, 14], name="Prediction")


def _close_up_view(contact: Contact, reach_mm: float, caveat: str) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
        origin=entity("close_up", contact.name),
        name=f"{contact.name}: last {TRAIL_S:g} s, true scale{caveat}",
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-2.6 * reach_mm, 2.6 * reach_mm], y_range=[-1.5 * reach_mm, 1.2 * reach_mm]
        ),
    )


def _phase_view(layout: Layout, contact: Contact) -> rrb.View | rrb.Container:
    """View of force over relative displacement until the cursor, with the displacement's histogram behind a tab."""
    histogram_view = rrb.BarChartView(
        origin=entity("histogram", contact.name),
        name=f"{contact.name}: % of the time over mm",
        plot_legend=rrb.PlotLegend(visible=False),
    )
    if layout.contact_force is None:
        return histogram_view
    range_until_cursor = rr.VisibleTimeRange(
        TIMELINE, start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.cursor_relative()
    )
    view_name = f"{contact.name}: {layout.contact_force} force"
    force_view = axes_view(entity("phase", contact.name), view_name, time_ranges=[range_until_cursor])
    return rrb.Tabs(force_view, histogram_view, active_tab=0, name=contact.name)


def _plot_views(layout: Layout) -> list[rrb.View | rrb.Container]:
    thinning_note = ", all near contacts"
    source_words = "identified " if layout.contact_force == "separated" else ""
    sensor_plots = [
        _plot_view(layout, entity(quantity, body.name), f"{body.name}: {quantity}, {printed_unit(UNITS[quantity])}")
        for quantity in plotted_quantities(layout.rig)
        for body in layout.rig.bodies
        if any(sensor.station.body == body.name for sensor in sensors_of(layout.rig, quantity))
    ]
    displacement_plots = [
        _plot_view(
            layout,
            entity("relative_displacement", contact.name),
            f"{contact.name}: {source_words}{DISTANCE if contact.law.spatial else DISPLACEMENT}, mm"
            f"{_approximation_note(layout, of_contact=True)}",
            thinning_note,
            _displacement_range(contact, layout.reach_by_contact_mm[contact.name]),
        )
        for contact in layout.rig.contacts
    ]
    tabs: list[rrb.View | rrb.Container] = [*_diagnosis_views()] if layout.has_diagnosis else []
    if phase_views := [_phase_view(layout, contact) for contact in layout.rig.contacts]:
        container = rrb.Tabs if len(phase_views) > MAX_PLOTS_SIDE_BY_SIDE else rrb.Horizontal
        tabs.append(container(*phase_views, name="Force over displacement" if layout.contact_force else "Histograms"))
    if layout.contact_force is not None:
        force_title = f"{layout.contact_force.capitalize()} contact force, N"
        tabs.append(_plot_view(layout, "contact_force", force_title, thinning_note))
    if displacement_plots:
        time_column = rrb.encodings.TimelineColumn(TIMELINE)
        body_column = rrb.encodings.TextLogColumn("Body")
        event_columns = rrb.TextLogColumns(timeline_columns=[time_column], text_log_columns=[body_column])
        tabs.append(rrb.TextLogView(origin="/events", name="Closings and openings", columns=event_columns))
    tabs += [_plot_view(layout, "exciting_force", "Exciting force, N"), *sensor_plots]
    return [*displacement_plots, rrb.Tabs(*tabs, active_tab=0)]


def _diagnosis_views() -> list[rrb.View]:
    return [
        rrb.TextDocumentView(origin=DIAGNOSIS, name="Diagnosis"),
        rrb.TimeSeriesView(origin=GAP_OVER_TIME, name="Gap over time, %", plot_legend=rrb.PlotLegend(visible=False)),
    ]


def _plot_view(
    layout: Layout, origin: str, plot_name: str, thinning_note: str = "", value_range: tuple[float, float] | None = None
) -> rrb.Horizontal:
    """View of a time series with its legend beside it."""
    start, end = (rr.TimeRangeBoundary.cursor_relative(seconds=seconds) for seconds in (-HALF_WINDOW_S, HALF_WINDOW_S))
    plot_view = rrb.TimeSeriesView(
        origin=origin,
        name=plot_name + (f" (1 of {layout.stride} samples{thinning_note})" if layout.stride > 1 else ""),
        plot_legend=rrb.PlotLegend(visible=False),
        axis_y=None if value_range is None else rrb.ScalarAxis(range=value_range),
        axis_x=rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=end)),
    )
    visual_bounds = rrb.VisualBounds2D(x_range=[-2.4, 2.4], y_range=[0, LEGEND_ROW_COUNT])
    legend_view = rrb.Spatial2DView(origin=legend_of(origin), name="Lines", visual_bounds=visual_bounds)
    return rrb.Horizontal(plot_view, legend_view, column_shares=[5, 1], name=plot_name)


def _displacement_range(contact: Contact, reach_mm: float) -> tuple[float, float]:
    return (0.0, reach_mm) if contact.law.spatial else (-labelled_axis_end(reach_mm), labelled_axis_end(reach_mm))


def labelled_axis_end(half_range: float) -> float:
    """End of an axis about zero at which the viewer, which labels powers of ten only, has a label."""
    power_of_ten = 10.0 ** np.ceil(np.log10(half_range))
    return half_range if half_range < 0.4 * power_of_ten else max(half_range, 1.05 * power_of_ten)


def _approximation_note(layout: Layout, of_contact: bool = False) -> str:
    is_integrated = layout.is_approximate and not (of_contact and layout.contact_force == "separated")
    return " (approximate, above 1 Hz)" if is_integrated else ""
