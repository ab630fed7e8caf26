"""Plan of a test before it is run: expected intervals, and what would shorten them."""

from identify.plan.planned_test import PlannedTest, planned_test

__all__ = ["PlannedTest", "planned_test"]
