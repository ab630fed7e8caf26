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
from rig.viewer.drawing import (
    DIAGNOSIS,
    GAP_OVER_TIME,
    KEY,
    LEGEND_ROWS,
    PREDICTION,
    TIMELINE,
    entity,
    legend_of,
)
from rig.viewer.palette import MEANINGS
from rig.viewer.spectra import ShownSpectra

WINDOW_S = 0.5
"""Time that plots show before and after the cursor, s."""
GHOSTS = "model/prediction"
"""Entities of the predicted rigs."""
MAX_SIDE_BY_SIDE = 2
"""Plots of force over displacement that have room for their labels side by side; more stand behind tabs."""
TRAIL_S = 0.1
"""Time that a close-up shows before the cursor, s."""


@dataclass(frozen=True)
class Layout:
    """Content of a recording that is shown, and how it is drawn."""

    rig: Rig
    contact_force: Literal["true", "separated"] | None
    magnification: float
    approximate: bool
    stride: int
    """Decimation of the time series, in samples."""
    centre_m: float
    extent_m: float
    frame_rate_hz: float
    reach_mm: dict[str, float]
    """Half width of the views of each contact, mm."""
    spectra: tuple[ShownSpectra, ...]
    diagnosis: bool
    masses_alone: bool = False
    predicted_at: str | None = None
    """Name of the station whose predicted displacement is shown, if a prediction is."""


def plotted(rig: Rig) -> list[QuantityName]:
    """Measured quantities that have plots: all except displacements, which the moving bodies show."""
    return [name for name in quantities_of(rig) if QUANTITIES[name].order or not QUANTITIES[name].translates]


def blueprint(layout: Layout) -> rrb.Blueprint:
    """Blueprint of the viewer, paused and slowed down so that every frame is visible."""
    close_ups = [
        _close_up(contact, layout.reach_mm[contact.name], _caveat(layout, contact=True))
        for contact in layout.rig.contacts
    ]
    model = _model(layout)
    left_column = rrb.Vertical(model, rrb.Horizontal(*close_ups), row_shares=[5, 3]) if close_ups else model
    shares = [1.0] * len(close_ups) + [max(1.0, len(close_ups) / MAX_SIDE_BY_SIDE)]
    motion = rrb.Horizontal(left_column, rrb.Vertical(*_plots(layout), row_shares=shares), column_shares=[3, 2])
    tabs = [rrb.Vertical(_key(), motion, row_shares=[1, 14], name="Motion")]
    if layout.predicted_at is not None:
        tabs.append(_prediction(layout, layout.predicted_at))
    tabs.append(rrb.Grid(*(axes_view(spectra.origin, spectra.title) for spectra in layout.spectra), name="Spectra"))
    speed = float(f"{60 / layout.frame_rate_hz:.1g}")
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=0 if layout.predicted_at is None else 1),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused", playback_speed=speed),
        auto_layout=False,
        auto_views=False,
    )


def _key() -> rrb.Spatial2DView:
    bounds = rrb.VisualBounds2D(x_range=[0.0, len(MEANINGS)], y_range=[-0.02, 0.12])
    return rrb.Spatial2DView(origin=KEY, name="What the colours mean", visual_bounds=bounds)


def _model(layout: Layout, name: str = "", left_out: str = GHOSTS, farther: float = 1.0) -> rrb.Spatial3DView:
    """View of the moving rig, from `farther` where it is narrow; `left_out` are entities that another tab shows."""
    x, extent_m = layout.centre_m, layout.extent_m
    away, above = (0.8 if len(layout.rig.bodies) > 1 else 0.9, 0.12) if layout.masses_alone else (0.72, 0.16)
    return rrb.Spatial3DView(
        origin="/model",
        contents=["+ $origin/**", f"- /{left_out}/**"],
        name=name or f"{layout.rig.name}: motion and play magnified {layout.magnification:g} times{_caveat(layout)}",
        eye_controls=rrb.EyeControls3D(
            position=(x, -farther * away * extent_m, farther * above * extent_m),
            look_target=(x, -0.05 * extent_m, 0),
            eye_up=(0, 0, 1),
        ),
        line_grid=rrb.LineGrid3D(visible=False),
    )


def _prediction(layout: Layout, station: str) -> rrb.Vertical:
    """Tab of the prediction: both rigs over the measured one left, displacement and errors over time right."""
    name = f"{layout.rig.name}: measured, and predicted by both rigs; magnified {layout.magnification:g} times"
    words = rrb.TextDocumentView(origin=f"{PREDICTION}/words", name="How well both rigs predict")
    plots = (
        _plot(layout, f"{PREDICTION}/displacement", f"{station}: displacement, mm{_caveat(layout)}"),
        _plot(layout, f"{PREDICTION}/error", "Error of the displacement over all stations, mm rms"),
    )
    model = rrb.Vertical(_model(layout, name, "model/gap", 1.2), words, row_shares=[4, 1])
    motion = rrb.Horizontal(model, rrb.Vertical(*plots), column_shares=[3, 2])
    return rrb.Vertical(_key(), motion, row_shares=[1, 14], name="Prediction")


def _close_up(contact: Contact, reach_mm: float, caveat: str) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
        origin=entity("close_up", contact.name),
        name=f"{contact.name}: last {TRAIL_S:g} s, true scale{caveat}",
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-2.6 * reach_mm, 2.6 * reach_mm], y_range=[-1.5 * reach_mm, 1.2 * reach_mm]
        ),
    )


def _phase(layout: Layout, contact: Contact) -> rrb.View | rrb.Container:
    """View of force over relative displacement until the cursor, with the displacement's histogram behind a tab."""
    histogram = rrb.BarChartView(
        origin=entity("histogram", contact.name),
        name=f"{contact.name}: % of the time over mm",
        plot_legend=rrb.PlotLegend(visible=False),
    )
    if layout.contact_force is None:
        return histogram
    until_now = rr.VisibleTimeRange(
        TIMELINE, start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.cursor_relative()
    )
    name = f"{contact.name}: {layout.contact_force} force"
    force = axes_view(entity("phase", contact.name), name, time_ranges=[until_now])
    return rrb.Tabs(force, histogram, active_tab=0, name=contact.name)


def _plots(layout: Layout) -> list[rrb.View | rrb.Container]:
    note = ", all near contacts"
    identified = "identified " if layout.contact_force == "separated" else ""
    measured = [
        _plot(layout, entity(quantity, body.name), f"{body.name}: {quantity}, {printed_unit(UNITS[quantity])}")
        for quantity in plotted(layout.rig)
        for body in layout.rig.bodies
        if any(s.station.body == body.name for s in sensors_of(layout.rig, quantity))
    ]
    relative = [
        _plot(
            layout,
            entity("relative_displacement", c.name),
            f"{c.name}: {identified}relative displacement, mm{_caveat(layout, contact=True)}",
            note,
            axis_reach(layout.reach_mm[c.name]),
        )
        for c in layout.rig.contacts
    ]
    force, source = [], layout.contact_force
    if source is not None:
        force = [_plot(layout, "contact_force", f"{source.capitalize()} contact force, N", note)]
    phases = [_phase(layout, contact) for contact in layout.rig.contacts]
    name = "Force over displacement" if force else "Histograms"
    many = len(phases) > MAX_SIDE_BY_SIDE
    laws = [rrb.Tabs(*phases, name=name) if many else rrb.Horizontal(*phases, name=name)] if phases else []
    time = rrb.encodings.TimelineColumn(TIMELINE)
    text = rrb.encodings.TextLogColumn("Body")
    events = rrb.TextLogView(
        origin="/events",
        name="Contacts that close and open",
        columns=rrb.TextLogColumns(timeline_columns=[time], text_log_columns=[text]),
    )
    force_view = _plot(layout, "exciting_force", "Exciting force, N")
    diagnosis = _diagnosis() if layout.diagnosis else []
    tabs = [*diagnosis, *laws, *force, *([events] if relative else []), force_view, *measured]
    return [*relative, rrb.Tabs(*tabs, active_tab=0)]


def _diagnosis() -> list[rrb.View]:
    return [
        rrb.TextDocumentView(origin=DIAGNOSIS, name="Diagnosis"),
        rrb.TimeSeriesView(origin=GAP_OVER_TIME, name="Gap over time, %", plot_legend=rrb.PlotLegend(visible=False)),
    ]


def _plot(layout: Layout, origin: str, name: str, note: str = "", reach: float | None = None) -> rrb.Horizontal:
    """View of a time series with its legend beside it."""
    plot = rrb.TimeSeriesView(
        origin=origin,
        name=name + (f" (1 of {layout.stride} samples{note})" if layout.stride > 1 else ""),
        plot_legend=rrb.PlotLegend(visible=False),
        axis_y=None if reach is None else rrb.ScalarAxis(range=(-reach, reach)),
        axis_x=rrb.TimeAxis(
            view_range=rr.TimeRange(
                start=rr.TimeRangeBoundary.cursor_relative(seconds=-WINDOW_S),
                end=rr.TimeRangeBoundary.cursor_relative(seconds=WINDOW_S),
            )
        ),
    )
    bounds = rrb.VisualBounds2D(x_range=[-2.4, 2.4], y_range=[0, LEGEND_ROWS])
    legend = rrb.Spatial2DView(origin=legend_of(origin), name="Lines", visual_bounds=bounds)
    return rrb.Horizontal(plot, legend, column_shares=[5, 1], name=name)


def axis_reach(reach: float) -> float:
    """End of an axis about zero for which the viewer, which labels powers of ten only, shows a label."""
    power = 10.0 ** np.ceil(np.log10(reach))
    return reach if reach < 0.4 * power else max(reach, 1.05 * power)


def _caveat(layout: Layout, contact: bool = False) -> str:
    integrated = layout.approximate and not (contact and layout.contact_force == "separated")
    return " (approximate, above 1 Hz)" if integrated else ""
