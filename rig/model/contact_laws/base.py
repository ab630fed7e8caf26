"""Base of every contact law: clearances, a force, its derivatives and the energy that it stores."""

from typing import TYPE_CHECKING, Any, ClassVar

import msgspec
import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.model.contact_laws.elementary import beyond, contributes

Values = Float[np.ndarray, "*shape"]
Signal = float | Values
CLEARANCES = ("lower_clearance_m", "upper_clearance_m")
"""Fields of the stops' clearances: infinite, in JSON null, where there is no stop on that side."""


class ContactLaw(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A force f(eta, eta', t) against the relative displacement eta: -f on the body that eta is counted for.

    A `spatial` law acts in both directions: eta, its rate and the force have the components y and z as their first
    axis, and derivatives the components of the force, then those of eta.

    `formula` is the law: the only place that evaluates it, for arrays, for the compiled loop of the modal plant and for
    Exudyn's connectors. It uses + - * /, `rig.model.contact_laws.elementary`, and conditions on the law's own numbers
    alone.
    """

    signed_fields: ClassVar[tuple[str, ...]] = ()
    """Fields that may be negative."""
    piecewise_linear: ClassVar[bool] = False
    """True of laws that clearances, stiffness and damping describe, unless further fields say otherwise."""
    has_stops: ClassVar[bool] = True
    """False of a spring, which has no clearances."""
    spatial: ClassVar[bool] = False
    """True of laws of both directions."""

    if TYPE_CHECKING:  # fields or properties of every law

        @property
        def lower_clearance_m(self) -> float: ...
        @property
        def upper_clearance_m(self) -> float: ...
        @property
        def stiffness_n_per_m(self) -> float: ...
        @property
        def damping_n_s_per_m(self) -> float: ...
        @property
        def wear_m_per_s(self) -> float: ...

    def __post_init__(self) -> None:
        for field in self.__struct_fields__:
            value, may_be_inf = getattr(self, field), field in CLEARANCES
            if not ((np.isfinite(value) or (may_be_inf and value > 0)) and (value >= 0 or field in self.signed_fields)):
                null_advice = ", or null where there is no stop on that side" if may_be_inf else ""
                raise RigError(f"contact law: {field} is {value}; give a finite value, zero or above{null_advice}")
        if not self.sides and not self.acts_in_the_gap:
            raise RigError(
                "contact law: both clearances are null, so that it has no stop and gives no force; give one of them"
            )

    @staticmethod
    def formula(law: Any, eta: Any, rate: Any, time_s: Any) -> Any:
        """Force f(eta, eta', t), N."""
        raise NotImplementedError

    def with_clearances(self, lower_clearance_m: float, upper_clearance_m: float) -> "ContactLaw":
        """Law with other clearances, m. Raises RigError if it has no stops."""
        if not self.has_stops:
            raise RigError("contact law: it has no stops, so that no clearance can differ; choose another contact")
        return msgspec.structs.replace(self, lower_clearance_m=lower_clearance_m, upper_clearance_m=upper_clearance_m)

    @property
    def acts_in_the_gap(self) -> bool:
        """True if there is a force between the stops, too."""
        return False

    @property
    def largest_slopes(self) -> tuple[float, float]:
        """Largest df/d eta (N/m) and df/d eta' (N s/m) at a stop, which a time step has to resolve."""
        return self.stiffness_n_per_m, self.damping_n_s_per_m

    @property
    def clearance_m(self) -> float:
        """Half the total clearance at time 0, m: the paper's d where both sides are equal.

        That of the only stop where one side has none; infinite without stops.
        """
        if len(self.sides) == 2:
            return (self.lower_clearance_m + self.upper_clearance_m) / 2
        return min(self.lower_clearance_m, self.upper_clearance_m)

    @property
    def sides(self) -> tuple[int, ...]:
        """Sides that have a stop: -1 the lower one, 1 the upper one."""
        sides_and_clearances_m = ((-1, self.lower_clearance_m), (1, self.upper_clearance_m))
        return tuple(side for side, clearance_m in sides_and_clearances_m if np.isfinite(clearance_m))

    def penetration_m(self, eta_m: Signal, time_s: Signal = 0.0) -> Values:
        """Signed depth beyond the stops: the paper's dead-zone function of the relative displacement."""
        return np.asarray(depth_of(self, eta_m, time_s))

    def force_n(self, eta_m: Signal, rate_m_per_s: Signal = 0.0, time_s: Signal = 0.0) -> Values:
        """Force at a relative displacement and its rate, N."""
        return np.asarray(self.formula(self, eta_m, rate_m_per_s, time_s))

    def by_eta_n_per_m(self, eta_m: Signal, time_s: Signal = 0.0) -> Values:
        """Derivative df/d eta at rest, N/m; zero in the gap."""
        raise NotImplementedError

    def by_rate_n_s_per_m(self, eta_m: Signal, rate_m_per_s: Signal, time_s: Signal = 0.0) -> Values:
        """Derivative df/d eta', N s/m."""
        raise NotImplementedError

    def energy_j(self, eta_m: Signal, time_s: Signal = 0.0) -> Values:
        """Potential energy of the force at rest, J."""
        raise NotImplementedError


class PlaneLaw(ContactLaw, frozen=True, kw_only=True):
    """A law of one direction, with two stops.

    They stand at `upper_clearance_m` above and `lower_clearance_m` below; both clearances grow by `wear_m_per_s` from
    what they are at time 0. A clearance is infinite where that side has no stop.
    """

    lower_clearance_m: float
    upper_clearance_m: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float = 0.0
    wear_m_per_s: float = 0.0


def stop_positions_m_and_sides(law: ContactLaw) -> list[tuple[float, int]]:
    """Relative displacements at which the stops stand at time 0, the upper one first, each with its side."""
    position_by_side_m = {-1: -law.lower_clearance_m, 1: law.upper_clearance_m}
    return [(position_by_side_m[side], side) for side in reversed(law.sides)]


def depth_of(law: Any, eta: Any, time_s: Any) -> Any:
    """Signed depth beyond the stops, m."""
    lower_stop_m, upper_stop_m = -law.lower_clearance_m, law.upper_clearance_m
    if contributes(law.wear_m_per_s):
        lower_stop_m, upper_stop_m = lower_stop_m - law.wear_m_per_s * time_s, upper_stop_m + law.wear_m_per_s * time_s
    return beyond(eta, lower_stop_m, upper_stop_m)


def penetration_m(eta_m: Signal, lower_clearance_m: Any, upper_clearance_m: Any) -> Values:
    """eta - upper above the upper stop, eta + lower below the lower one, zero between; metres."""
    return np.asarray(beyond(eta_m, -lower_clearance_m, upper_clearance_m))
