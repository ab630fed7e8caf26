"""Figures of the scoreboard: confusion, power, calibration, parameter errors."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import norm

from identify.pages.wording import COVERED
from scenarios.calibration import calibrated
from scenarios.scoreboard import ScoredCase, confusion, detection_limits, parameter_errors

FAINTEST, STRONGEST = 0.005, 12.0
"""Where the axis of strengths begins and ends; limits below stand at its begin."""
BLUE, RED, GREY = "#1f5fa8", "#b8323a", "#8a8a8a"
STYLE = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}


def drawn(compared: Sequence[ScoredCase], folder: Path) -> list[Path]:
    """Writes every figure; their paths."""
    with mpl.rc_context(STYLE):
        figures = {
            "confusion": _confusion(compared),
            "power": _power(compared),
            "calibration": _calibration(compared),
            "parameters": _parameters(compared),
        }
        paths = []
        for name, figure in figures.items():
            paths.append(folder / f"{name}.png")
            figure.savefig(paths[-1], dpi=140)
    return paths


def _confusion(compared: Sequence[ScoredCase]) -> Figure:
    rows, columns, counts = confusion(compared)
    figure = Figure(figsize=(9.5, 9.5), layout="constrained")
    axes = figure.subplots()
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for (row, column), count in np.ndenumerate(counts):
        if count:
            axes.text(
                column, row, str(count), ha="center", va="center", color="w" if shares[row, column] > 0.5 else "k"
            )
    axes.set_xticks(range(len(columns)), [c.replace("_", " ") for c in columns], rotation=60, ha="right")
    axes.set_yticks(
        range(len(rows)), [f"{r.replace('_', ' ')}  ({n})" for r, n in zip(rows, counts.sum(1), strict=True)]
    )
    for border in (len(columns) - 7.5, len(columns) - 6.5):
        axes.axvline(border, color=GREY, lw=0.8)
    for border in (len(columns) - 7.5, len(rows) - 1.5):
        axes.axhline(border, color=GREY, lw=0.8)
    axes.set(xlabel="named", ylabel="true (cases)")
    axes.spines[:].set_visible(False)
    return figure


def _power(compared: Sequence[ScoredCase]) -> Figure:
    singles = [c for c in compared if c.truth.kind == "single"]
    limits = detection_limits(singles)
    names = sorted({c.label for c in singles}) or ["no single effects"]
    across = min(len(names), 4)
    down = -(-len(names) // across)
    figure = Figure(figsize=(2.4 * across, 1.6 * down + 0.4), layout="constrained")
    grid = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
    for axes in grid.flat[len(names) :]:
        axes.set_visible(False)
    for axes in grid.flat[max(len(names) - across, 0) : len(names)]:
        axes.tick_params(labelbottom=True)
    for axes, name in zip(grid.flat, names, strict=False):
        chosen = [c for c in singles if c.label == name]
        strength = np.array([c.effects[0].strength for c in chosen])
        right = np.array([float(c.right) for c in chosen])
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
            yticklabels=("missed", "right"),
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
    """How often the likeliest hypothesis (a cause, nothing, something unknown) is right, beside its probability.

    Bins stand side by side, as most probabilities are near one.
    """
    found = calibrated(compared)
    figure = Figure(figsize=(5.2, 4), layout="constrained")
    axes = figure.subplots()
    at = np.arange(len(found.bins))
    share = np.array([one.right / one.of for one in found.bins])
    ends = np.array([one.interval_95 for one in found.bins]).reshape(-1, 2)
    said = [one.probability for one in found.bins]
    axes.plot(at, said, "_", color=RED, ms=28, mew=2, label="probability that was given, mean")
    bars = np.maximum(np.abs(ends - share[:, None]).T, 0.0)
    axes.errorbar(at, share, yerr=bars, fmt="o", color=BLUE, capsize=3, clip_on=False, label="share that was right")
    axes.set_xticks(at, [f"{b.low:g} to {b.high:g}\n{b.right} of {b.of}" for b in found.bins])
    axes.set_title(f"Brier score {found.brier:.3f}; of the rule before {found.brier_before:.3f}", fontsize=9)
    axes.set(xlim=(-0.6, len(at) - 0.4), ylim=(0, 1.02), xlabel="probability of the likeliest; right of so many")
    figure.legend(frameon=False, loc="outside lower center", ncols=2)
    return figure


def _parameters(compared: Sequence[ScoredCase]) -> Figure:
    errors = parameter_errors(compared)
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
