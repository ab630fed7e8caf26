"""A figure as a file, and as a page shows it."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rig.files import write_bytes


@dataclass(frozen=True)
class Picture:
    """A PNG file, and matplotlib's figure that it was made of; a notebook shows it."""

    png: bytes = field(repr=False)
    figure: Any = field(repr=False, compare=False, default=None)

    def save(self, path: str | Path) -> None:
        write_bytes(self.png, Path(path))

    def _repr_png_(self) -> bytes:
        return self.png
