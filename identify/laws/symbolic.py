"""Formulas of one variable, and their search by genetic programming (pyoperon, an optional package)."""

import importlib
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from rig.extras import needs_extra

POPULATION = 400
GENERATIONS = 120
ITERATIONS = 5
"""Of the least-squares fit of a formula's constants, each time that a formula is made."""
LONGEST = 15
THREADS = 2
NEGLIGIBLE = 1e-5
"""A constant term below this is left away; y is of order 1."""

_REDUCED: dict[str, Callable[[Any, Any], Any]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "min": np.minimum,
    "max": np.maximum,
}


@dataclass(frozen=True)
class Formula:
    """A tree: a constant ("1"), the variable times a constant ("x"), or an operation on one or two formulas."""

    operation: str
    value: float = 1.0
    parts: tuple["Formula", ...] = ()

    def __call__(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        if self.operation == "1":
            return np.full_like(x, self.value)
        if self.operation == "x":
            return self.value * x
        values = [part(x) for part in self.parts]
        if self.operation == "abs":
            return np.abs(values[0])
        return np.asarray(_REDUCED[self.operation](*values))

    @property
    def length(self) -> int:
        """Count of operations and leaves."""
        return 1 + sum(part.length for part in self.parts)

    def scaled(self, x_unit: float, y_unit: float) -> "Formula":
        """y_unit times the formula of x / x_unit; both units above zero. A scale goes down to the constants."""
        if self.operation == "1":
            return replace(self, value=self.value * y_unit)
        if self.operation == "x":
            return replace(self, value=self.value * y_unit / x_unit)
        if self.operation == "*":
            first, second = self.parts
            return replace(self, parts=(first.scaled(x_unit, y_unit), second.scaled(x_unit, 1.0)))
        return replace(self, parts=tuple(part.scaled(x_unit, y_unit) for part in self.parts))

    def text(self, name: str) -> str:
        if self.operation == "1":
            return f"{self.value:.6g}"
        if self.operation == "x":
            return name if self.value == 1 else f"{self.value:.6g} {name}"
        shown = [part.text(name) for part in self.parts]
        if self.operation in ("abs", "min", "max"):
            return f"{self.operation}({', '.join(shown)})"
        if self.operation == "*":
            return " * ".join(f"({s})" if p.operation in "+-" else s for s, p in zip(shown, self.parts, strict=True))
        second = f"({shown[1]})" if self.operation == "-" and self.parts[1].operation in "+-" else shown[1]
        return f"{shown[0]} {self.operation} {second}".replace("+ -", "- ").replace("- -", "+ ")


def simplified(operation: str, parts: tuple[Formula, ...]) -> Formula:
    """The operation on formulas, with constants worked out and neutral ones left away."""
    kinds = [part.operation for part in parts]
    if all(kind == "1" for kind in kinds):
        return Formula("1", float(Formula(operation, parts=parts)(np.zeros(1))[0]))
    if operation in "+-" and kinds == ["x", "x"]:
        sign = 1 if operation == "+" else -1
        return Formula("x", parts[0].value + sign * parts[1].value)
    if operation in "+-" and "1" in kinds:
        first, second = (parts[0], parts[1]) if operation == "+" else (parts[0], _times(parts[1], -1.0))
        return _plus(second, first.value) if kinds[0] == "1" else _plus(first, second.value)
    if operation == "*":
        (a, first), (b, second) = _factored(parts[0]), _factored(parts[1])
        rest = (first if kinds[1] == "1" else second) if "1" in kinds else Formula("*", parts=(first, second))
        return _times(rest, a * b)
    return Formula(operation, parts=parts)


def _plus(formula: Formula, number: float) -> Formula:
    if formula.operation in "+-" and formula.parts[0].operation == "1":
        number += formula.parts[0].value
        if formula.operation == "-":
            return Formula("-", parts=(Formula("1", number), formula.parts[1]))
        formula = formula.parts[1]
    if abs(number) < NEGLIGIBLE:
        return formula
    return Formula("+", parts=(Formula("1", number), formula))


def _times(formula: Formula, factor: float) -> Formula:
    """A scale goes down to the leaves; a negative one turns min into max."""
    if factor == 1:
        return formula
    if formula.operation in "1x":
        return replace(formula, value=factor * formula.value)
    if formula.operation == "*":
        return replace(formula, parts=(_times(formula.parts[0], factor), formula.parts[1]))
    if formula.operation == "abs" and factor < 0:
        return Formula("*", parts=(Formula("1", -1.0), _times(formula, -factor)))
    operation = formula.operation
    if factor < 0:
        operation = {"min": "max", "max": "min"}.get(operation, operation)
    return Formula(operation, parts=tuple(_times(part, factor) for part in formula.parts))


def _factored(formula: Formula) -> tuple[float, Formula]:
    """A leading factor, and the formula without it."""
    if formula.operation in "1x":
        return formula.value, replace(formula, value=1.0)
    if formula.operation == "abs" and formula.parts[0].operation == "x":
        return abs(formula.parts[0].value), Formula("abs", parts=(Formula("x"),))
    if formula.operation == "*":
        factor, first = _factored(formula.parts[0])
        return factor, replace(formula, parts=(first, formula.parts[1]))
    return 1.0, formula


@dataclass(frozen=True)
class FormulaSearch:
    """Formulas found, from short to long, each better than every shorter one; and whether time ended the search."""

    formulas: tuple[Formula, ...]
    out_of_time: bool


def pyoperon() -> Any:
    """The module pyoperon.sklearn; raises RigError if it is not installed."""
    with needs_extra("symbolic", "the search for a law (pyoperon)"):
        return importlib.import_module("pyoperon.sklearn")


def search(
    x: Float[np.ndarray, " points"], y: Float[np.ndarray, " points"], seconds: float, seed: int, threads: int = THREADS
) -> FormulaSearch:
    """Searches y = f(x), both of order 1, with + - * min max abs and constants, for small error and short formulas.

    Genetic programming with two objectives (pyoperon's NSGA-II), constants by Levenberg-Marquardt. The same seed gives
    the same formulas, also with several threads, unless the time ends the search before its generations do.

    Raises RigError if pyoperon is not installed.
    """
    regression = pyoperon()
    started = time.monotonic()
    found = regression.SymbolicRegressor(
        allowed_symbols="add,sub,mul,fmin,fmax,abs,constant,variable",
        objectives=["r2", "length"],
        optimizer_iterations=ITERATIONS,
        population_size=POPULATION,
        generations=GENERATIONS,
        max_evaluations=10**9,
        max_length=LONGEST,
        max_time=max(1, int(seconds)),
        uncertainty=[0.01],
        n_threads=min(threads, os.cpu_count() or 1),
        random_state=seed,
    ).fit(x[:, None], y)
    out_of_time = found.stats_["generations"] < GENERATIONS and time.monotonic() - started > 0.9 * int(seconds)
    formulas = [_formula(each["tree"]) for each in found.pareto_front_]
    kept: list[tuple[float, Formula]] = []
    for formula in sorted(formulas, key=lambda f: f.length):
        error = float(np.mean((formula(x) - y) ** 2))
        if not kept or error < kept[-1][0]:
            kept.append((error, formula))
    return FormulaSearch(tuple(formula for _, formula in kept), out_of_time)


def _formula(tree: Any) -> Formula:
    """Formula of pyoperon's postfix notation, in which an operation's first argument stands right before it."""
    names = {"fmin": "min", "fmax": "max"}  # the node's type has these two the wrong way round
    stack: list[Formula] = []
    for node in tree.Nodes:
        if node.IsConstant or node.IsVariable:
            stack.append(Formula("1" if node.IsConstant else "x", float(node.Value)))
            continue
        operation = names.get(node.Name, node.Name)
        parts = [stack.pop() for _ in range(node.Arity)]
        if len(parts) == 1 and operation == "-":
            parts.insert(0, Formula("1", 0.0))
        whole = simplified(operation, tuple(parts[: 1 if operation == "abs" else 2]))
        for part in parts[2:]:
            whole = simplified(operation, (whole, part))
        stack.append(whole)
    return stack.pop()
