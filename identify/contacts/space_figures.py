"""Figures of an identification in space: orbits, forces over radius and angle, friction, and kinds of motion."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from identify.contacts.annular_estimate import AnnularEstimate
from identify.contacts.annular_law import CLEARANCE, FRICTION, LOG_SPEED, STIFFNESS
from identify.contacts.space_identification import SpaceIdentification
from identify.pages.style import BLUE, GREEN, GREY, RED, Picture, picture
from identify.pages.tables import Table
from rig.model.contact_laws import ContactLaw
from rig.model.contact_laws.annular import Annular

Laws = Mapping[str, ContactLaw]
Samples = Float[np.ndarray, " fewer"]
MAX_POINTS = 6000
"""Points of a figure."""
EXCERPT_S = 1.0
CLOSED_FORCE_SHARE = 0.2
"""Share of the 99.5 % quantile of the normal force from which its ratio to friction is drawn."""


@dataclass(frozen=True)
class _Panel:
    """Axes of a figure for one annular contact: its estimate, and the reference law by the name of the references."""

    figure: Any
    axes: Any
    result: SpaceIdentification
    estimate: AnnularEstimate
    reference_law: ContactLaw | None
    reference_name: str

    @property
    def eta_m(self) -> Float[np.ndarray, "2 fewer"]:
        """Relative displacement at the samples of the separated force, m."""
        return _at_shown_forces(self.result, self.estimate.eta_m, self.estimate)

    @property
    def force_n(self) -> Float[np.ndarray, "2 fewer"]:
        """Separated force after the quiet seconds, N."""
        return self.estimate.force_n[:, _first_shown_sample(self.result) :]

    @property
    def radius_and_forces(self) -> tuple[Samples, Samples, Samples]:
        """Radius (m), and the separated force across and along the wall (N)."""
        (eta_y, eta_z), (force_y, force_z) = self.eta_m, self.force_n
        radius_m = np.maximum(np.hypot(eta_y, eta_z), 1e-12)
        return radius_m, (eta_y * force_y + eta_z * force_z) / radius_m, (eta_y * force_z - eta_z * force_y) / radius_m


def space_figures(result: SpaceIdentification, laws: Laws, laws_name: str) -> dict[str, Picture]:
    """Figures by name, of the annular contacts that are identified; `laws_name` names the reference laws."""
    estimates = result.contacts.annular
    if not estimates:
        return {}

    def drawn_picture(draw: Callable[[_Panel], None]) -> Picture:
        def draw_all(figure: Any) -> None:
            axes_row = figure.subplots(1, len(estimates), squeeze=False)[0]
            for axes, (name, estimate) in zip(axes_row, estimates.items(), strict=True):
                axes.set_title(name)
                draw(_Panel(figure, axes, result, estimate, laws.get(name), laws_name))
            handles, labels = axes_row[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside upper center", ncols=4, markerscale=4)

        return picture(draw_all)

    return {name: drawn_picture(draw) for name, draw in _SPACE_FIGURES.items()}


def _draw_orbit(panel: _Panel) -> None:
    """Relative displacement in its circle, coloured by the contact force."""
    axes, estimate = panel.axes, panel.estimate
    (eta_y_mm, eta_z_mm), force_size_n = 1e3 * panel.eta_m, np.hypot(*panel.force_n)
    drawn_samples = slice(None, None, max(1, force_size_n.size // MAX_POINTS))
    colour_style = {"c": force_size_n[drawn_samples], "cmap": "viridis"}
    points = axes.scatter(eta_z_mm[drawn_samples], eta_y_mm[drawn_samples], s=1.5, rasterized=True, **colour_style)
    panel.figure.colorbar(points, ax=axes, label="contact force, N", location="bottom")
    angles_rad = np.linspace(0, 2 * np.pi, 181)
    circle = np.stack([np.sin(angles_rad), np.cos(angles_rad)])
    clearance_circle_mm, line_style = 1e3 * estimate.values[CLEARANCE] * circle, {"lw": 1.4, "zorder": 3}
    axes.plot(*clearance_circle_mm, color="w", lw=4.0, zorder=3)  # seen upon the points
    axes.plot(*clearance_circle_mm, color=GREEN, label="clearance found", **line_style)
    if panel.reference_law is not None:
        label = f"clearance, {panel.reference_name}"
        axes.plot(*(1e3 * panel.reference_law.clearance_m * circle), color="k", ls=":", label=label, **line_style)
    axes.set(xlabel="η_z, mm", ylabel="η_y, mm", aspect="equal")


def _draw_normal_force_over_radius(panel: _Panel) -> None:
    """Normal force, separated without a law, over the radius, with the law found."""
    axes, estimate = panel.axes, panel.estimate
    radius_m, normal_n, _ = panel.radius_and_forces
    drawn = slice(None, None, max(1, radius_m.size // MAX_POINTS))
    axes.plot(1e3 * radius_m[drawn], normal_n[drawn], ".", ms=4, color=GREY, alpha=0.4, label="measured contact force")
    radius_grid_m = np.linspace(0, radius_m.max(), 200)
    law_force_n = estimate.values[STIFFNESS] * np.maximum(radius_grid_m - estimate.values[CLEARANCE], 0)
    axes.plot(1e3 * radius_grid_m, law_force_n, color=BLUE, lw=1.2, label="law found (without damping)")
    axes.axvline(1e3 * estimate.values[CLEARANCE], color=GREEN, lw=1.2, label="clearance found")
    if panel.reference_law is not None:
        reference_label = f"clearance, {panel.reference_name}"
        axes.axvline(1e3 * panel.reference_law.clearance_m, color="k", ls=":", lw=1.2, label=reference_label)
    axes.set(xlabel="radius |η|, mm", ylabel="normal force, N")


def _draw_normal_force_map(panel: _Panel) -> None:
    """Normal force over radius and angle, averaged in cells."""
    axes, estimate = panel.axes, panel.estimate
    radius_m, normal_n, _ = panel.radius_and_forces
    eta_y, eta_z = panel.eta_m
    angles_deg = np.degrees(np.arctan2(eta_z, eta_y))
    cells = axes.hexbin(angles_deg, 1e3 * radius_m, C=normal_n, gridsize=(36, 36), cmap="viridis", mincnt=2)
    panel.figure.colorbar(cells, ax=axes, label="normal force, N", shrink=0.7)
    axes.axhline(1e3 * estimate.values[CLEARANCE], color=GREEN, lw=1.2, label="clearance found")
    axes.set(xlabel="angle from y (up) towards z, degrees", ylabel="radius |η|, mm", xlim=(-180, 180))


def _draw_friction_ratio(panel: _Panel) -> None:
    """Ratio of the separated force along the wall to that across it, over the sliding velocity."""
    axes, estimate, law = panel.axes, panel.estimate, panel.reference_law
    radius_m, normal_n, tangential_n = panel.radius_and_forces
    (eta_y, eta_z), (rate_y, rate_z) = panel.eta_m, _at_shown_forces(panel.result, estimate.rate_m_per_s, estimate)
    is_closed = (normal_n > CLOSED_FORCE_SHARE * np.quantile(normal_n, 0.995)) & (radius_m > estimate.values[CLEARANCE])
    speed_m_per_s = ((eta_y * rate_z - eta_z * rate_y) / radius_m)[is_closed]
    friction_ratio = tangential_n[is_closed] / normal_n[is_closed]
    axes.plot(1e3 * speed_m_per_s, friction_ratio, ".", ms=4, color=GREY, alpha=0.4, label="measured contact force")
    low_m_per_s, high_m_per_s = np.quantile(speed_m_per_s, [0.005, 0.995]) if is_closed.any() else np.zeros(2)
    grid_m_per_s = np.linspace(low_m_per_s, high_m_per_s, 200)
    friction, sliding_m_per_s = estimate.values[FRICTION], np.exp(estimate.values[LOG_SPEED])
    law_ratio = friction * np.tanh(grid_m_per_s / sliding_m_per_s)
    axes.plot(1e3 * grid_m_per_s, law_ratio, color=BLUE, lw=1.2, label="law found")
    if isinstance(law, Annular):
        reference_ratio = law.friction_coefficient * np.tanh(grid_m_per_s / law.sliding_speed_m_per_s)
        axes.plot(1e3 * grid_m_per_s, reference_ratio, color="k", ls=":", lw=1.2, label=panel.reference_name)
    y_limit = 3 * abs(friction) + 0.05
    axes.set(xlabel="sliding velocity, mm/s", ylabel="force along the wall / normal force", ylim=(-y_limit, y_limit))


def _draw_motion_kinds(panel: _Panel) -> None:
    """Radius over time: open, sliding and sticking, of the first whirl or else of a part amid the record."""
    axes, result, estimate = panel.axes, panel.result, panel.estimate
    motion = result.contacts.separations[0].motion
    sample_count, rate_hz, start_s = estimate.eta_m.shape[1], motion.sample_rate_hz, motion.start_s
    shares = next(contact for contact in result.report.contacts if contact.name == axes.get_title()).ring
    whirls = () if shares is None else shares.whirls
    middle_s = sum(whirls[0]) / 2 if whirls else sample_count / rate_hz / 2 + start_s
    first_sample = max(0, min(round((middle_s - start_s - EXCERPT_S / 2) * rate_hz), sample_count - 2))
    excerpt = slice(first_sample, first_sample + round(EXCERPT_S * rate_hz))
    (eta_y, eta_z), (rate_y, rate_z) = estimate.eta_m[:, excerpt], estimate.rate_m_per_s[:, excerpt]
    radius_m = np.maximum(np.hypot(eta_y, eta_z), 1e-12)
    time_s = start_s + (first_sample + np.arange(radius_m.size)) / rate_hz
    is_closed = radius_m > estimate.values[CLEARANCE]
    is_sliding = np.abs(eta_y * rate_z - eta_z * rate_y) / radius_m > np.exp(estimate.values[LOG_SPEED])
    for mask, colour, label in (
        (~is_closed, GREY, "free"),
        (is_closed & is_sliding, BLUE, "sliding"),
        (is_closed & ~is_sliding, RED, "sticking"),
    ):
        axes.plot(time_s, np.where(mask, 1e3 * radius_m, np.nan), ".", ms=1.5, color=colour, label=label)
    for start_whirl_s, end_s in whirls:
        if time_s[0] < end_s and start_whirl_s < time_s[-1]:
            axes.axvspan(max(start_whirl_s, time_s[0]), min(end_s, time_s[-1]), color=GREEN, alpha=0.2, lw=0)
    axes.axhline(1e3 * estimate.values[CLEARANCE], color=GREEN, lw=1.0)
    axes.set(xlabel="time, s", ylabel="radius |η|, mm")


def _draw_nifo_stiffness(panel: _Panel) -> None:
    """Stiffness over frequency by NIFO in y and in z, each by the equation in which it varies least."""
    axes, result, contact_name = panel.axes, panel.result, panel.axes.get_title()
    planes = zip("yz", result.contacts.separations, result.methods, (BLUE, RED), strict=True)
    for direction, separation, methods, colour in planes:
        contact_index = [contact.name for contact in separation.rig.contacts].index(contact_name)
        for nifo in methods.main_nifo_results[:1]:
            if contact_index in nifo.contact_indices:
                stiffness_n_per_m = nifo.stiffness_n_per_m[nifo.contact_indices.index(contact_index)]
                label = f"NIFO, {nifo.equation.name} in {direction}"
                axes.plot(nifo.frequency_hz, stiffness_n_per_m.real, color=colour, lw=1.0, label=label)
    identified_n_per_m = panel.estimate.values[STIFFNESS]
    axes.axhline(identified_n_per_m, color=GREEN, lw=1.4, label="stiffness found")
    if panel.reference_law is not None:
        reference_label = f"stiffness, {panel.reference_name}"
        axes.axhline(panel.reference_law.stiffness_n_per_m, color="k", ls=":", lw=1.4, label=reference_label)
    axes.set(xlabel="frequency, Hz", ylabel="Re k, N/m", ylim=(0.0, 2 * identified_n_per_m))


def _first_shown_sample(result: SpaceIdentification) -> int:
    """First sample of the separated force after the quiet seconds, whose slow motion is not known."""
    return -(-result.contacts.separations[0].motion.excited_from // result.decimation)


def _at_shown_forces(
    result: SpaceIdentification, signals: Float[np.ndarray, "2 samples"], estimate: AnnularEstimate
) -> Float[np.ndarray, "2 fewer"]:
    """Signals at the samples of the separated force that are shown."""
    return signals[:, :: result.decimation][:, _first_shown_sample(result) : estimate.force_n.shape[1]]


_SPACE_FIGURES = {
    "orbit": _draw_orbit,
    "radial": _draw_normal_force_over_radius,
    "ring_surface": _draw_normal_force_map,
    "friction": _draw_friction_ratio,
    "kinds": _draw_motion_kinds,
    "nifo": _draw_nifo_stiffness,
}


def space_curves(result: SpaceIdentification) -> dict[str, Table]:
    """Curves `motion`: relative displacement less the centre and separated force of every annular contact over time."""
    table: Table = {}
    motion = result.contacts.separations[0].motion
    for name, estimate in result.contacts.annular.items():
        eta, first_sample = _at_shown_forces(result, estimate.eta_m, estimate), _first_shown_sample(result)
        table.setdefault("time_s", motion.time_s(first_sample + eta.shape[1], result.decimation)[first_sample:])
        for eta_row, force, direction in zip(eta, estimate.force_n[:, first_sample:], "yz", strict=True):
            table[f"{name} relative displacement {direction} m"] = eta_row
            table[f"{name} contact force {direction} N"] = force
    return {"motion": table}
