"""Optional packages: an extra installs those of one purpose, `pip install ".[all]"` installs all."""

from collections.abc import Iterator
from contextlib import contextmanager

from rig.errors import RigError


@contextmanager
def needs_extra(name: str, purpose: str) -> Iterator[None]:
    """Wrap an import of an optional package; raise RigError, naming the extra to install, if it is missing."""
    try:
        yield
    except ImportError as error:
        raise RigError(
            f"{purpose} needs packages that are not installed ({error}): pip install 'rig-identify[{name}]', or in a "
            f"clone pip install '.[{name}]'"
        ) from error
