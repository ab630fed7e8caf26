"""Date and sampling rate of a record as the header of its file states them, else the file's modification time."""

import re
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path

from rig.lab.column import decoded
from rig.lab.csv_text import TEXT_SUFFIXES, TextForm, lines_of, number_in

MAX_HEADER_LINES = 2000
MAX_LINE = 500
"""Characters of a line in which a date or rate is looked for."""
_MATLAB_HEAD_BYTES = 116
"""Bytes of the text at the beginning of a .mat file, which states when it was written."""
_MONTHS = {
    name: number
    for number, names in enumerate(
        ("jan", "feb", "mar mär mrz", "apr", "may mai", "jun", "jul", "aug", "sep", "oct okt", "nov", "dec dez"),
        start=1,
    )
    for name in names.split()
}
_MONTH = rf"(?P<month>{'|'.join(_MONTHS)})[a-zä]*\.?"
_YEAR_FIRST = re.compile(r"(?<!\d)(?P<year>\d{4})[-/.](?P<month>\d\d?)[-/.](?P<day>\d\d?)(?!\d)")
_DAY_FIRST = re.compile(r"(?<![\d.])(?P<day>\d\d?)\.(?P<month>\d\d?)\.(?P<year>\d{4})(?!\d)")
_EITHER = re.compile(r"(?<!\d)(?P<first>\d\d?)(?P<mark>[/-])(?P<second>\d\d?)(?P=mark)(?P<year>\d{4})(?!\d)")
_DAY_NAMED = re.compile(rf"(?<!\d)(?P<day>\d\d?)[-. ]+{_MONTH}[-, ]+(?P<year>\d{{4}}|\d\d)(?!\d)", re.IGNORECASE)
_CTIME = re.compile(rf"\b{_MONTH} +(?P<day>\d\d?),? +(?:\d\d?:\d\d:\d\d +)?(?P<year>\d{{4}})(?!\d)", re.IGNORECASE)
_TIME = re.compile(
    r"(?<![\d:])(?P<hour>\d\d?):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:[.,](?P<fraction>\d{1,9}))?)?"
    r"(?![\d:])\s*(?P<half>[AaPp]\.?[Mm])?"
)
_ZONE = re.compile(r"\s*(?P<zone>Z|UTC|[+-]\d\d:?\d\d)(?![\w:])")
_DATED = re.compile(
    r"date|datum|start|begin|record|aufge|messzeit|zeitpunkt|created|erstellt|acqui|\bt0\b", re.IGNORECASE
)
_TIMED = re.compile(r"^\W*(?:start|mess|trigger)?[ -]?(?:time|zeit|uhrzeit|startzeit)\b", re.IGNORECASE)
_RATE = re.compile(
    r"sampl\w*[ _-]*(?:rate|freq\w*)|abtast(?:rate|freq\w*)|messrate|scan[ _]?rate|\bfs\b|^\W*rate\b", re.IGNORECASE
)
_INTERVAL = re.compile(
    r"sampl\w*[ _-]*(?:interval|period|time)|abtast(?:intervall|zeit)|delta[ _]?[xt]\b|axis[ _]delta|\bdt\b|increment",
    re.IGNORECASE,
)
_NUMBER = re.compile(r"(?<![\w.,])[+-]?\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?")
_HZ = {"ghz": 1e9, "mhz": 1e6, "khz": 1e3, "hz": 1.0, "ms/s": 1e6, "ks/s": 1e3, "s/s": 1.0}
_S = {"ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "s": 1.0}


def recorded_date(source: Path, form: TextForm, stated: Iterable[str]) -> tuple[str, str]:
    """Date at which a record begins, as ISO text, and where it stands, in words.

    By the header, or what the channels have `stated`, if that can be read in one way only, else by the file's
    modification time.
    """
    lines = [*_head(source, form), *dict.fromkeys(text for text in stated if text)]
    date, doubtful = date_in(lines)
    if date is not None:
        saved = " (when it was saved)" if source.suffix.lower() == ".mat" else ""
        return date.isoformat(), f"the file's header{saved}" + ("" if date.tzinfo else ", which states no time zone")
    modified = datetime.fromtimestamp(source.stat().st_mtime, UTC).isoformat(timespec="seconds")
    reason = f"{doubtful!r} in its header is two dates" if doubtful else "its header states no date"
    return modified, f"the file's modification time, since {reason}"


def date_in(lines: Iterable[str]) -> tuple[datetime | None, str]:
    """Date and time in the lines of a header, and a text that may be either of two dates.

    Lines that are labelled as a date come first. The time of day may stand in the same line, or in one of its own.
    """
    header = [line[:MAX_LINE] for line in islice(lines, MAX_HEADER_LINES)]
    doubtful = ""
    for line in sorted(header, key=lambda text: not _DATED.search(text)):
        day, text = _day_in(line)
        doubtful = doubtful or text
        if day is not None:
            clock_lines = [line, *(other for other in header if _TIMED.search(other))]
            times = (match for text in clock_lines if (match := _TIME.search(text)))
            return _date_and_time(day, next(times, None)), doubtful
    return None, doubtful


def rate_in(rows: Sequence[Sequence[str]], decimal: str) -> float | None:
    """Sampling rate, Hz, stated in the cells of a header: a rate or an interval, beside or below its label."""
    for row_number, row in enumerate(rows):
        for k, cell in enumerate(row):
            for pattern, units in ((_RATE, _HZ), (_INTERVAL, _S)):
                if not (match := pattern.search(cell[:MAX_LINE])):
                    continue
                below = (
                    [rows[row_number + 1][k]] if row_number + 1 < len(rows) and k < len(rows[row_number + 1]) else []
                )
                for text in (cell[match.end() : MAX_LINE], *row[k + 1 : k + 3], *below):
                    value = _quantity_in(text, f"{cell[match.end() :]} {' '.join(row[k + 1 : k + 3])}", units, decimal)
                    if value is not None and 0 < value < 1e12:
                        return value if units is _HZ else float(f"{1 / value:.9g}")
    return None


def _quantity_in(text: str, unit_text: str, units: dict[str, float], decimal: str) -> float | None:
    """Number in a text times its unit, which stands behind it or somewhere in unit_text."""
    match = _NUMBER.search(text)
    if match is None:
        return None
    value = number_in(match[0], decimal)
    if value is None:
        value = number_in(match[0].replace(",", "."), ".")
    words = re.findall(r"[a-zµ/]+", f"{text[match.end() :]} {unit_text}"[:MAX_LINE].lower())
    return None if value is None else value * next((units[word] for word in words if word in units), 1.0)


def _day_in(line: str) -> tuple[tuple[int, int, int] | None, str]:
    """Year, month and day in a line, and a text of two readings."""
    for pattern in (_YEAR_FIRST, _DAY_FIRST, _DAY_NAMED, _CTIME):
        if match := pattern.search(line):
            month = match["month"].lower()
            year = int(match["year"])
            year += (1900 if year >= 70 else 2000) if year < 100 else 0
            day = (year, int(month) if month.isdigit() else _MONTHS[month], int(match["day"]))
            if _is_date(day):
                return day, ""
    if match := _EITHER.search(line):
        first, second, year = int(match["first"]), int(match["second"]), int(match["year"])
        days = {day for day in ((year, first, second), (year, second, first)) if _is_date(day)}
        if len(days) == 1:
            return days.pop(), ""
        return None, match[0] if days else ""
    return None, ""


def _is_date(day: tuple[int, int, int]) -> bool:
    try:
        return 1970 <= datetime(*day, tzinfo=UTC).year < 2200
    except ValueError:
        return False


def _date_and_time(day: tuple[int, int, int], time: re.Match[str] | None) -> datetime:
    """Date and time of day; the date alone if the time is none."""
    if time is None:
        return datetime(*day)
    hour = int(time["hour"])
    if time["half"]:
        hour = hour % 12 + (12 if time["half"][0] in "pP" else 0)
    microsecond = int((time["fraction"] or "0").ljust(6, "0")[:6])
    zone = _ZONE.match(time.string, time.end())
    try:
        date = datetime(*day, hour, int(time["minute"]), int(time["second"] or 0), microsecond)
        if zone is None:
            return date
        return date.replace(tzinfo=datetime.strptime(zone["zone"].replace("UTC", "Z"), "%z").tzinfo)
    except ValueError:
        return datetime(*day)


def _head(source: Path, form: TextForm) -> list[str]:
    """Lines at the beginning of a file that may state its date; none of a format whose channels state it."""
    suffix = source.suffix.lower()
    if suffix == ".mat":
        with source.open("rb") as stream:
            return [decoded(stream.read(_MATLAB_HEAD_BYTES))]
    if suffix not in TEXT_SUFFIXES:
        return []
    count = form.lines_before_names + form.lines_after_names + 2
    return list(islice(lines_of(source, form.encoding), min(count, MAX_HEADER_LINES)))
