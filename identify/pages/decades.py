"""Logarithmic axes."""

from typing import Any


def plain_decades(axis: Any) -> None:
    """Plain numbers along a logarithmic axis; between the powers of ten only where it spans few."""
    low, high = sorted(axis.get_view_interval())
    few = high < 20 * low
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_formatter(lambda value, _: f"{value:g}" if few and f"{value:e}"[0] in "25" else "")
