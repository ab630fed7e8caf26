"""Date and sampling rate of a record as the header of its file states them, else the file's modification time."""

import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from itertools import islice, zip_longest
from pathlib import Path
from typing import TypeGuard

import numpy as np

from rig.lab.column import utf8_or_latin1_text
from rig.lab.csv_text import TEXT_SUFFIXES, TextForm, finite_number_or_none, lines_of

MAX_HEADER_LINES = 2000
MAX_LINE_LENGTH = 500
"""Characters of a line in which a date or rate is looked for."""
_MATLAB_HEAD_BYTES = 116
"""Bytes of the text at the beginning of a .mat file, which states when it was written."""
_MONTH_NAMES = ("jan", "feb", "mar mär mrz", "apr", "may mai", "jun", "jul", "aug", "sep", "oct okt", "nov", "dec dez")
_MONTH_NUMBERS = {name: number for number, names in enumerate(_MONTH_NAMES, start=1) for name in names.split()}
_MONTH_TEXT = rf"(?P<month>{'|'.join(_MONTH_NUMBERS)})[a-zä]*\.?"
_YEAR_FIRST = re.compile(r"(?<!\d)(?P<year>\d{4})[-/.](?P<month>\d\d?)[-/.](?P<day>\d\d?)(?!\d)")
_DAY_FIRST = re.compile(r"(?<![\d.])(?P<day>\d\d?)\.(?P<month>\d\d?)\.(?P<year>\d{4})(?!\d)")
_EITHER_ORDER = re.compile(r"(?<!\d)(?P<first>\d\d?)(?P<mark>[/-])(?P<second>\d\d?)(?P=mark)(?P<year>\d{4})(?!\d)")
_DAY_NAMED = re.compile(rf"(?<!\d)(?P<day>\d\d?)[-. ]+{_MONTH_TEXT}[-, ]+(?P<year>\d{{4}}|\d\d)(?!\d)", re.IGNORECASE)
_CTIME = re.compile(rf"\b{_MONTH_TEXT} +(?P<day>\d\d?),? +(?:\d\d?:\d\d:\d\d +)?(?P<year>\d{{4}})(?!\d)", re.IGNORECASE)
_TIME_OF_DAY = re.compile(
    r"(?<![\d:])(?P<hour>\d\d?):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:[.,](?P<fraction>\d{1,9}))?)?"
    r"(?![\d:])\s*(?P<half>[AaPp]\.?[Mm])?"
)
_ZONE_PATTERN = re.compile(r"\s*(?P<zone>Z|UTC|[+-]\d\d:?\d\d)(?![\w:])")
_DATE_LABEL = re.compile(
    r"date|datum|start|begin|record|aufge|messzeit|zeitpunkt|created|erstellt|acqui|\bt0\b", re.IGNORECASE
)
_TIME_LABEL = re.compile(r"^\W*(?:start|mess|trigger)?[ -]?(?:time|zeit|uhrzeit|startzeit)\b", re.IGNORECASE)
_UNIT_END = r"(?:[ _(\[]*(?:s|sec|ms|us|µs|ns|k?hz)[)\]]*)?\W*$"
_RATE_LABEL = re.compile(
    r"sampl\w*[ _-]*(?:rate|freq\w*)|abtast(?:rate|freq\w*)|messrate|scan[ _]?rate|\bfs\b|^\W*rate\b"
    rf"|^\W*(?:s[ _]?freq|s[ _]?rate|sr|f[ _]s|f[ _]?sampl?e?){_UNIT_END}",
    re.IGNORECASE,
)
_INTERVAL_LABEL = re.compile(
    r"sampl\w*[ _-]*(?:interval|period|time)|abtast(?:intervall|zeit)|delta[ _]?[xt]\b|axis[ _]delta|\bdt\b|increment"
    rf"|^\W*(?:isi|ts|dx|x[ _]?inc\w*|h[ _]?resolution|(?:t[ _]?)?interval|period|time[ _]?step|t[ _]?step){_UNIT_END}",
    re.IGNORECASE,
)
_START_LABEL = re.compile(
    r"^\W*(?:start|(?:start|begin)[ _]?(?:time|value)|[tx][ _]?0|[tx][ _]?start|x[ _]?min(?:imum)?"
    rf"|(?:x|t|time|h)[ _]?offset){_UNIT_END}",
    re.IGNORECASE,
)
_START_SAMPLE_LABEL = re.compile(r"^\W*start[ _]?(?:sample|index)\W*$", re.IGNORECASE)
_SAMPLES_BEFORE_LABEL = re.compile(r"^\W*pre[ _]?(?:sample|trigger)[ _]?(?:count|samples?)?\W*$", re.IGNORECASE)
_WORD_START = re.compile(r"(?<=[a-z0-9])(?=[A-Z])(?!Hz)|_")
_NUMBER_PATTERN = re.compile(r"(?<![\w.,])[+-]?\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?")
_HZ_BY_UNIT = {"ghz": 1e9, "mhz": 1e6, "khz": 1e3, "hz": 1.0, "ms/s": 1e6, "ks/s": 1e3, "s/s": 1.0}
_S_BY_UNIT = {"ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "s": 1.0}


def recorded_date(source: Path, form: TextForm, stated_dates: Iterable[str]) -> tuple[str, str]:
    """Date at which a record begins, as ISO text, and where it stands, in words.

    By the header, or the `stated_dates` of the channels, if that can be read in one way only, else by the file's
    modification time.
    """
    date_lines = [*_header_lines(source, form), *dict.fromkeys(text for text in stated_dates if text)]
    header_date, doubtful_text = date_and_ambiguous_text(date_lines)
    if header_date is not None:
        saving_note = " (when it was saved)" if source.suffix.lower() == ".mat" else ""
        zone_note = "" if header_date.tzinfo else ", which states no time zone"
        return header_date.isoformat(), f"the file's header{saving_note}{zone_note}"
    modification_date = datetime.fromtimestamp(source.stat().st_mtime, UTC).isoformat(timespec="seconds")
    reason = f"{doubtful_text!r} in its header is two dates" if doubtful_text else "its header states no date"
    return modification_date, f"the file's modification time, since {reason}"


def date_and_ambiguous_text(lines: Iterable[str]) -> tuple[datetime | None, str]:
    """Date and time in the lines of a header, and a text that may be either of two dates.

    Lines that are labelled as a date come first. The time of day may stand in the same line, or in one of its own.
    """
    header_lines = [line[:MAX_LINE_LENGTH] for line in islice(lines, MAX_HEADER_LINES)]
    doubtful_text = ""
    for line in sorted(header_lines, key=lambda doubt: not _DATE_LABEL.search(doubt)):
        year_month_day, doubt = _day_and_ambiguous_text(line)
        doubtful_text = doubtful_text or doubt
        if year_month_day is not None:
            clock_lines = [line, *(other_line for other_line in header_lines if _TIME_LABEL.search(other_line))]
            time_matches = (match for doubt in clock_lines if (match := _TIME_OF_DAY.search(doubt)))
            return _date_and_time(year_month_day, next(time_matches, None)), doubtful_text
    return None, doubtful_text


def stated_sampling_rate_hz(header_rows: Sequence[Sequence[str]], decimal: str) -> float | None:
    """Sampling rate, Hz, stated in the cells of a header: a rate or an interval, beside or below its label."""
    for row, next_row in zip_longest(header_rows, header_rows[1:], fillvalue=()):
        for k, cell in enumerate(row):
            for label_pattern, factor_by_unit in ((_RATE_LABEL, _HZ_BY_UNIT), (_INTERVAL_LABEL, _S_BY_UNIT)):
                if not (match := label_pattern.search(cell[:MAX_LINE_LENGTH])):
                    continue
                text_behind, cells_beside, cells_below = cell[match.end() :], row[k + 1 : k + 3], next_row[k : k + 1]
                for text in (cell[match.end() : MAX_LINE_LENGTH], *cells_beside, *cells_below):
                    value = _quantity_in(text, f"{text_behind} {' '.join(cells_beside)}", factor_by_unit, decimal)
                    if value is not None and 0 < value < 1e12:
                        return value if factor_by_unit is _HZ_BY_UNIT else float(f"{1 / value:.9g}")
    return None


def stated_clock(fields: Mapping[str, object]) -> tuple[float | None, float | None]:
    """Sampling rate (Hz) and time of the first sample (s) that fields of these names state; None where none does.

    A unit stands in the name ("dt_ms"), the value ("5.12 kHz") or a field of its own ("isi_units"). The time is
    counted from any zero, or from 1970 where it is a date; numbers of samples before the zero count with the rate.
    """
    texts = {_WORD_START.sub(" ", name): _field_text(value) for name, value in fields.items()}
    rate_hz = next(filter(None, (_rate_in(label, text, texts) for label, text in texts.items())), None)
    starts_s = (_start_in(label, text, texts, rate_hz) for label, text in texts.items())
    return rate_hz, next((start_s for start_s in starts_s if start_s is not None), None)


def _field_text(value: object) -> str:
    return value[:MAX_LINE_LENGTH] if isinstance(value, str) else repr(float(value)) if is_real(value) else ""


def is_real(value: object) -> TypeGuard[float]:
    """True if a value is a finite real number."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool) and bool(np.isfinite(value))


def _rate_in(label: str, text: str, texts: Mapping[str, str]) -> float | None:
    for label_pattern, factor_by_unit in ((_RATE_LABEL, _HZ_BY_UNIT), (_INTERVAL_LABEL, _S_BY_UNIT)):
        if match := label_pattern.search(label):
            value = _quantity_in(text, _unit_text(label, match.start(), texts), factor_by_unit, ".")
            if value is not None and 0 < value < 1e12:
                return value if factor_by_unit is _HZ_BY_UNIT else float(f"{1 / value:.9g}")
    return None


def _start_in(label: str, text: str, texts: Mapping[str, str], rate_hz: float | None) -> float | None:
    if _START_LABEL.search(label):
        if (date := date_and_ambiguous_text([text])[0]) is not None:
            return date.replace(tzinfo=date.tzinfo or UTC).timestamp()
        return _quantity_in(text, _unit_text(label, 0, texts), _S_BY_UNIT, ".")
    sample_sign = 1 if _START_SAMPLE_LABEL.search(label) else -1 if _SAMPLES_BEFORE_LABEL.search(label) else 0
    sample_count = _quantity_in(text, "", {}, ".") if sample_sign and rate_hz else None
    return None if sample_count is None or not rate_hz else sample_sign * sample_count / rate_hz


def _unit_text(label: str, label_start: int, texts: Mapping[str, str]) -> str:
    """Words among which the unit of a field stands: its label and the field of its unit."""
    return " ".join([texts.get(f"{label} units", ""), texts.get(f"{label} unit", ""), label[label_start:]])


def _quantity_in(text: str, unit_text: str, factor_by_unit: dict[str, float], decimal: str) -> float | None:
    """Number in a text times its unit, which stands behind it or somewhere in unit_text."""
    match = _NUMBER_PATTERN.search(text)
    if match is None:
        return None
    number = finite_number_or_none(match[0], decimal)
    if number is None:
        number = finite_number_or_none(match[0].replace(",", "."), ".")
    unit_words = re.findall(r"[a-zµ/]+", f"{text[match.end() :]} {unit_text}"[:MAX_LINE_LENGTH].lower())
    unit_factor = next((factor_by_unit[word] for word in unit_words if word in factor_by_unit), 1.0)
    return None if number is None else number * unit_factor


def _day_and_ambiguous_text(line: str) -> tuple[tuple[int, int, int] | None, str]:
    """Year, month and day in a line, and a text of two readings."""
    for date_pattern in (_YEAR_FIRST, _DAY_FIRST, _DAY_NAMED, _CTIME):
        if match := date_pattern.search(line):
            month = match["month"].lower()
            year = int(match["year"])
            year += (1900 if year >= 70 else 2000) if year < 100 else 0
            year_month_day = (year, int(month) if month.isdigit() else _MONTH_NUMBERS[month], int(match["day"]))
            if _is_valid_date(year_month_day):
                return year_month_day, ""
    if match := _EITHER_ORDER.search(line):
        first_number, second_number, year = int(match["first"]), int(match["second"]), int(match["year"])
        valid_days = set(
            filter(_is_valid_date, ((year, first_number, second_number), (year, second_number, first_number)))
        )
        if len(valid_days) == 1:
            return valid_days.pop(), ""
        return None, match[0] if valid_days else ""
    return None, ""


def _is_valid_date(year_month_day: tuple[int, int, int]) -> bool:
    try:
        return 1970 <= datetime(*year_month_day, tzinfo=UTC).year < 2200
    except ValueError:
        return False


def _date_and_time(year_month_day: tuple[int, int, int], time_match: re.Match[str] | None) -> datetime:
    """Date and time of day; the date alone if the time is none."""
    if time_match is None:
        return datetime(*year_month_day)
    hour = int(time_match["hour"])
    if time_match["half"]:
        hour = hour % 12 + (12 if time_match["half"][0] in "pP" else 0)
    microsecond = int((time_match["fraction"] or "0").ljust(6, "0")[:6])
    zone_match = _ZONE_PATTERN.match(time_match.string, time_match.end())
    try:
        date = datetime(*year_month_day, hour, int(time_match["minute"]), int(time_match["second"] or 0), microsecond)
        if zone_match is None:
            return date
        return date.replace(tzinfo=datetime.strptime(zone_match["zone"].replace("UTC", "Z"), "%z").tzinfo)
    except ValueError:
        return datetime(*year_month_day)


def _header_lines(source: Path, form: TextForm) -> list[str]:
    """Lines at the beginning of a file that may state its date; none of a format whose channels state it."""
    suffix = source.suffix.lower()
    if suffix == ".mat":
        with source.open("rb") as stream:
            return [utf8_or_latin1_text(stream.read(_MATLAB_HEAD_BYTES))]
    if suffix not in TEXT_SUFFIXES:
        return []
    line_count = form.lines_before_names + form.lines_after_names + 2
    return list(islice(lines_of(source, form.encoding), min(line_count, MAX_HEADER_LINES)))
