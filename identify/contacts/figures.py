"""The figures of an identification. Takes results, computes no estimate."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.signal import welch

from identify.contacts.identification import Identification
from identify.contacts.paper_methods import attempted
from identify.contacts.results import ContactReport, Segment
from identify.linear.joined import Joined
from identify.linear.modal import pushing_force, receptance
from identify.pages.picture import Picture
from identify.pages.style import BLUE, GREEN, GREY, RED, picture
from identify.pages.wording import COVERED, number

Marks = Mapping[str, tuple[float, float]]
"""Reference values by contact: clearance (m) and stiffness (N/m), drawn as dashed lines."""


LONGEST = 1 << 18
"""So many samples show the output with and without the contacts."""


def drawn(found: Identification, marks: Marks, marks_name: str, notes: list[str] | None = None) -> dict[str, Picture]:
    """The figures of the paper (4 to 9, 12 to 17) for the main modal equation, and the separated contact forces.

    marks are drawn as what `marks_name` says they are: the true values where they are known, else those of rig.json. A
    figure that cannot be drawn is left out, and a note is added.
    """

    def one(draw: Callable[..., None]) -> Picture:
        return picture(lambda figure: draw(figure, found, marks, marks_name))

    missing = {*(() if found.methods.forms else _OF_NIFO), *(() if found.methods.main_surfaces else _OF_SURFACE)}
    figures = {name: draw for name, draw in _FIGURES.items() if name not in missing}
    return attempted([] if notes is None else notes, "the figure", figures, one)


def segments_drawn(report: ContactReport, parts: Sequence[Segment]) -> Picture:
    """Figure of each contact's estimate by segment of a long record with its 95 % interval, and of all together."""

    def draw(figure: Any) -> None:
        rows = figure.subplots(2, len(report.contacts), squeeze=False, sharex=True)
        for column, whole in zip(rows.T, report.contacts, strict=True):
            found = [(p, c) for p in parts for c in p.report.contacts if c.name == whole.name]
            middle_s = [(p.start_s + p.end_s) / 2 for p, _ in found]
            for axes, what, scale in zip(column, ("clearance_m", "stiffness_n_per_m"), (1e3, 1.0), strict=True):
                each, mean = [getattr(c, what) for _, c in found], getattr(whole, what)
                ends = scale * (mean.value + COVERED * mean.standard_error * np.array([-1, 1]))
                errors = [COVERED * scale * e.standard_error for e in each]
                values = [scale * e.value for e in each]
                axes.errorbar(middle_s, values, errors, fmt="none", color=GREY, lw=0.8, alpha=0.5, label="their 95 %")
                axes.plot(middle_s, values, "k.", ms=3, label="segments")
                axes.axhline(scale * mean.value, color=BLUE, lw=1.2, zorder=3, label="all together")
                axes.axhspan(*ends, color=BLUE, alpha=0.2, lw=0, label="95 % of all together")
            column[0].set_title(whole.name)
            column[1].set_xlabel("time, s")
        rows[0, 0].set_ylabel("clearance, mm")
        rows[1, 0].set_ylabel("contact stiffness, N/m")
        handles, labels = rows[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4)

    return picture(draw)


def _outputs(figure: Any, found: Identification, _marks: Marks, _marks_name: str) -> None:
    """Figures 4 and 12: the main modal coordinate as measured, and as it would be without contact."""
    equation, rate = found.surface.equation, found.motion.sample_rate_hz
    measured = equation.displacement[:LONGEST]
    low_hz = max(found.weak.frequency_hz[0], found.motion.trusted_hz[0])
    exciting_n = pushing_force(found.rig, equation, found.motion.forces_n[:, :LONGEST])
    spectrum = np.fft.rfft(equation.shape_at_force * exciting_n, 2 * measured.size)
    at_hz = np.fft.rfftfreq(2 * measured.size, 1 / rate)
    frf = np.where(at_hz >= low_hz, receptance(equation.frequency_hz, equation.damping_ratio, at_hz), 0.0)
    free = np.fft.irfft(spectrum * frf)[: measured.size]
    time = found.motion.time_s(measured.size)
    shown_s = min(3.0, 15 / max(equation.frequency_hz, 5.0))
    shown = slice(int(0.4 * measured.size), int(0.4 * measured.size) + int(shown_s * rate))
    upper, lower = figure.subplots(2, 1)
    for signal, colour, label in ((free, GREY, "without contact"), (measured, BLUE, "as measured, with contact")):
        upper.plot(time[shown], 1e3 * signal[shown], color=colour, lw=1.1, label=label)
        frequency, density = welch(signal, rate, nperseg=min(signal.size, int(4 * rate)))
        band = (frequency >= low_hz) & (frequency <= 2 * found.weak.frequency_hz[-1])
        lower.semilogy(frequency[band], density[band], color=colour, lw=1.1)
    upper.set(xlabel="time, s", ylabel=f"q of {equation.name},\n1e-3 √kg m")
    upper.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    least = float(density[band].min())  # as measured: without contact hardly anything moves above the force's band
    lower.set(xlabel="frequency, Hz", ylabel="PSD of q, kg m²/Hz", ylim=(0.1 * least, None))
    figure.suptitle("Output with and without the contacts")


def _surface(figure: Any, found: Identification, marks: Marks, marks_name: str) -> None:
    """Figures 5 and 13: the restoring force over two coordinates, averaged in cells."""
    surface = found.surface
    few = slice(None, None, surface.factor)
    one, *others = found.same_place
    first = found.eta_m[one.members[0]][few]
    if others:
        second, label = 1e3 * found.eta_m[others[0].members[0]][few], f"η of {others[0].contact.name}, mm"
    else:
        second, label = surface.equation.velocity[few] * surface.equation.shape_at_contacts[0], "velocity, m/s"
    count = min(first.size, second.size, surface.measured.size)
    axes = figure.subplots()
    cells = axes.hexbin(
        1e3 * first[:count], second[:count], C=surface.measured[:count], gridsize=70, cmap="RdBu_r", mincnt=3
    )
    figure.colorbar(cells, label="restoring force, N/√kg")
    axes.set(xlabel=f"η of {one.contact.name}, mm", ylabel=label)
    for k, place in enumerate(found.same_place[:2]):
        _mark_stops(axes, found, place, marks, marks_name, across=k > 0, named=k == 0)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    figure.suptitle(f"Restoring force surface, modal equation {surface.equation.name}")


def _section(figure: Any, found: Identification, marks: Marks, marks_name: str) -> None:
    """Figures 6 and 14: what is left of the restoring force for one contact, over its relative displacement."""
    surface = found.surface
    few = slice(None, None, surface.factor)
    axes_row = figure.subplots(1, len(found.same_place), squeeze=False, sharey=True)[0]
    left = surface.measured - surface.fitted
    for axes, place in zip(axes_row, found.same_place, strict=True):
        first, members = place.members[0], list(place.members)
        scale = surface.equation.shape_at_contacts[first] or 1.0
        eta = found.eta_m[first][few]
        count = min(eta.size, left.size)
        thin = slice(None, None, max(1, count // 6000))
        fitted = surface.contact_share[members].sum(axis=0)[:count] / scale
        force = left[:count] / scale + fitted
        order = np.argsort(eta[:count])
        axes.plot(1e3 * eta[order], fitted[order], color=RED, lw=2.5, label="dead zone as fitted")
        axes.plot(1e3 * eta[:count][thin], force[thin], ".", ms=1.5, color=BLUE, alpha=0.5, label="measured")
        _mark_stops(axes, found, place, marks, marks_name)
        axes.set(xlabel=f"η of {place.contact.name}, mm", title=place.contact.name)
    axes_row[0].set_ylabel("contact force, N")
    handles, labels = axes_row[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, markerscale=6)
    figure.suptitle(f"Section of the restoring force, modal equation {surface.equation.name}")


def _separated(figure: Any, found: Identification, marks: Marks, marks_name: str) -> None:
    """Each contact force by itself, separated without a law, over its own relative displacement; the law found."""
    axes_row = figure.subplots(1, len(found.same_place), squeeze=False, sharey=True)[0]
    few = slice(None, None, found.factor)
    for axes, place, separated in zip(axes_row, found.same_place, found.separated_n, strict=True):
        eta = found.eta_m[place.members[0]][few]
        force = separated[: eta.size]
        axes.plot(1e3 * eta, force, ".", ms=1.2, color=BLUE, alpha=0.4, label="separated, no law assumed")
        span = np.linspace(eta.min(), eta.max(), 400)
        laws = [
            s * estimate.force_n(s * span, np.zeros_like(span))
            for s, j in zip(place.signs, place.members, strict=True)
            for name, estimate in found.outcomes.estimates.items()
            if name == found.rig.contacts[j].name
        ]
        if laws:
            axes.plot(1e3 * span, np.sum(laws, axis=0), color=RED, lw=1.2, label="law found (without damping)")
        _mark_stops(axes, found, place, marks, marks_name)
        axes.set(xlabel=f"η of {place.contact.name}, mm", title=place.contact.name)
    axes_row[0].set_ylabel("contact force, N")
    handles, labels = axes_row[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, markerscale=6)


def _histogram(figure: Any, found: Identification, marks: Marks, marks_name: str) -> None:
    """Figure 15: the relative displacement and how often it occurs, with the identified stops."""
    rate = found.motion.sample_rate_hz
    axes = figure.subplots(len(found.same_place), 2, squeeze=False, width_ratios=(3, 1), sharey="row")
    for j, place in enumerate(found.same_place):
        eta = found.eta_m[place.members[0]]
        start = int(0.4 * eta.size)
        shown = slice(start, start + int(min(4.0, 0.3 * eta.size / rate) * rate))
        axes[j][0].plot(found.motion.time_s(eta.size)[shown], 1e3 * eta[shown], color=BLUE, lw=0.8, label="η")
        axes[j][1].hist(
            1e3 * eta[found.motion.excited_from :],
            bins=120,
            orientation="horizontal",
            color=BLUE,
            alpha=0.6,
            density=True,
        )
        for panel in axes[j]:
            _mark_stops(panel, found, place, marks, marks_name, across=True)
        axes[j][0].set_ylabel(f"η of {place.contact.name}, mm")
    axes[-1][0].set_xlabel("time, s")
    axes[-1][1].set_xlabel("histogram, 1/mm")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4)


def _stiffness(figure: Any, found: Identification, marks: Marks, marks_name: str) -> None:
    """Figures 7, 16 and 17: the contact stiffness over frequency, and its deviation."""
    count = len(found.weak.contacts)
    if not count:
        figure.text(0.5, 0.5, f"modal equation {found.weak.equation.name} tells no contact's stiffness", ha="center")
        return
    axes = figure.subplots(2, count, squeeze=False, sharex=True)
    for i, j in enumerate(found.weak.contacts):
        contact = found.rig.contacts[j]
        mean = found.weak.mean_n_per_m[i]
        reference = marks.get(contact.name, (np.nan, mean))[1]
        for result, colour, label in ((found.paper, GREY, "the paper's form"), (found.weak, BLUE, "weak form")):
            values = result.stiffness_n_per_m[i].real
            axes[0][i].plot(result.frequency_hz, values, color=colour, lw=1.0, label=label)
            deviation = 100 * np.abs(result.stiffness_n_per_m[i] / reference - 1)
            axes[1][i].semilogy(result.frequency_hz, np.maximum(deviation, 1e-6), color=colour, lw=1.0)
        axes[0][i].axhline(mean, color=RED, lw=1.0, label=f"spectral mean {number(mean, 5)} N/m")
        if contact.name in marks:
            axes[0][i].axhline(reference, color="k", ls=":", lw=1.0, label=marks_name)
        limits = np.quantile(found.weak.stiffness_n_per_m[i].real, [0.02, 0.98])
        room = max(np.ptp(limits), 0.02 * abs(mean))
        axes[0][i].set(ylim=(limits[0] - room, limits[1] + room), title=contact.name)
        axes[1][i].set(xlabel="frequency, Hz")
        axes[0][i].legend(fontsize=7, loc="lower center", bbox_to_anchor=(0.5, 1.12), ncols=2)
    axes[0][0].set_ylabel("Re k, N/m")
    axes[1][0].set_ylabel("|k / reference - 1|, %")
    figure.suptitle(f"Contact stiffness, modal equation {found.weak.equation.name}")


def _frf(figure: Any, found: Identification, _marks: Marks, _marks_name: str) -> None:
    """Figures 8 and 9: what the linear mode alone adds to the FRF at the force's place, H phi_F^2, and its phase."""
    upper, middle, lower = figure.subplots(3, 1, sharex=True)
    weak, paper = found.weak, found.paper
    per_kg = weak.equation.shape_at_force**2
    for frf, frequency, colour, style, label in (
        (paper.frf, paper.frequency_hz, GREY, "-", "NIFO, the paper's form"),
        (weak.frf, weak.frequency_hz, BLUE, "-", "NIFO, weak form"),
        (weak.true_frf(), weak.frequency_hz, "k", ":", "mode of rig.json"),
    ):
        receptance_m_per_n = per_kg * np.abs(frf)
        upper.semilogy(frequency, receptance_m_per_n, color=colour, ls=style, lw=1.2, label=label)
        middle.semilogy(frequency, (2 * np.pi * frequency) ** 2 * receptance_m_per_n, color=colour, ls=style, lw=1.2)
        lower.plot(frequency, np.degrees(np.angle(1j * frf)) - 90, color=colour, ls=style, lw=1.2)
    upper.set_ylabel("receptance,\nm/N")
    middle.set_ylabel("accelerance,\nm/s²/N")
    upper.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    lower.set(xlabel="frequency, Hz", ylabel="phase,\ndegrees", ylim=(-200, 20), yticks=(-180, -90, 0))
    figure.suptitle(f"Linear FRF of modal equation {weak.equation.name}")


def _mark_stops(
    axes: Any,
    found: Identification,
    place: Joined,
    marks: Marks,
    marks_name: str,
    *,
    across: bool = False,
    named: bool = True,
) -> None:
    line, labels = axes.axhline if across else axes.axvline, iter(["identified stops"] * named)
    of_marks = iter([f"stops, {marks_name}"] * named)
    for j, sign in zip(place.members, place.signs, strict=True):
        stop, name = found.stops[j], found.rig.contacts[j].name
        if stop is not None:
            for at in (-stop.lower_m, stop.upper_m):
                line(1e3 * sign * at, color=GREEN, lw=1.2, label=next(labels, None))
        for at in (-1, 1) if name in marks else ():
            line(1e3 * at * marks[name][0], color="k", ls=":", lw=1.2, label=next(of_marks, None))


_FIGURES = {
    "outputs": _outputs,
    "surface": _surface,
    "section": _section,
    "separated": _separated,
    "histogram": _histogram,
    "stiffness": _stiffness,
    "frf": _frf,
}
_OF_NIFO = ("outputs", "stiffness", "frf")
"""Figures that need NIFO, and so a force."""
_OF_SURFACE = ("outputs", "surface", "section")
"""Figures that need the main equation's surface."""
