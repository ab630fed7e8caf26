"""Hypotheses of one record judged on another, and the verdict that follows."""
