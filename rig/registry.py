"""Packages with one file each for what they hold: what their modules define is found by itself."""

from collections.abc import Iterator, Sequence
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, TypeVar

Kind = TypeVar("Kind")


def defined(path: Sequence[str], package: str) -> Iterator[tuple[str, Any]]:
    """Everything in the modules of a package, with the module's name, in alphabetical order of the modules."""
    for module in sorted(info.name for info in iter_modules(path, f"{package}.")):
        for one in vars(import_module(module)).values():
            yield module, one


def subclasses(path: Sequence[str], package: str, kind: type[Kind]) -> list[type[Kind]]:
    """The classes of a kind that the modules define, but itself."""
    return [
        one
        for module, one in defined(path, package)
        if isinstance(one, type) and issubclass(one, kind) and one.__module__ == module and one is not kind
    ]


def instances(path: Sequence[str], package: str, kind: type[Kind]) -> list[Kind]:
    """The instances of a kind that the modules hold."""
    return [one for _, one in defined(path, package) if isinstance(one, kind)]
