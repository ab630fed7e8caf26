"""A diagnosis for people: a page that stands alone, and a few lines for the screen."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from identify import page
from identify.gap.results import Gap, Share
from identify.gap.wording import VERDICTS, cause_name, closed, interval, none_of_these
from identify.results import write_json
from identify.wording import number, percent
from rig.container import part_of
from rig.description import Rig, to_json

_COLOURS: dict[str, page.Colour] = {"no_gap": "green", "effect": "yellow", "none_of_these": "red"}


def write_all(gap: Gap, corrected: Rig, title: str, folder: Path) -> None:
    """gap.html, the corrected rig's rig.json, and gap.json, each whole or not at all."""
    from identify.gap.pictures import pictures

    folder.mkdir(parents=True, exist_ok=True)
    write_page(gap, pictures(gap), title, folder / "gap.html")
    part = part_of(folder / "rig.json")
    part.write_bytes(to_json(corrected))
    part.replace(folder / "rig.json")
    write_json(gap, folder / "gap.json")


def write_page(gap: Gap, figures: Mapping[str, bytes], title: str, path: Path) -> None:
    """Writes the page, which needs no other file: beside first, then renamed.

    figures are PNG files; the first word of a name says the section, as `identify.gap.pictures` names them.
    """
    sections = (
        ("Is there a gap?", "is", _is_there(gap)),
        ("Where?", "where", _where(gap)),
        ("Why?", "why", _why(gap)),
        ("How far does it shrink?", "far", _how_far(gap)),
    )
    page.write(
        path,
        title=title,
        colour=_COLOURS[gap.verdict],
        verdict=VERDICTS[gap.verdict],
        sentence=gap.sentence,
        sections=[(heading, f"{text}\n{_images(figures, key)}") for heading, key, text in sections],
        foot="Every number of this page stands in gap.json, unrounded.",
    )


def shown(gap: Gap) -> RenderableType:
    """The verdict for the screen: the sentence, the causes, and how far the gap closes."""
    lines: list[RenderableType] = [
        Text.assemble((VERDICTS[gap.verdict], f"bold {_COLOURS[gap.verdict]}"), ": ", gap.sentence)
    ]
    if gap.causes:
        table = Table("cause", "probability", "left (nulls: 1)")
        table.add_column("parameters ± 95 %", overflow="fold")
        for cause in gap.causes:
            found = "\n".join(f"{name} {interval(value)}" for name, value in cause.parameters.items())
            row = (cause_name(cause), percent(cause.probability), number(cause.left, 3), found)
            table.add_row(*(Text(cell) for cell in row))
        rest, share = none_of_these(gap)
        table.add_row(rest, percent(share), number(gap.size, 3), "")
        lines.append(table)
    lines.append(Text(f"gap closed on the validation record: {closed(gap.closure)}"))
    lines += [Text(f"this record cannot tell apart: {' / '.join(names)}") for names in gap.equivalent]
    lines += [Text(f"surer by: {experiment}") for experiment in gap.separate_by]
    return Group(*lines)


def _is_there(gap: Gap) -> str:
    note = (
        f"<p>The size of the gap is <b>{number(gap.size, 3)}</b>. One is what null recordings leave: simulations "
        "of the believed rig, with the tolerances of a laboratory, through the same sensors and the same analysis.</p>"
    )
    if gap.channel_faults:
        note += "<h3>Channels left out</h3>" + page.table(("channel", "fault"), gap.channel_faults.items())
    return note


def _where(gap: Gap) -> str:
    where = gap.where
    cuts: dict[str, Mapping[str, float]] = {
        "channel": where.channels,
        "linear or contact": where.parts,
        "modal equation": where.modal_equations,
        "station": {f"{body}, {at} m": s for body, stations in where.positions_m.items() for at, s in stations.items()},
        "band": _by_name(where.band_hz, "Hz"),
        "contact state": where.contact_state,
        "time": _by_name(where.time_s, "s"),
    }
    cuts = {name: shares for name, shares in cuts.items() if shares}
    tops = {name: max(shares.items(), key=lambda item: item[1]) for name, shares in cuts.items()}
    largest = [(name, part, percent(share)) for name, (part, share) in tops.items()]
    every = [(name, part, percent(share)) for name, shares in cuts.items() for part, share in shares.items()]
    return (
        "<p>The largest share of the gap, by every way of cutting the record; each way sums to 100 %.</p>"
        + page.table(("by", "largest", "share"), largest)
        + f"<details><summary>All shares</summary>{page.table(('by', 'part', 'share'), every)}</details>"
    )


def _why(gap: Gap) -> str:
    rest, share = none_of_these(gap)
    causes = [(cause_name(c), percent(c.probability), number(c.left, 3)) for c in gap.causes]
    causes.append((rest, percent(share), number(gap.size, 3)))
    text = "" if gap.verdict == "effect" else "<p>No cause is accepted. What was tried:</p>"
    text += page.table(("cause", "probability", "left"), causes)
    text += '<p class="dim">Left: what remains of the gap on the validation record, where nulls leave 1.</p>'
    details = [c for c in gap.causes if c.parameters or c.places]
    if details:
        text += "<h3>Parameters and places</h3><p>Value ± 1.96 standard errors: 95 % interval.</p>"
    for cause in details:
        rows = [*((what, interval(value)) for what, value in cause.parameters.items()), *cause.places.items()]
        text += page.table((cause_name(cause), ""), rows)
    if gap.equivalent:
        text += "<h3>What this recording cannot tell apart</h3>"
        text += page.listed(" / ".join(names) for names in gap.equivalent)
    if gap.separate_by:
        text += "<h3>What would make it surer</h3>" + page.listed(gap.separate_by)
    return text


def _how_far(gap: Gap) -> str:
    found = gap.closure
    sizes = (("before", found.before), ("floor", found.floor), ("after", found.after))
    text = (
        "<p>On a record that the fit has not seen: mean squares of the whitened residual, with the believed rig "
        "(before), at its lowest (floor), and with the likeliest cause in the rig (after). "
        "Closed = (before &minus; after) / (before &minus; floor).</p>"
    )
    rows = [(name, number(size, 3)) for name, size in sizes]
    text += page.table(("validation record", "mean square"), [*rows, ("closed", closed(found))])
    if gap.likeness:
        text += "<h3>In familiar terms</h3><p>Simulated with the force of the measured record.</p>"
        text += page.table(
            ("figure", "measured", "believed", "corrected"),
            [
                (f"{a.name}, {a.unit}", *(number(x) for x in (a.measured, a.believed, a.corrected)))
                for a in gap.likeness
            ],
        )
    return text


def _by_name(shares: Sequence[Share], unit: str) -> dict[str, float]:
    return {f"{s.what.removesuffix(f' {unit}')} {unit}": s.share for s in shares}


def _images(figures: Mapping[str, bytes], section: str) -> str:
    images = "".join(page.picture(name, png) for name, png in figures.items() if name.split("_")[0] == section)
    return f'<div class="pictures">\n{images}</div>' if images else ""
