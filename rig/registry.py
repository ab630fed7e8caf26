"""Registries: packages with one file for each item, whose definitions are found by importing every module."""

from collections.abc import Iterator, Sequence
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, TypeVar

Item = TypeVar("Item")


def definitions(package_paths: Sequence[str], package: str) -> Iterator[tuple[str, Any]]:
    """Every value in the modules of a package, with its module's name, in alphabetical order of the modules."""
    for module_name in sorted(module_info.name for module_info in iter_modules(package_paths, f"{package}.")):
        for value in vars(import_module(module_name)).values():
            yield module_name, value


def subclasses(package_paths: Sequence[str], package: str, kind: type[Item]) -> list[type[Item]]:
    """Subclasses of `kind` that the modules define."""
    return [
        value
        for module_name, value in definitions(package_paths, package)
        if isinstance(value, type) and issubclass(value, kind) and value.__module__ == module_name and value is not kind
    ]


def instances(package_paths: Sequence[str], package: str, item_class: type[Item]) -> list[Item]:
    """Instances of `kind` in the modules."""
    return [value for _, value in definitions(package_paths, package) if isinstance(value, item_class)]
