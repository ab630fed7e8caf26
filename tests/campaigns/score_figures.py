"""Figures of the scoreboard: verdicts by truth, power, calibration, parameter errors, p-values of nulls."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import kstwo, norm

from identify.gaps.decision_table import DIFFERENCE_P_VALUE, Verdict
from identify.pages.wording import COVERED
from tests.campaigns.calibration import Reliability, calibrated, null_p_values
from tests.campaigns.scoreboard import ROWS, ScoredCase, detection_limits

FAINTEST, STRONGEST = 0.005, 12.0
"""Where the axis of strengths begins and ends; limits below stand at its begin."""
BLUE, RED, GREY = "#1f5fa8", "#b8323a", "#8a8a8a"
STYLE = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}


def drawn(compared: Sequence[ScoredCase], folder: Path) -> list[Path]:
    """Writes every figure; their paths."""
    with mpl.rc_context(STYLE):
        figures = {
            "verdicts": _verdicts(compared),
            "power": _power(compared),
            "calibration": _calibration(compared),
            "parameters": _parameters(compared),
            "p_values": _p_values(compared),
        }
        paths = []
        for name, figure in figures.items():
            paths.append(folder / f"{name}.png")
            figure.savefig(paths[-1], dpi=140)
    return paths


def _verdicts(compared: Sequence[ScoredCase]) -> Figure:
    """How often each verdict was given, by what is true, with how many of them are right where not all are."""
    verdicts = list(Verdict)
    figure = Figure(figsize=(9.5, 3.6), layout="constrained")
    axes = figure.subplots()
    shares = np.zeros((len(ROWS), len(verdicts)))
    labels = []
    for i, row in enumerate(ROWS):
        own = [c for c in compared if c.row == row]
        refused = sum(c.gap is None for c in own)
        labels.append(f"{row} ({len(own)}{f', {refused} refused' if refused else ''})")
        for j, verdict in enumerate(verdicts):
            given = [c.score.verdict_right for c in own if c.gap and c.gap.verdict == verdict]
            shares[i, j] = len(given) / max(len(own), 1)
            text = f"{len(given)}" if all(given) else f"{len(given)}\n{sum(given) or 'none'} right"
            if given:
                axes.text(j, i, text, ha="center", va="center", color="w" if shares[i, j] > 0.5 else "k")
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    axes.set_xticks(range(len(verdicts)), [v.replace("_", " ") for v in verdicts])
    axes.set_yticks(range(len(ROWS)), labels)
    axes.set(xlabel="verdict", ylabel="true (cases)")
    axes.spines[:].set_visible(False)
    return figure


def _power(compared: Sequence[ScoredCase]) -> Figure:
    """Of every effect of the library, whether it was named, over its strength."""
    named: dict[str, list[tuple[float, bool]]] = {}
    for c in compared:
        for effect, true, is_found in zip(c.truth.effects, c.truths, c.score.found, strict=True):
            if true.library:
                named.setdefault(effect.name, []).append((effect.strength, is_found))
    limits = detection_limits(compared)
    names = sorted(named) or ["no effects"]
    across = min(len(names), 4)
    down = -(-len(names) // across)
    figure = Figure(figsize=(2.4 * across, 1.6 * down + 0.4), layout="constrained")
    grid = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
    for axes in grid.flat[len(names) :]:
        axes.set_visible(False)
    for axes in grid.flat[max(len(names) - across, 0) : len(names)]:
        axes.tick_params(labelbottom=True)
    for axes, name in zip(grid.flat, names, strict=False):
        strength, right = np.array(named.get(name, []), dtype=float).reshape(-1, 2).T
        axes.plot(strength, right, "o", color=BLUE, ms=4, alpha=0.7, clip_on=False)
        if len({*right}) == 2:
            _curve(axes, strength, right)
        if np.isfinite(limit := limits.get(name, np.inf)):
            axes.axvline(max(limit, 1.05 * FAINTEST), color=RED, lw=0.8, ls="--")
        axes.set_title(name.replace("_", " "), fontsize=9)
        axes.set(
            xscale="log",
            xlim=(FAINTEST, STRONGEST),
            ylim=(-0.05, 1.05),
            yticks=(0, 1),
            yticklabels=("missed", "named"),
        )
        axes.set_xticks((0.01, 0.1, 1, 10), ("0.01", "0.1", "1", "10"))
        axes.minorticks_off()
    figure.supxlabel("strength, of the default magnitude (dashed: detection limit, median of the cases)")
    return figure


def _curve(axes: Axes, strength: np.ndarray, right: np.ndarray) -> None:
    """The logistic curve in the logarithm of the strength, its slope held by a prior of 4 +- 2."""

    def cost(p: np.ndarray) -> float:
        probable = np.clip(expit(p[0] + p[1] * np.log(strength)), 1e-9, 1 - 1e-9)
        fit = right * np.log(probable) + (1 - right) * np.log(1 - probable)
        return float(-fit.sum() + ((p[1] - 4) / 2) ** 2 / 2 + (p[0] / 5) ** 2 / 2)

    found = minimize(cost, np.array([0.0, 4.0]), method="Nelder-Mead").x
    grid = np.geomspace(FAINTEST, STRONGEST, 100)
    axes.plot(grid, expit(found[0] + found[1] * np.log(grid)), color=GREY, lw=1)


def _calibration(compared: Sequence[ScoredCase]) -> Figure:
    """How often what was given a probability is right; bins stand side by side, as most probabilities are near one."""
    found = calibrated(compared)
    figure = Figure(figsize=(9.5, 4), layout="constrained")
    panels = {
        "effects of the likeliest set": (found.inclusion, "inclusion probability"),
        "likeliest hypothesis": (found.sets, "probability"),
    }
    for axes, (title, (told, label)) in zip(figure.subplots(1, 2, sharey=True), panels.items(), strict=True):
        if told is None:
            axes.set_title(f"{title}: none", fontsize=9)
            continue
        _reliability(axes, told)
        axes.set_title(f"{title}: Brier score {told.brier:.3f}", fontsize=9)
        axes.set_xlabel(f"{label}; right of so many")
    figure.axes[0].set_ylim(0, 1.02)
    lines, labels = next((axes.get_legend_handles_labels() for axes in figure.axes if axes.lines), ([], []))
    figure.legend(lines, labels, frameon=False, loc="outside lower center", ncols=2)
    return figure


def _reliability(axes: Axes, told: Reliability) -> None:
    at = np.arange(len(told.bins))
    share = np.array([one.right / one.of for one in told.bins])
    ends = np.array([one.interval_95 for one in told.bins])
    said = [one.probability for one in told.bins]
    axes.plot(at, said, "_", color=RED, ms=28, mew=2, label="probability that was given, mean")
    bars = np.maximum(np.abs(ends - share[:, None]).T, 0.0)
    axes.errorbar(at, share, yerr=bars, fmt="o", color=BLUE, capsize=3, clip_on=False, label="share that was right")
    axes.set_xticks(at, [f"{b.low:g} to\n{b.high:g}\n{b.right} of {b.of}" for b in told.bins])
    axes.set_xlim(-0.6, len(at) - 0.4)


def _parameters(compared: Sequence[ScoredCase]) -> Figure:
    errors = [error for c in compared for error in c.score.errors]
    names = sorted({name for name, _ in errors}, reverse=True)
    figure = Figure(figsize=(7.5, 1.6 + 0.22 * max(len(names), 8)), layout="constrained")
    by_name, together = figure.subplots(1, 2, width_ratios=(2, 1))
    values = np.array([z for _, z in errors])
    by_name.axvspan(-COVERED, COVERED, color=GREY, alpha=0.15, lw=0)
    by_name.plot(np.clip(values, -6, 6), [names.index(name) for name, _ in errors], "o", color=BLUE, ms=4, alpha=0.7)
    by_name.set_yticks(range(len(names)), names)
    by_name.set(xlim=(-6.3, 6.3), xlabel="error / standard error (beyond 6 at the edge)")
    ordered = np.sort(np.abs(values))
    grid = np.linspace(0, 6, 200)
    together.plot(grid, 2 * norm.cdf(grid) - 1, color=GREY, lw=0.8, label="Gaussian")
    together.step(
        ordered, np.arange(1, ordered.size + 1) / max(ordered.size, 1), where="post", color=BLUE, label="found"
    )
    together.set(xlim=(0, 6), ylim=(0, 1), xlabel="|error| / standard error", ylabel="share of the parameters")
    together.legend(frameon=False, loc="lower right")
    return figure


def _p_values(compared: Sequence[ScoredCase]) -> Figure:
    """p-values of nulls in their order, with the band in which uniform ones stay in 95 % (Kolmogorov-Smirnov)."""
    ordered = np.sort(null_p_values(compared))
    figure = Figure(figsize=(4.2, 4), layout="constrained")
    axes = figure.subplots()
    ends = np.array([0.0, 1.0])
    axes.plot(ends, ends, color=GREY, lw=0.8)
    if ordered.size:
        reach = float(kstwo.ppf(0.95, ordered.size))
        axes.fill_between(ends, ends - reach, ends + reach, color=GREY, alpha=0.15, lw=0, label="95 % of uniform ones")
        steps = np.arange(ordered.size + 1) / ordered.size
        axes.step([0.0, *ordered, 1.0], [*steps, 1.0], where="post", color=BLUE, label=f"{ordered.size} nulls")
        axes.legend(frameon=False, loc="upper left")
    axes.axvline(DIFFERENCE_P_VALUE, color=RED, lw=0.8, ls="--")
    axes.set(
        xlim=(0, 1), ylim=(0, 1), xlabel=f"p-value (dashed: {DIFFERENCE_P_VALUE:g})", ylabel="share of nulls below it"
    )
    return figure
