"""Prediction from measured states as the judge of a correction."""
