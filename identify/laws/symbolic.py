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

POPULATION_SIZE = 400
GENERATION_COUNT = 120
FIT_ITERATION_COUNT = 5
"""Iterations of the least-squares fit of the constants of each new formula."""
MAX_NODE_COUNT = 15
THREAD_COUNT = 2
NEGLIGIBLE_CONSTANT = 1e-5
"""Constant term below which it is dropped; y is of order 1."""

Points = Float[np.ndarray, " points"]
_FUNCTIONS: dict[str, Callable[..., Any]] = {"+": np.add, "-": np.subtract, "*": np.multiply, "abs": np.abs}
_FUNCTIONS |= {"min": np.minimum, "max": np.maximum}


@dataclass(frozen=True)
class Formula:
    """Expression: a constant ("1"), the variable times a constant ("x"), or an operation on one or two formulas."""

    operation: str
    value: float = 1.0
    operands: tuple["Formula", ...] = ()

    def __call__(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        if self.operation == "1":
            return np.full_like(x, self.value)
        if self.operation == "x":
            return self.value * x
        return np.asarray(_FUNCTIONS[self.operation](*(operand(x) for operand in self.operands)))

    @property
    def length(self) -> int:
        """Count of operations and leaves."""
        return 1 + sum(operand.length for operand in self.operands)

    def scaled(self, x_unit: float, y_unit: float) -> "Formula":
        """Formula y_unit f(x / x_unit) with the scales taken into its constants; both units above zero."""
        if self.operation == "1":
            return replace(self, value=self.value * y_unit)
        if self.operation == "x":
            return replace(self, value=self.value * y_unit / x_unit)
        if self.operation == "*":
            first_operand, second_operand = self.operands
            return replace(self, operands=(first_operand.scaled(x_unit, y_unit), second_operand.scaled(x_unit, 1.0)))
        return replace(self, operands=tuple(operand.scaled(x_unit, y_unit) for operand in self.operands))

    def text(self, variable_name: str) -> str:
        """Infix notation with a name for the variable."""
        if self.operation == "1":
            return f"{self.value:.6g}"
        if self.operation == "x":
            return variable_name if self.value == 1 else f"{self.value:.6g} {variable_name}"
        texts = [operand.text(variable_name) for operand in self.operands]
        if self.operation in ("abs", "min", "max"):
            return f"{self.operation}({', '.join(texts)})"
        if self.operation == "*":
            return " * ".join(
                f"({text})" if node.operation in "+-" else text for text, node in zip(texts, self.operands, strict=True)
            )
        second_text = f"({texts[1]})" if self.operation == "-" and self.operands[1].operation in "+-" else texts[1]
        return f"{texts[0]} {self.operation} {second_text}".replace("+ -", "- ").replace("- -", "+ ")


def simplify(operation: str, operands: tuple[Formula, ...]) -> Formula:
    """Operation on formulas with constants evaluated, gathered in front, and dropped where they have no effect."""
    operand_operations = [operand.operation for operand in operands]
    if all(operand_operation == "1" for operand_operation in operand_operations):
        return Formula("1", float(Formula(operation, operands=operands)(np.zeros(1))[0]))
    if operation in "+-" and operand_operations == ["x", "x"]:
        sign = 1 if operation == "+" else -1
        return Formula("x", operands[0].value + sign * operands[1].value)
    if operation in "+-" and "1" in operand_operations:
        first, second = operands[0], operands[1] if operation == "+" else _times(operands[1], -1.0)
        return _plus(second, first.value) if operand_operations[0] == "1" else _plus(first, second.value)
    if operation == "*":
        (first_factor, first), (second_factor, second) = map(_factor_and_rest, operands)
        product = Formula("*", operands=(first, second))
        if "1" in operand_operations:
            product = first if operand_operations[1] == "1" else second
        return _times(product, first_factor * second_factor)
    return Formula(operation, operands=operands)


def _plus(formula: Formula, constant: float) -> Formula:
    """Sum of a constant and a formula, merged with a constant that leads it."""
    if formula.operation in "+-" and formula.operands[0].operation == "1":
        constant += formula.operands[0].value
        if formula.operation == "-":
            return Formula("-", operands=(Formula("1", constant), formula.operands[1]))
        formula = formula.operands[1]
    if abs(constant) < NEGLIGIBLE_CONSTANT:
        return formula
    return Formula("+", operands=(Formula("1", constant), formula))


def _times(formula: Formula, factor: float) -> Formula:
    """Multiple of a formula, with the factor taken into its leaves; a negative one swaps min and max."""
    if factor == 1:
        return formula
    if formula.operation in "1x":
        return replace(formula, value=factor * formula.value)
    if formula.operation == "*":
        return replace(formula, operands=(_times(formula.operands[0], factor), formula.operands[1]))
    if formula.operation == "abs" and factor < 0:
        return Formula("*", operands=(Formula("1", -1.0), _times(formula, -factor)))
    operation = formula.operation
    if factor < 0:
        operation = {"min": "max", "max": "min"}.get(operation, operation)
    return Formula(operation, operands=tuple(_times(operand, factor) for operand in formula.operands))


def _factor_and_rest(formula: Formula) -> tuple[float, Formula]:
    """Leading factor of a formula, and the formula without it."""
    if formula.operation in "1x":
        return formula.value, replace(formula, value=1.0)
    if formula.operation == "abs" and formula.operands[0].operation == "x":
        return abs(formula.operands[0].value), Formula("abs", operands=(Formula("x"),))
    if formula.operation == "*":
        factor, first_operand = _factor_and_rest(formula.operands[0])
        return factor, replace(formula, operands=(first_operand, formula.operands[1]))
    return 1.0, formula


@dataclass(frozen=True)
class FormulaSearch:
    """Formulas from short to long, each better than every shorter one; out_of_time if the time ended the search."""

    formulas: tuple[Formula, ...]
    out_of_time: bool


def pyoperon() -> Any:
    """Module pyoperon.sklearn; raises RigError if it is not installed."""
    with needs_extra("symbolic", "the search for a law (pyoperon)"):
        return importlib.import_module("pyoperon.sklearn")


def search(
    x: Points,
    y: Points,
    seconds: float,
    seed: int,
    thread_count: int = THREAD_COUNT,
    generation_count: int = GENERATION_COUNT,
) -> FormulaSearch:
    """Search formulas y = f(x) of + - * min max abs and constants, by error and length; x and y are of order 1.

    Genetic programming with two objectives (pyoperon's NSGA-II), with constants fitted by Levenberg-Marquardt. The same
    seed gives the same formulas, also with several threads, unless the time ends the search before its generations do.

    Raises RigError if pyoperon is not installed.
    """
    regression_module = pyoperon()
    start_s = time.monotonic()
    regressor = regression_module.SymbolicRegressor(
        allowed_symbols="add,sub,mul,fmin,fmax,abs,constant,variable",
        objectives=["r2", "length"],
        optimizer_iterations=FIT_ITERATION_COUNT,
        population_size=POPULATION_SIZE,
        generations=generation_count,
        max_evaluations=10**9,
        max_length=MAX_NODE_COUNT,
        max_time=max(1, int(seconds)),
        uncertainty=[0.01],
        n_threads=min(thread_count, os.cpu_count() or 1),
        random_state=seed,
    ).fit(x[:, None], y)
    elapsed_s = time.monotonic() - start_s
    out_of_time = regressor.stats_["generations"] < generation_count and elapsed_s > 0.9 * int(seconds)
    formulas, least_square_error = list[Formula](), np.inf
    trees = (individual["tree"] for individual in regressor.pareto_front_)
    for formula in sorted(map(_formula_of_tree, trees), key=lambda formula: formula.length):
        mean_square_error = float(np.mean((formula(x) - y) ** 2))
        if not formulas or mean_square_error < least_square_error:
            formulas.append(formula)
            least_square_error = mean_square_error
    return FormulaSearch(tuple(formulas), out_of_time)


def _formula_of_tree(tree: Any) -> Formula:
    """Formula of a tree in pyoperon's postfix notation, where the first operand stands directly before its operator."""
    operation_names = {"fmin": "min", "fmax": "max"}  # the node's type has these two the wrong way round
    formula_stack: list[Formula] = []
    for node in tree.Nodes:
        if node.IsConstant or node.IsVariable:
            formula_stack.append(Formula("1" if node.IsConstant else "x", float(node.Value)))
            continue
        operation = operation_names.get(node.Name, node.Name)
        operands = [formula_stack.pop() for _ in range(node.Arity)]
        if len(operands) == 1 and operation == "-":
            operands.insert(0, Formula("1", 0.0))
        formula = simplify(operation, tuple(operands[: 1 if operation == "abs" else 2]))
        for operand in operands[2:]:
            formula = simplify(operation, (formula, operand))
        formula_stack.append(formula)
    return formula_stack.pop()
