"""Several recordings of one machine: what of it changed, and whether by more than chance."""

from identify.history.changes import LEVEL, History, Observation, QuantityHistory, history_of

__all__ = ["LEVEL", "History", "Observation", "QuantityHistory", "history_of"]
