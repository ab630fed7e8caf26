"""Plan of a test before it is run: expected intervals, and what would shorten them."""

from identify.planning.planned_test import PlannedTest, planned_test

__all__ = ["PlannedTest", "planned_test"]
