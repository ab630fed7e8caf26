"""Parameters of a fit: units, ranges, neutral values and their order in vectors."""

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

ParameterVector = Float[np.ndarray, " parameters"]


@dataclass(frozen=True)
class Parameter:
    """A fitted number: unit ("1" if it has none), plausible range, and neutral value, at which it has no effect.

    neutral is None for a place, a time or a frequency, which are no strengths. `of` names the owner of the parameter.
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

    def __add__(self, added: "ParameterSet") -> "ParameterSet":
        return ParameterSet(self.parameters + added.parameters)

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def __getitem__(self, name: str) -> Parameter:
        """The first parameter of that name."""
        return self.parameters[self.names.index(name)]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def bounds(self) -> tuple[ParameterVector, ParameterVector]:
        """Lower and upper bounds."""
        return np.array([parameter.low for parameter in self.parameters]), np.array(
            [parameter.high for parameter in self.parameters]
        )

    @property
    def strengths(self) -> list[int]:
        """Indices of the strengths: parameters with a neutral value."""
        return [index for index, parameter in enumerate(self.parameters) if parameter.neutral is not None]

    def with_owner(self, owner: str) -> "ParameterSet":
        """The same parameters with this owner."""
        return ParameterSet(tuple(dataclasses.replace(parameter, of=owner) for parameter in self.parameters))

    def indices_of(self, owner: str) -> list[int]:
        """Indices of the owner's parameters."""
        return [i for i, parameter in enumerate(self.parameters) if parameter.of == owner]

    def with_ranges(self, ranges: Mapping[str, tuple[float, float]]) -> "ParameterSet":
        """The same parameters with other ranges for some, by name."""
        return ParameterSet(
            tuple(
                dataclasses.replace(parameter, low=ranges[parameter.name][0], high=ranges[parameter.name][1])
                if parameter.name in ranges
                else parameter
                for parameter in self.parameters
            )
        )

    def excluding(self, name: str) -> "ParameterSet":
        return ParameterSet(tuple(parameter for parameter in self.parameters if parameter.name != name))

    def vector(self, value_by_name: Mapping[str, float]) -> ParameterVector:
        """Vector of numbers given by name; zero for missing ones."""
        return np.array([value_by_name.get(name, 0.0) for name in self.names])

    def named(self, parameter_values: ParameterVector) -> dict[str, float]:
        return dict(zip(self.names, parameter_values.tolist(), strict=True))
