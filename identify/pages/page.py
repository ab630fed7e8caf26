"""Self-contained page: one HTML file with its style and its pictures, readable on a phone, light or dark."""

import re
import sys
from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Literal

from identify.pages.interactive import bokeh_script, interactive_html
from identify.pages.style import Picture
from rig.files import sha256_of, write_bytes

Colour = Literal["green", "yellow", "red"]
Rows = Iterable[Sequence[str]]
FIRST_PLOT_PX = 440
"""Height of the plot on the first screen, of 800 pixels with title, verdict and what to do next. Display."""
PAPER_PX = 870
"""Width of a printed page, below those of A4 and letter in a browser: plots keep the size of the screen in print, and
are made smaller by the ratio of the widths, so that none is cut. Display."""
SHOWN_DIGITS = 12
"""Digits of the SHA-256 of a recording that a page shows."""

_UNIT = re.compile(r"(\d) (?=(?:N|mm|m|kg|g|Hz|s|ms|dB)\b|[%±])")
_OPTION = re.compile(r"--[a-z-]+")
_BEFORE_NUMBER = re.compile(r"(\bp|\w(?= =)|[=±]|&[lg]t;) (?=[\d=&])")
_STYLE = """
:root{color-scheme:light dark;--ink:#1c1e21;--dim:#5b6168;--page:#fff;--line:#d8dce0;--card:#f4f6f8;
--green:#1d7a48;--yellow:#9a6400;--red:#b3321f;--found:#1f5fa8;--cause:#b3411b}
@media(prefers-color-scheme:dark){:root{--ink:#e6e8ea;--dim:#a2a9b0;--page:#16181b;--line:#3a3f45;--card:#202327;
--green:#5cc48c;--yellow:#e0ac4a;--red:#f0806c;--found:#86b8ee;--cause:#f29a72}}
*{box-sizing:border-box}
body{margin:0 auto;padding:1rem;max-width:76rem;background:var(--page);color:var(--ink);
font:16px/1.5 system-ui,sans-serif;overflow-wrap:anywhere}
h1{font-size:1.4rem;margin:.2rem 0}h2{font-size:1.2rem;margin:2.2rem 0 .5rem;border-bottom:1px solid var(--line)}
h3{font-size:1rem;margin:1.2rem 0 .3rem}p{margin:.4rem 0}ul{margin:.3rem 0;padding-left:1.2rem}
.verdict{background:var(--card);border-left:.4rem solid;padding:.7rem 1rem;margin:.8rem 0}
.verdict b{display:block;font-size:.85rem;text-transform:uppercase;letter-spacing:.04em}
.verdict p{color:var(--ink)}.verdict b+p{font-size:1.15rem}.green{color:var(--green)}.yellow{color:var(--yellow)}
.red{color:var(--red)}.dim{color:var(--dim);font-size:.9rem}
.wide{overflow-x:auto}.wide+.wide{margin-top:.8rem}
table{border-collapse:collapse;font-size:.92rem;font-variant-numeric:tabular-nums}
th,td{text-align:left;padding:.25rem .9rem .25rem 0;border-bottom:1px solid var(--line);vertical-align:top;
overflow-wrap:break-word}th{color:var(--dim);font-weight:600}td.number,.option{white-space:nowrap}
.pictures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,22rem),1fr));gap:.8rem;margin:.8rem 0;
align-items:start}
img{width:100%;max-width:34rem;height:auto;background:#fff;border:1px solid var(--line);border-radius:.3rem}
figure{margin:1rem 0}figure div{overflow-x:auto}figure img{max-width:46rem;min-width:30rem;display:block}
.pictures figure img{min-width:0}
figcaption{color:var(--dim);font-size:.9rem;margin-top:.2rem}
summary{cursor:pointer;color:var(--dim)}
.folded>summary{margin-top:1.1rem;color:var(--ink);border-bottom:1px solid var(--line)}
.folded h2{display:inline;border:0}
.first{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,30rem),1fr));gap:0 1.6rem}
.first figure{margin:.2rem 0}.first h2{margin-top:1rem}.first figure img{min-width:0}
.machine{width:100%;height:auto;max-height:25rem}.narrow{display:none}.narrow .machine{max-height:none}
.key{display:flex;flex-wrap:wrap;gap:0 1rem;list-style:none;padding:0;color:var(--dim);font-size:.9rem}
.key li{display:flex;align-items:center;gap:.3rem}.key .machine{width:2.2rem;flex:none}
.machine text{font-size:14px;fill:var(--ink);paint-order:stroke;stroke:var(--page);stroke-width:4px}
.machine .name{font-weight:600}.machine .value{fill:var(--found)}
.machine .ruler{font-size:12px;stroke:none}.machine .origin{fill:var(--ink)}
.machine .dim{fill:var(--dim)}.machine path{fill:none;stroke:var(--ink);stroke-width:1.8}
.machine .thin{stroke-width:1}
.machine .fork,.machine .found{stroke-width:2.4}.machine .found{stroke:var(--found)}
.machine .force{stroke:var(--dim);stroke-width:2.4}
.machine .sensor{fill:var(--page);stroke:var(--dim);stroke-width:1.2}
.machine .body{fill:var(--line);stroke:var(--ink)}
.machine .mark{fill:none;stroke:var(--cause);stroke-width:2.4}
.machine .hint{stroke:var(--dim);stroke-width:1.6;stroke-dasharray:4 3}
.machine .mark-words{fill:var(--cause);font-weight:600}
@media print{body{max-width:none}h2,h3,summary{break-after:avoid}.plot,figure,tr{break-inside:avoid}
.plot{zoom:var(--shrink,1)}.first .plot{zoom:var(--shrink-first,1)}.first{display:block}
table{font-size:.8rem}.wide{overflow:visible}td.number{white-space:normal}}
@media(max-width:40rem){.narrow{display:block}.broad{display:none}table{font-size:.8rem}th,td{padding-right:.4rem;hyphens:auto}td.number{white-space:normal}}
"""
_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1">
<title>{title}</title><style>{style}</style>{script}</head>
<body><main><h1>{title}</h1>
<div class="verdict {colour}"><b>{verdict}</b>{sentences}</div>
{content}
<p class="dim">{foot}</p></main>
<script>addEventListener("beforeprint",()=>(document.querySelectorAll(".folded").forEach(one=>one.open=true),
[["--shrink","main"],["--shrink-first",".first .plot"]].forEach(([name,part])=>document.body.style.setProperty(name,
Math.min(1,{paper_px}/(document.querySelector(part)?.clientWidth||1))))))</script>
</body></html>
"""


@dataclass(frozen=True)
class Answer:
    """Answer that a page begins with: its colour, a verdict of few words, a sentence, and smaller ones below it."""

    colour: Colour
    verdict: str
    sentences: Sequence[str]


def write(
    path: Path,
    *,
    title: str,
    answer: Answer,
    sections: Iterable[tuple[str, str]],
    foot_text: str,
    sources: Sequence[Path] = (),
    top_blocks: Iterable[str] = (),
    folded_sections: Iterable[tuple[str, str]] = (),
) -> None:
    """Write a page that needs no other file: to a temporary file, which is then renamed.

    `top_blocks` stand side by side below the verdict, as far as there is room. A section is its heading and its HTML,
    and folded ones open by a click, or for the printer; everything else is plain text. Below the foot stand date,
    version, command, whose paths may break behind a slash, and the source recordings with the first digits of their
    SHA-256.
    """
    content_html = "".join(f"<div>{block_html}</div>" for block_html in top_blocks if block_html)
    content_html = f'<div class="first">{content_html}</div>\n' if content_html else ""
    content_html += "\n".join(
        f"<section><h2>{escape(heading)}</h2>\n{block_html}</section>" for heading, block_html in sections
    )
    for heading, block_html in folded_sections:
        content_html += (
            f'\n<details class="folded"><summary><h2>{escape(heading)}</h2></summary>\n{block_html}</details>'
        )
    page_html = _PAGE.format(
        script=bokeh_script() if "Bokeh.embed" in content_html else "",
        title=escape(title),
        style=_STYLE,
        paper_px=PAPER_PX,
        colour=answer.colour,
        verdict=escape(answer.verdict),
        sentences="".join(f"<p>{unbroken_html(escape(sentence))}</p>" for sentence in answer.sentences),
        content=content_html,
        foot=f"{escape(foot_text)}<br>{escape(_provenance(sources)).replace('/', '/<wbr>')}",
    )
    write_bytes(page_html.encode(), path)


def _provenance(sources: Sequence[Path]) -> str:
    """Sentence on date, version, command and source recordings."""
    source_hashes = (f"{path.name} {sha256_of(path)[:SHOWN_DIGITS]}" for path in sources)
    command = " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])
    provenance_parts = (f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC", f"rig-identify {version('rig-identify')}", command)
    return "Made " + ", ".join([*provenance_parts, *source_hashes]) + "."


def picture(name: str, png: bytes) -> str:
    """HTML of a PNG file within the page, with its name as the alternative text."""
    return f'<img alt="{escape(name.replace("_", " "))}" src="data:image/png;base64,{b64encode(png).decode()}">\n'


def figure(name: str, image: Picture, caption: str = "", height_px: int | None = None) -> str:
    """HTML of an interactive plot, of this height in a column, or else of a picture, with its caption below."""
    plot_html = interactive_html(image.figure, height_px) or f'<div tabindex="0">{picture(name, image.png)}</div>'
    caption_html = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f"<figure>{plot_html}{caption_html}</figure>\n"


def list_html(texts: Iterable[str]) -> str:
    """HTML of a list."""
    return "<ul>" + "".join(f"<li>{unbroken_html(escape(text))}</li>" for text in texts) + "</ul>"


def unbroken_html(html: str) -> str:
    """Text whose options stay whole, numbers on a line with unit and interval, and with "p =" and "<" before them."""
    html = _OPTION.sub(r"<span class='option'>\g<0></span>", html)
    return _UNIT.sub("\\1\u00a0", _BEFORE_NUMBER.sub("\\1\u00a0", html)).replace("N s/m", "N\u00a0s/m")


def table(headings: Sequence[str], rows: Rows) -> str:
    """HTML of a table. The first column and cells of words may break, a cell that begins with a number does not."""
    header_html = "".join(f"<th>{escape(cell)}</th>" if cell else "<td></td>" for cell in headings)
    body_html = "".join("<tr>" + "".join(map(_cell, row)) + "</tr>\n" for row in rows)
    table_html = f"<table><thead><tr>{header_html}</tr></thead><tbody>{body_html}</tbody></table>"
    return f'<div class="wide" tabindex="0">{table_html}</div>'


def _cell(text: str) -> str:
    class_attribute = ' class="number"' if len(text) < 24 and text[:1] in "0123456789-<>(" and text else ""
    cell_html = re.sub(r" (?=%)|(?<=^&[lg]t;) ", "\u00a0", escape(text))
    return f"<td{class_attribute}>{cell_html}</td>"
