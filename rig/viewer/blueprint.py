"""What the rerun viewer shows where: the moving rig and the contacts on the left, the time series on the right."""

from dataclasses import dataclass

import rerun as rr
import rerun.blueprint as rrb

from rig.model.description import UNITS, Contact, Rig
from rig.model.quantities import QUANTITIES, QuantityName
from rig.model.sensing import quantities_of, sensors_of

TIMELINE = "sim_time"
WINDOW_S = 0.5
"""What the plots show before and after the moment."""
TRAIL_S = 0.1
"""What a close-up shows before the moment."""


@dataclass(frozen=True)
class Layout:
    """What of a recording there is to show, and how it is drawn."""

    rig: Rig
    contact_force: bool
    magnification: float
    approximate: bool
    stride: int
    """One of so many samples is in the time series."""
    centre_m: float
    extent_m: float
    frame_rate_hz: float
    largest_relative_m: tuple[float, ...]
    """Of each contact's relative displacement."""

    def reach_mm(self, contact: Contact) -> float:
        """How far the views of a contact need to reach."""
        largest = self.largest_relative_m[self.rig.contacts.index(contact)]
        return 1.2e3 * max(contact.law.lower_clearance_m, contact.law.upper_clearance_m, largest) or 1.0


def entity(*parts: str) -> str:
    """The entity path of these parts, whatever characters their names have."""
    return str(rr.new_entity_path(list(parts)))


def plotted(rig: Rig) -> list[QuantityName]:
    """The measured quantities that have plots: all but displacements, which the moving bodies show."""
    return [name for name in quantities_of(rig) if QUANTITIES[name].order or not QUANTITIES[name].translates]


def blueprint(layout: Layout) -> rrb.Blueprint:
    """Paused and slowed down so that every frame is seen; the plots show a window around the moment."""
    close_ups = [_close_up(contact, layout.reach_mm(contact), _caveat(layout)) for contact in layout.rig.contacts]
    phases = [_phase(layout, contact) for contact in layout.rig.contacts]
    rows = [rrb.Horizontal(*close_ups), rrb.Horizontal(*phases)]
    left = rrb.Vertical(_model(layout), *rows, row_shares=[3, 2, 2]) if close_ups else _model(layout)
    speed = float(f"{60 / layout.frame_rate_hz:.1g}")
    return rrb.Blueprint(
        rrb.Horizontal(left, rrb.Vertical(*_plots(layout)), column_shares=[1, 1]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused", playback_speed=speed),
        auto_layout=False,
        auto_views=False,
    )


def _model(layout: Layout) -> rrb.Spatial3DView:
    x, far = layout.centre_m, layout.extent_m
    return rrb.Spatial3DView(
        origin="/model",
        name=f"{layout.rig.name}: deflection magnified {layout.magnification:g} times{_caveat(layout)}",
        eye_controls=rrb.EyeControls3D(
            position=(x, -0.85 * far, 0.3 * far), look_target=(x, -0.05 * far, 0), eye_up=(0, 0, 1)
        ),
        line_grid=rrb.LineGrid3D(visible=False),
    )


def _close_up(contact: Contact, reach_mm: float, caveat: str) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
        origin=entity("close_up", contact.name),
        name=f"{contact.name}: last {TRAIL_S:g} s, true scale{caveat}",
        visual_bounds=rrb.VisualBounds2D(x_range=[-1.2 * reach_mm, 1.2 * reach_mm], y_range=[-reach_mm, reach_mm]),
    )


def _phase(layout: Layout, contact: Contact) -> rrb.View | rrb.Container:
    """Force over relative displacement, all of it until the moment; behind it how often each displacement occurs."""
    reach_mm = layout.reach_mm(contact)
    histogram = rrb.BarChartView(
        origin=entity("histogram", contact.name), name=f"{contact.name}: histogram, % of the time over mm"
    )
    if not layout.contact_force:
        return histogram
    until_now = rr.VisibleTimeRange(
        TIMELINE, start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.cursor_relative()
    )
    force = rrb.Spatial2DView(
        origin=entity("phase", contact.name),
        name=f"{contact.name}: force over relative displacement",
        visual_bounds=rrb.VisualBounds2D(x_range=[-1.2 * reach_mm, 1.2 * reach_mm], y_range=[-reach_mm, reach_mm]),
        time_ranges=[until_now],
    )
    return rrb.Tabs(force, histogram, active_tab=0)


def _plots(layout: Layout) -> list[rrb.View | rrb.Container]:
    measured = [
        _plot(layout, entity(quantity, body.name), f"{body.name}: {quantity}, {UNITS[quantity].replace('^2', '²')}")
        for quantity in plotted(layout.rig)
        for body in layout.rig.bodies
        if any(s.station.body == body.name for s in sensors_of(layout.rig, quantity))
    ]
    return [
        *(
            _plot(
                layout,
                entity("relative_displacement", c.name),
                f"{c.name}: relative displacement, mm{_caveat(layout)}",
                layout.reach_mm(c),
            )
            for c in layout.rig.contacts
        ),
        *([_plot(layout, "contact_force", "Contact force, N")] if layout.contact_force else []),
        rrb.Tabs(
            *([rrb.TextLogView(origin="/events", name="Contacts that close and open")] if layout.rig.contacts else []),
            _plot(layout, "exciting_force", "Exciting force, N"),
            *measured,
            active_tab=0,
        ),
    ]


def _plot(layout: Layout, origin: str, name: str, reach: float | None = None) -> rrb.TimeSeriesView:
    thinned = ""
    if layout.stride > 1:
        near = ", all near contacts" if origin.startswith(("/relative", "/contact", "relative", "contact")) else ""
        thinned = f" (every {layout.stride}th sample{near})"
    return rrb.TimeSeriesView(
        origin=origin,
        name=name + thinned,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
        axis_y=None if reach is None else rrb.ScalarAxis(range=(-reach, reach)),
        axis_x=rrb.TimeAxis(
            view_range=rr.TimeRange(
                start=rr.TimeRangeBoundary.cursor_relative(seconds=-WINDOW_S),
                end=rr.TimeRangeBoundary.cursor_relative(seconds=WINDOW_S),
            )
        ),
    )


def _caveat(layout: Layout) -> str:
    return " (approximate, above 1 Hz)" if layout.approximate else ""
