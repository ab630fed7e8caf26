"""The curves of a diagnosis as tables."""

import numpy as np

from identify.gaps.results import Curve, Gap
from identify.pages.tables import Table


def curves(gap: Gap) -> dict[str, Table]:
    """`bands` (unexplained shares of the acceleration over frequency) and, of every comparison of simulated and
    measured by its number, `comparison_N`; what the diagnosis lacks is left out."""
    tables = {f"comparison_{number}": _comparison(curve) for number, curve in enumerate(gap.curves, start=1)}
    return tables | ({"bands": _bands(gap)} if gap.bands else {})


def _bands(gap: Gap) -> Table:
    names = {
        "low_hz": "from Hz",
        "high_hz": "to Hz",
        "before": "unexplained by the believed rig",
        "after": "unexplained with the likeliest cause",
        "usual": "nineteen of twenty null simulations stay below",
    }
    return {told: np.array([getattr(band, name) for band in gap.bands]) for name, told in names.items()}


def _comparison(curve: Curve) -> Table:
    """Each column with the curve's name, the label of its axis and the unit."""
    table: Table = {curve.x_label: np.array(curve.x)}
    for kind in ("measured", "believed", "corrected"):
        table[f"{curve.name}: {kind}, {curve.y_label}"] = np.array(getattr(curve, kind))
    return table
