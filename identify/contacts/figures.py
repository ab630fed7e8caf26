"""Figures of an identification, and the tables of their curves; no estimate is computed here."""

from collections.abc import Callable, Mapping, Sequence
from itertools import compress
from typing import Any

import numpy as np
from scipy.signal import welch

from identify.contacts.identification import Identification
from identify.contacts.paper_methods import results_or_notes_by_name
from identify.contacts.results import ContactReport, Segment
from identify.linear.joined import ContactGroup
from identify.linear.modal import equivalent_force_n, receptance
from identify.pages.style import BLUE, GREEN, GREY, RED, Picture, picture
from identify.pages.wording import COVERED, number

References = Mapping[str, tuple[float, float]]
"""Reference values by contact: clearance (m) and stiffness (N/m), drawn as dashed lines."""
OUTPUT_SAMPLES = 1 << 18
"""Samples of the figure of the output with and without the contacts."""


def contact_figures(
    result: Identification, references: References, reference_name: str, notes: list[str] | None = None
) -> dict[str, Picture]:
    """Figures of the paper (4 to 9, 12 to 17) for the main modal equation, and the separated contact forces, by name.

    `reference_name` names them: the true values where they are known, else those of rig.json. A figure that cannot be
    drawn is left out, and a note is added.
    """

    def drawn_picture(draw: Callable[..., None]) -> Picture:
        return picture(lambda figure: draw(figure, result, references, reference_name))

    missing_names = {
        *(() if result.methods.main_nifo_results else _NIFO_FIGURES),
        *(() if result.methods.main_surfaces else _SURFACE_FIGURES),
    }
    figures = {name: draw for name, draw in _FIGURES.items() if name not in missing_names}
    return results_or_notes_by_name([] if notes is None else notes, "the figure", figures, drawn_picture)


def segments_figure(report: ContactReport, segments: Sequence[Segment]) -> Picture:
    """Figure of each contact's estimates by the segments of a long record, and pooled, with 95 % intervals."""

    def draw(figure: Any) -> None:
        axes_rows = figure.subplots(2, len(report.contacts), squeeze=False, sharex=True)
        for axes_column, pooled in zip(axes_rows.T, report.contacts, strict=True):
            pairs = [(s, contact) for s in segments for contact in s.report.contacts if contact.name == pooled.name]
            middle_times_s = [(segment.start_s + segment.end_s) / 2 for segment, _ in pairs]
            quantities = (("clearance_m", 1e3), ("stiffness_n_per_m", 1.0))
            for axes, (quantity, scale) in zip(axes_column, quantities, strict=True):
                estimates, pooled_estimate = [getattr(c, quantity) for _, c in pairs], getattr(pooled, quantity)
                band = scale * (pooled_estimate.value + COVERED * pooled_estimate.standard_error * np.array([-1, 1]))
                half_widths = [COVERED * scale * estimate.standard_error for estimate in estimates]
                scaled_values = [scale * estimate.value for estimate in estimates]
                bar_style = {"fmt": "none", "color": GREY, "lw": 0.8, "alpha": 0.5, "label": "their 95 %"}
                axes.errorbar(middle_times_s, scaled_values, half_widths, **bar_style)
                axes.plot(middle_times_s, scaled_values, "k.", ms=3, label="segments")
                axes.axhline(scale * pooled_estimate.value, color=BLUE, lw=1.2, zorder=3, label="all together")
                axes.axhspan(*band, color=BLUE, alpha=0.2, lw=0, label="95 % of all together")
            axes_column[0].set_title(pooled.name)
            axes_column[1].set_xlabel("time, s")
        axes_rows[0, 0].set_ylabel("clearance, mm")
        axes_rows[1, 0].set_ylabel("contact stiffness, N/m")
        _legend_outside(figure, axes_rows[0, 0], "upper")

    return picture(draw)


def _draw_modal_coordinate(figure: Any, result: Identification, _references: References, _reference_name: str) -> None:
    """Figures 4 and 12: main modal coordinate as measured, and as it would be without contact."""
    equation, rate_hz, motion = result.surface.equation, result.motion.sample_rate_hz, result.motion
    measured_q = equation.displacement[:OUTPUT_SAMPLES]
    low_hz, high_hz = max(result.weak_nifo.frequency_hz[0], motion.trusted_hz[0]), result.weak_nifo.frequency_hz[-1]
    force_n = equivalent_force_n(result.rig, equation, motion.forces_n[:, :OUTPUT_SAMPLES])
    force_spectrum = np.fft.rfft(equation.shape_at_force * force_n, 2 * measured_q.size)
    line_hz = np.fft.rfftfreq(2 * measured_q.size, 1 / rate_hz)
    frf = np.where(line_hz >= low_hz, receptance(equation.frequency_hz, equation.damping_ratio, line_hz), 0.0)
    contactless_q, time_s = np.fft.irfft(force_spectrum * frf)[: measured_q.size], motion.time_s(measured_q.size)
    excerpt_start, excerpt_s = int(0.4 * measured_q.size), min(3.0, 15 / max(equation.frequency_hz, 5.0))
    excerpt = slice(excerpt_start, excerpt_start + int(excerpt_s * rate_hz))
    time_axes, spectrum_axes = figure.subplots(2, 1)
    for signal, colour, label in (
        (contactless_q, GREY, "without contact"),
        (measured_q, BLUE, "as measured, with contact"),
    ):
        time_axes.plot(time_s[excerpt], 1e3 * signal[excerpt], color=colour, lw=1.1, label=label)
        frequency_hz, density = welch(signal, rate_hz, nperseg=min(signal.size, int(4 * rate_hz)))
        is_in_band = (frequency_hz >= low_hz) & (frequency_hz <= 2 * high_hz)
        spectrum_axes.semilogy(frequency_hz[is_in_band], density[is_in_band], color=colour, lw=1.1)
    time_axes.set(xlabel="time, s", ylabel=f"q of {equation.name},\n1e-3 √kg m")
    time_axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    # as measured: without contact little moves above the force's band
    least_density = float(density[is_in_band].min())
    spectrum_axes.set(xlabel="frequency, Hz", ylabel="PSD of q, kg m²/Hz", ylim=(0.1 * least_density, None))
    figure.suptitle("Output with and without the contacts")


def _draw_surface(figure: Any, result: Identification, references: References, reference_name: str) -> None:
    """Figures 5 and 13: restoring force over two coordinates, averaged in cells."""
    surface = result.surface
    every_nth = slice(None, None, surface.decimation)
    first_group, *other_groups = result.contact_groups
    eta_mm = 1e3 * result.eta_m[first_group.contact_indices[0]][every_nth]
    if other_groups:
        second_axis = 1e3 * result.eta_m[other_groups[0].contact_indices[0]][every_nth]
        second_label = f"η of {other_groups[0].joined_contact.name}, mm"
    else:
        second_axis = surface.equation.velocity[every_nth] * surface.equation.shape_at_contacts[0]
        second_label = "velocity, m/s"
    count = min(eta_mm.size, second_axis.size, surface.measured_modal_force.size)
    axes, modal_force = figure.subplots(), surface.measured_modal_force[:count]
    cells = axes.hexbin(eta_mm[:count], second_axis[:count], C=modal_force, gridsize=70, cmap="RdBu_r", mincnt=3)
    figure.colorbar(cells, label="restoring force, N/√kg")
    axes.set(xlabel=f"η of {first_group.joined_contact.name}, mm", ylabel=second_label)
    for k, group in enumerate(result.contact_groups[:2]):
        _mark_stops(axes, result, group, references, reference_name, horizontal=k > 0, labelled=k == 0)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    figure.suptitle(f"Restoring force surface, modal equation {surface.equation.name}")


def _draw_restoring_force_section(
    figure: Any, result: Identification, references: References, reference_name: str
) -> None:
    """Figures 6 and 14: restoring force less the other contacts' shares, over the relative displacement of each
    pair of places."""
    surface = result.surface
    axes_row = figure.subplots(1, len(result.contact_groups), squeeze=False, sharey=True)[0]
    unexplained_force = surface.measured_modal_force - surface.fitted_modal_force
    for axes, group in zip(axes_row, result.contact_groups, strict=True):
        first_contact, contact_indices = group.contact_indices[0], list(group.contact_indices)
        shape_at_contact = surface.equation.shape_at_contacts[first_contact] or 1.0
        eta_m = result.eta_m[first_contact][:: surface.decimation]
        sample_count = min(eta_m.size, unexplained_force.size)
        eta_mm, drawn_samples = 1e3 * eta_m[:sample_count], slice(None, None, max(1, sample_count // 6000))
        fitted_n = surface.fitted_contact_parts[contact_indices].sum(axis=0)[:sample_count] / shape_at_contact
        force_n = unexplained_force[:sample_count] / shape_at_contact + fitted_n
        ascending = np.argsort(eta_mm)
        axes.plot(eta_mm[ascending], fitted_n[ascending], color=RED, lw=2.5, label="dead zone as fitted")
        axes.plot(eta_mm[drawn_samples], force_n[drawn_samples], ".", ms=1.5, color=BLUE, alpha=0.5, label="measured")
        _mark_stops(axes, result, group, references, reference_name)
        axes.set(xlabel=f"η of {group.joined_contact.name}, mm", title=group.joined_contact.name)
    axes_row[0].set_ylabel("contact force, N")
    _legend_outside(figure, axes_row[0], "lower", markerscale=6)
    figure.suptitle(f"Section of the restoring force, modal equation {surface.equation.name}")


def _draw_separated_forces(figure: Any, result: Identification, references: References, reference_name: str) -> None:
    """Contact forces, separated without a law, over their relative displacements, with the estimated laws."""
    axes_row = figure.subplots(1, len(result.contact_groups), squeeze=False, sharey=True)[0]
    for axes, group, separated_n in zip(axes_row, result.contact_groups, result.separated_n, strict=True):
        eta_m = result.eta_m[group.contact_indices[0]][:: result.decimation]
        force_n = separated_n[: eta_m.size]
        axes.plot(1e3 * eta_m, force_n, ".", ms=4, color=GREY, alpha=0.4, label="measured contact force")
        grid_m, law_forces = np.linspace(eta_m.min(), eta_m.max(), 400), []
        for sign, contact_index in zip(group.signs, group.contact_indices, strict=True):
            if estimate := result.outcomes.estimates.get(result.rig.contacts[contact_index].name):
                law_forces.append(sign * estimate.force_n(sign * grid_m, np.zeros_like(grid_m)))
        if law_forces:
            axes.plot(1e3 * grid_m, np.sum(law_forces, axis=0), color=BLUE, lw=1.2, label="law found (without damping)")
        _mark_stops(axes, result, group, references, reference_name)
        axes.set(xlabel=f"η of {group.joined_contact.name}, mm", title=group.joined_contact.name)
    axes_row[0].set_ylabel("contact force, N")
    _legend_outside(figure, axes_row[0], "upper", markerscale=2)


def _draw_histogram(figure: Any, result: Identification, references: References, reference_name: str) -> None:
    """Figure 15: relative displacements over time and their histograms, with the identified stops."""
    rate_hz, motion = result.motion.sample_rate_hz, result.motion
    axes_rows = figure.subplots(len(result.contact_groups), 2, squeeze=False, width_ratios=(3, 1), sharey="row")
    for (time_axes, density_axes), group in zip(axes_rows, result.contact_groups, strict=True):
        eta_mm = 1e3 * result.eta_m[group.contact_indices[0]]
        excerpt_start = int(0.4 * eta_mm.size)
        excerpt = slice(excerpt_start, excerpt_start + int(min(4.0, 0.3 * eta_mm.size / rate_hz) * rate_hz))
        time_axes.plot(motion.time_s(eta_mm.size)[excerpt], eta_mm[excerpt], color=BLUE, lw=0.8, label="η")
        histogram_style = {"bins": 120, "orientation": "horizontal", "color": BLUE, "alpha": 0.6, "density": True}
        density_axes.hist(eta_mm[motion.excited_from :], **histogram_style)
        for panel in (time_axes, density_axes):
            _mark_stops(panel, result, group, references, reference_name, horizontal=True)
        time_axes.set_ylabel(f"η of {group.joined_contact.name}, mm")
    axes_rows[-1][0].set_xlabel("time, s")
    axes_rows[-1][1].set_xlabel("histogram, 1/mm")
    _legend_outside(figure, axes_rows[0][0], "upper")


def _draw_stiffness(figure: Any, result: Identification, references: References, reference_name: str) -> None:
    """Figures 7, 16 and 17: contact stiffness over frequency, and its deviation."""
    weak_nifo, paper_nifo = result.weak_nifo, result.paper_nifo
    if not weak_nifo.contact_indices:
        figure.text(0.5, 0.5, f"modal equation {weak_nifo.equation.name} tells no contact's stiffness", ha="center")
        return
    axes_grid = figure.subplots(2, len(weak_nifo.contact_indices), squeeze=False, sharex=True)
    for column, (upper, lower) in enumerate(axes_grid.T):
        contact = result.rig.contacts[weak_nifo.contact_indices[column]]
        mean_n_per_m = weak_nifo.mean_n_per_m[column]
        reference_n_per_m = references.get(contact.name, (np.nan, mean_n_per_m))[1]
        for nifo, colour, label in ((paper_nifo, GREY, "the paper's form"), (weak_nifo, BLUE, "weak form")):
            stiffness_n_per_m = nifo.stiffness_n_per_m[column]
            upper.plot(nifo.frequency_hz, stiffness_n_per_m.real, color=colour, lw=1.0, label=label)
            deviation_percent = 100 * np.abs(stiffness_n_per_m / reference_n_per_m - 1)
            lower.semilogy(nifo.frequency_hz, np.maximum(deviation_percent, 1e-6), color=colour, lw=1.0)
        upper.axhline(mean_n_per_m, color=RED, lw=1.0, label=f"spectral mean {number(mean_n_per_m, 5)} N/m")
        if contact.name in references:
            upper.axhline(reference_n_per_m, color="k", ls=":", lw=1.0, label=reference_name)
        low_n_per_m, high_n_per_m = np.quantile(weak_nifo.stiffness_n_per_m[column].real, [0.02, 0.98])
        margin_n_per_m = max(high_n_per_m - low_n_per_m, 0.02 * abs(mean_n_per_m))
        upper.set(ylim=(low_n_per_m - margin_n_per_m, high_n_per_m + margin_n_per_m), title=contact.name)
        lower.set(xlabel="frequency, Hz")
        upper.legend(fontsize=7, loc="lower center", bbox_to_anchor=(0.5, 1.12), ncols=2)
    axes_grid[0][0].set_ylabel("Re k, N/m")
    axes_grid[1][0].set_ylabel("|k / reference - 1|, %")
    figure.suptitle(f"Contact stiffness, modal equation {weak_nifo.equation.name}")


def _draw_frf(figure: Any, result: Identification, _references: References, _reference_name: str) -> None:
    """Figures 8 and 9: FRF of the linear mode alone at the force's place, H phi_F^2, and its phase."""
    magnitude_axes, accelerance_axes, phase_axes = figure.subplots(3, 1, sharex=True)
    weak_nifo, paper_nifo = result.weak_nifo, result.paper_nifo
    for frf, frequency_hz, colour, style, label in (
        (paper_nifo.frf, paper_nifo.frequency_hz, GREY, "-", "NIFO, the paper's form"),
        (weak_nifo.frf, weak_nifo.frequency_hz, BLUE, "-", "NIFO, weak form"),
        (weak_nifo.nominal_frf(), weak_nifo.frequency_hz, "k", ":", "mode of rig.json"),
    ):
        receptance_m_per_n = weak_nifo.equation.shape_at_force**2 * np.abs(frf)
        magnitude_axes.semilogy(frequency_hz, receptance_m_per_n, color=colour, ls=style, lw=1.2, label=label)
        accelerance = (2 * np.pi * frequency_hz) ** 2 * receptance_m_per_n
        accelerance_axes.semilogy(frequency_hz, accelerance, color=colour, ls=style, lw=1.2)
        phase_axes.plot(frequency_hz, np.degrees(np.angle(1j * frf)) - 90, color=colour, ls=style, lw=1.2)
    magnitude_axes.set_ylabel("receptance,\nm/N")
    accelerance_axes.set_ylabel("accelerance,\nm/s²/N")
    magnitude_axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    phase_axes.set(xlabel="frequency, Hz", ylabel="phase,\ndegrees", ylim=(-200, 20), yticks=(-180, -90, 0))
    figure.suptitle(f"Linear FRF of modal equation {weak_nifo.equation.name}")


def _legend_outside(figure: Any, axes: Any, edge: str, **style: Any) -> None:
    """Draws the legend of some axes at an edge of the figure."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc=f"outside {edge} center", ncols=4, **style)


def _mark_stops(
    axes: Any,
    result: Identification,
    group: ContactGroup,
    references: References,
    reference_name: str,
    *,
    horizontal: bool = False,
    labelled: bool = True,
) -> None:
    """Draws the identified stops of a pair of places, and its reference values."""
    draw_line, solid_label_once = axes.axhline if horizontal else axes.axvline, iter(["identified stops"] * labelled)
    dotted_label_once = iter([f"stops, {reference_name}"] * labelled)
    for contact_index, sign in zip(group.contact_indices, group.signs, strict=True):
        stop, name = result.stops[contact_index], result.rig.contacts[contact_index].name
        if stop is not None:
            for position_m in compress((-stop.lower_m, stop.upper_m), stop.touched):
                draw_line(1e3 * sign * position_m, color=GREEN, lw=3.0, label=next(solid_label_once, None))
        for side in result.rig.contact(name).law.sides if name in references else ():
            draw_line(1e3 * side * references[name][0], color="k", ls=":", lw=1.2, label=next(dotted_label_once, None))


_FIGURES = {
    "outputs": _draw_modal_coordinate,
    "surface": _draw_surface,
    "section": _draw_restoring_force_section,
    "separated": _draw_separated_forces,
    "histogram": _draw_histogram,
    "stiffness": _draw_stiffness,
    "frf": _draw_frf,
}
_NIFO_FIGURES = ("outputs", "stiffness", "frf")
"""Figures that need NIFO, and so a force."""
_SURFACE_FIGURES = ("outputs", "surface", "section")
"""Figures that need the main equation's surface."""
