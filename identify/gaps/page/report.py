"""gap.html: a diagnosis as a page that stands alone, beside gap.json and the corrected rig.json."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from identify.gaps.decision_table import Verdict
from identify.gaps.page.decided import decided
from identify.gaps.page.screen import colour
from identify.gaps.page.sections import (
    between_records,
    causes,
    how_large,
    notes,
    response_comparison,
    unknown_force,
    what_next,
    where,
)
from identify.gaps.results import Gap
from identify.gaps.wording import verdict
from identify.pages import page
from identify.pages.picture import Picture
from rig.files import make_folder, write_bytes, write_json
from rig.model.description import Rig, to_json

CAPTIONS = {
    "next_experiments": "Each further recording was simulated with either of the two, and the other one fitted to it. "
    "The bar is the mean, over which of them is true, of what -2 ln p tells them apart by, as the logarithm of odds. "
    "Grey: the same setting again.",
    "large_bands": "The share of the measured acceleration that each rig leaves unexplained, in bands of frequency. "
    "Nineteen of twenty null simulations (the believed rig within its tolerances) stay below the green line; a share "
    "below the dashed line is too small to matter.",
    "unknown_place": "The bodies seen from the side, with what is unknown in red: a dot where it acts, the double "
    "arrow along the direction in which it pushes and pulls.",
}
"""Of the pictures that are shown wide; the others carry their titles."""


def write_all(gap: Gap, corrected: Rig, title: str, folder: Path, sources: Sequence[Path] = ()) -> None:
    """gap.html, the corrected rig's rig.json, and gap.json, each whole or not at all."""
    from identify.gaps.page.pictures import pictures

    make_folder(folder)
    write_page(gap, pictures(gap, corrected), title, folder / "gap.html", sources)
    write_bytes(to_json(corrected), folder / "rig.json")
    write_json(gap, folder / "gap.json")


def write_page(gap: Gap, figures: Mapping[str, Picture], title: str, path: Path, sources: Sequence[Path] = ()) -> None:
    """Writes the page, which needs no other file: beside first, then renamed.

    The first word of a figure's name says the section, as `identify.gaps.page.pictures` names them.
    """
    rest = "What the rest looks like" if gap.verdict == Verdict.PARTLY_EXPLAINED else "What is not explained"
    sections = [
        ("What to do next", "next", what_next(gap)),
        ("How large is the difference?", "large", how_large(gap)),
        ("What causes it?", "why", causes(gap)),
        ("How was it decided?", "decided", decided(gap)),
        *([("What differs between the records?", "between", between_records(gap.between))] if gap.between else []),
        *([(rest, "unknown", unknown_force(gap.unknown))] if gap.unknown else []),
        ("Where does it lie?", "where", where(gap.attribution)),
        ("Simulated and measured", "far", response_comparison(gap)),
        *([("What could not be computed", "notes", notes(gap))] if gap.notes else []),
    ]
    page.write(
        path,
        title=title,
        colour=colour(gap),
        verdict=verdict(gap),
        sentence=gap.sentence,
        sections=[(heading, f"{text}\n{_images(figures, key)}") for heading, key, text in sections],
        foot="Every number of this page stands in gap.json, unrounded.",
        sources=sources,
    )


def _images(figures: Mapping[str, Picture], section: str) -> str:
    own = {name: shown for name, shown in figures.items() if name.split("_")[0] == section}
    wide = "".join(page.figure(name, shown, CAPTIONS[name]) for name, shown in own.items() if name in CAPTIONS)
    small = "".join(page.figure(name, shown) for name, shown in own.items() if name not in CAPTIONS)
    return wide + (f'<div class="pictures">\n{small}</div>' if small else "")
