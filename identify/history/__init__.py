"""Changes of one machine over several recordings, tested against chance."""

from identify.history.changes import LEVEL, History, Observation, QuantityHistory, history_of

__all__ = ["LEVEL", "History", "Observation", "QuantityHistory", "history_of"]
