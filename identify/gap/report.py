"""A diagnosis for people: a page that stands alone, and a few lines for the screen."""

from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from identify.gap.results import Gap, Share
from identify.gap.wording import VERDICTS, cause_name, closed, interval, none_of_these, number, percent
from identify.results import write_json
from rig.container import part_of
from rig.description import Rig, to_json

_COLOURS = {"no_gap": "green", "effect": "yellow", "none_of_these": "red"}
_STYLE = """
:root{color-scheme:light dark;--ink:#1c1e21;--dim:#5b6168;--page:#fff;--line:#d8dce0;--card:#f4f6f8;
--green:#1d7a48;--yellow:#9a6400;--red:#b3321f}
@media(prefers-color-scheme:dark){:root{--ink:#e6e8ea;--dim:#a2a9b0;--page:#16181b;--line:#3a3f45;--card:#202327;
--green:#5cc48c;--yellow:#e0ac4a;--red:#f0806c}}
*{box-sizing:border-box}
body{margin:0 auto;padding:1rem;max-width:66rem;background:var(--page);color:var(--ink);
font:16px/1.5 system-ui,sans-serif;overflow-wrap:anywhere}
h1{font-size:1.4rem;margin:.2rem 0}h2{font-size:1.2rem;margin:2.2rem 0 .5rem;border-bottom:1px solid var(--line)}
h3{font-size:1rem;margin:1.2rem 0 .3rem}p{margin:.4rem 0}ul{margin:.3rem 0;padding-left:1.2rem}
.verdict{background:var(--card);border-left:.4rem solid;padding:.7rem 1rem;margin:.8rem 0}
.verdict b{display:block;font-size:.85rem;text-transform:uppercase;letter-spacing:.04em}
.verdict p{color:var(--ink);font-size:1.15rem}.green{color:var(--green)}.yellow{color:var(--yellow)}
.red{color:var(--red)}.dim{color:var(--dim);font-size:.9rem}
.wide{overflow-x:auto}table{border-collapse:collapse;font-size:.92rem;font-variant-numeric:tabular-nums}
th,td{text-align:left;padding:.25rem .9rem .25rem 0;border-bottom:1px solid var(--line);vertical-align:top;
overflow-wrap:break-word}th{color:var(--dim);font-weight:600}td.number{white-space:nowrap}
.pictures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,22rem),1fr));gap:.8rem;margin:.8rem 0;
align-items:start}
img{width:100%;max-width:34rem;height:auto;background:#fff;border:1px solid var(--line);border-radius:.3rem}
summary{cursor:pointer;color:var(--dim)}
@media(max-width:40rem){table{font-size:.85rem}th,td{padding-right:.5rem}td{overflow-wrap:anywhere}}
"""
_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1">
<title>{title}</title><style>{style}</style></head>
<body><h1>{title}</h1>
<div class="verdict {colour}"><b>{verdict}</b><p>{sentence}</p></div>
{sections}
<p class="dim">Every number of this page stands in gap.json, unrounded.</p>
</body></html>
"""
Rows = Iterable[Sequence[str]]


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
    page = _PAGE.format(
        title=escape(title),
        style=_STYLE,
        colour=_COLOURS[gap.verdict],
        verdict=escape(VERDICTS[gap.verdict]),
        sentence=escape(gap.sentence),
        sections="\n".join(
            f"<section><h2>{heading}</h2>\n{text}\n{_images(figures, key)}</section>" for heading, key, text in sections
        ),
    )
    part = part_of(path)
    part.write_text(page, encoding="utf-8")
    part.replace(path)


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
        note += "<h3>Channels left out</h3>" + _table(("channel", "fault"), gap.channel_faults.items())
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
        + _table(("by", "largest", "share"), largest)
        + f"<details><summary>All shares</summary>{_table(('by', 'part', 'share'), every)}</details>"
    )


def _why(gap: Gap) -> str:
    rest, share = none_of_these(gap)
    causes = [(cause_name(c), percent(c.probability), number(c.left, 3)) for c in gap.causes]
    causes.append((rest, percent(share), number(gap.size, 3)))
    text = "" if gap.verdict == "effect" else "<p>No cause is accepted. What was tried:</p>"
    text += _table(("cause", "probability", "left"), causes)
    text += '<p class="dim">Left: what remains of the gap on the validation record, where nulls leave 1.</p>'
    details = [c for c in gap.causes if c.parameters or c.places]
    if details:
        text += "<h3>Parameters and places</h3><p>Value ± 1.96 standard errors: 95 % interval.</p>"
    for cause in details:
        rows = [*((what, interval(value)) for what, value in cause.parameters.items()), *cause.places.items()]
        text += _table((cause_name(cause), ""), rows)
    if gap.equivalent:
        text += "<h3>What this recording cannot tell apart</h3>"
        text += _list(" / ".join(names) for names in gap.equivalent)
    if gap.separate_by:
        text += "<h3>What would make it surer</h3>" + _list(gap.separate_by)
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
    text += _table(("validation record", "mean square"), [*rows, ("closed", closed(found))])
    if gap.likeness:
        text += "<h3>In familiar terms</h3><p>Simulated with the force of the measured record.</p>"
        text += _table(
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
    images = "".join(
        f'<img alt="{escape(name.replace("_", " "))}" src="data:image/png;base64,{b64encode(png).decode()}">\n'
        for name, png in figures.items()
        if name.split("_")[0] == section
    )
    return f'<div class="pictures">\n{images}</div>' if images else ""


def _list(items: Iterable[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"


def _table(head: Sequence[str], rows: Rows) -> str:
    """The first column, and cells of words, may break; a cell that begins with a figure does not."""
    said = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    body = "".join("<tr>" + "".join(map(_cell, row)) + "</tr>\n" for row in rows)
    return f'<div class="wide"><table><thead><tr>{said}</tr></thead><tbody>{body}</tbody></table></div>'


def _cell(text: str) -> str:
    kind = ' class="number"' if len(text) < 24 and text[:1] in "0123456789-<>(" and text else ""
    return f"<td{kind}>{escape(text)}</td>"
