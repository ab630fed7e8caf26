"""Parameters of a fit: their units, ranges and neutral values, and the order in which they stand in its vectors."""

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Vector = Float[np.ndarray, " parameters"]


@dataclass(frozen=True)
class Parameter:
    """A number that can be fitted: its unit ("1" if it has none), its plausible range, and where it changes nothing.

    neutral is None for a number that says where, when or at which frequency rather than how much. `of` names what the
    parameter belongs to.
    """

    unit: str
    low: float
    high: float
    neutral: float | None = None
    name: str = ""
    of: str = ""


@dataclass(frozen=True)
class ParameterSet:
    """Parameters in the order of a vector of their values."""

    parameters: tuple[Parameter, ...] = ()

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def __len__(self) -> int:
        return len(self.parameters)

    def __add__(self, other: "ParameterSet") -> "ParameterSet":
        return ParameterSet(self.parameters + other.parameters)

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def __getitem__(self, name: str) -> Parameter:
        """The first parameter of that name."""
        return self.parameters[self.names.index(name)]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        """The low ends of the ranges, and the high ones."""
        return np.array([p.low for p in self.parameters]), np.array([p.high for p in self.parameters])

    @property
    def strengths(self) -> list[int]:
        """Places of the strengths, which have a neutral value."""
        return [i for i, p in enumerate(self.parameters) if p.neutral is not None]

    def belonging_to(self, owner: str) -> "ParameterSet":
        """The same, as parameters of the owner."""
        return ParameterSet(tuple(dataclasses.replace(p, of=owner) for p in self.parameters))

    def places_of(self, owner: str) -> list[int]:
        """Places of the owner's parameters."""
        return [i for i, p in enumerate(self.parameters) if p.of == owner]

    def ranged(self, ranges: Mapping[str, tuple[float, float]]) -> "ParameterSet":
        """Some of them, by name, with other ranges."""
        return ParameterSet(
            tuple(
                dataclasses.replace(p, low=ranges[p.name][0], high=ranges[p.name][1]) if p.name in ranges else p
                for p in self.parameters
            )
        )

    def without(self, name: str) -> "ParameterSet":
        return ParameterSet(tuple(p for p in self.parameters if p.name != name))

    def vector(self, numbers: Mapping[str, float]) -> Vector:
        """Numbers by name in the order of the parameters; zero for what is not among them."""
        return np.array([numbers.get(name, 0.0) for name in self.names])

    def named(self, values: Vector) -> dict[str, float]:
        return dict(zip(self.names, values.tolist(), strict=True))
