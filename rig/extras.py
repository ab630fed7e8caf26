"""Packages that not every user needs: `pip install ".[all]"` brings all, an extra the packages of one purpose."""

from collections.abc import Iterator
from contextlib import contextmanager

from rig.errors import RigError


@contextmanager
def needs_extra(name: str, purpose: str) -> Iterator[None]:
    """Around an import of what the extra of that name brings; raises RigError if it is not there."""
    try:
        yield
    except ImportError as error:
        raise RigError(
            f"{purpose} needs packages that are not installed ({error}): pip install 'rig-identify[{name}]', or in a "
            f"clone pip install '.[{name}]'"
        ) from error
