"""Axes that the pictures of a diagnosis share: bars, plain numbers."""

from collections.abc import Sequence
from typing import Any

import numpy as np

LONGEST = 34
"""Letters of a name beside a bar."""
MOST_LABELS = 12


def short(name: str) -> str:
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 1]}…"


def stacked(name: str) -> str:
    """A cause, one effect a line."""
    first, *others = name.split(" + ")
    return "\n".join([short(first), *(short(f"+ {other}") for other in others)])


def lying_bars(figure: Any, names: Sequence[str], sizes: Sequence[float], said: Sequence[str], colours: Any) -> Any:
    """Lying bars, the first on top, with what is said of each at its end."""
    axes = figure.subplots()
    bars = axes.barh(np.arange(len(names)), sizes, height=0.62, color=colours)
    axes.bar_label(bars, said, padding=4)
    axes.set_yticks(np.arange(len(names)), names)
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    return axes
