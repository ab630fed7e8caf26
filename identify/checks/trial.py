"""A change to a record or to rig.json, and what it leaves."""

from collections.abc import Callable
from dataclasses import dataclass

from identify.checks.findings import Finding


@dataclass(frozen=True)
class Trial:
    """The misfit with the change, the channels that may be believed beside it, and what is said of it if it is best.

    sensors_alone: the kept channels, the force and rig.json are right as they are. A trial with more freedom has an
    allowance above one, by which its misfit counts more.
    """

    misfit: float
    kept: list[int]
    findings: Callable[[], tuple[Finding, ...]]
    sensors_alone: bool = True
    allowance: float = 1.0
