"""Registries: packages with one file for each item, whose definitions are found by importing every module."""

from collections.abc import Iterator, Sequence
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, TypeVar

Kind = TypeVar("Kind")


def definitions(path: Sequence[str], package: str) -> Iterator[tuple[str, Any]]:
    """Every value in the modules of a package, with its module's name, in alphabetical order of the modules."""
    for module in sorted(info.name for info in iter_modules(path, f"{package}.")):
        for value in vars(import_module(module)).values():
            yield module, value


def subclasses(path: Sequence[str], package: str, kind: type[Kind]) -> list[type[Kind]]:
    """Subclasses of `kind` that the modules define."""
    return [
        value
        for module, value in definitions(path, package)
        if isinstance(value, type) and issubclass(value, kind) and value.__module__ == module and value is not kind
    ]


def instances(path: Sequence[str], package: str, kind: type[Kind]) -> list[Kind]:
    """Instances of `kind` in the modules."""
    return [value for _, value in definitions(path, package) if isinstance(value, kind)]
