"""Changes of one machine over several recordings, tested against chance."""

from identify.history.changes import SIGNIFICANCE_LEVEL, History, Observation, QuantityHistory, history_of

__all__ = ["SIGNIFICANCE_LEVEL", "History", "Observation", "QuantityHistory", "history_of"]
