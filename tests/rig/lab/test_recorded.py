"""Dates and rates as the headers of loggers write them."""

from datetime import UTC, datetime, timedelta, timezone

import pytest

from rig.lab.recorded import date_and_ambiguous_text, stated_sampling_rate_hz

DATE = datetime(2024, 3, 1, 14, 5, 6)


@pytest.mark.parametrize(
    ("lines", "date"),
    [
        (["Start time: 2024-03-01 14:05:06"], DATE),
        (["Start time: 2024-03-01T14:05:06Z"], DATE.replace(tzinfo=UTC)),
        (["Start: 2024-03-01T14:05:06+01:00"], DATE.replace(tzinfo=timezone(timedelta(hours=1)))),
        (["T0 = 01.03.2024 14:05:06,250"], DATE.replace(microsecond=250000)),
        (["Datum: 1. März 2024", "Uhrzeit: 14:05:06"], DATE),
        (["Date\t2024/03/01", "Time\t14:05:06"], DATE),
        (["Date: 01-Mar-24 2:05:06 PM"], DATE),
        (["MATLAB 5.0 MAT-file, Platform: GLNXA64, Created on: Fri Mar  1 14:05:06 2024"], DATE),
        (["calibrated 2020-01-01", "Recording started 2024-03-01 14:05:06"], DATE),
        (["3/14/2024 12:00:00 AM"], datetime(2024, 3, 14)),
        (["Date: 2024-03-01"], datetime(2024, 3, 1)),
        (["version 1.2.2024", "serial 2024-99-99"], datetime(2024, 2, 1)),
        (["0.125,0.25,1.5", "1904-01-01 00:00:00", "2024-02-30"], None),
    ],
)
def test_the_date_of_a_header(lines, date):
    assert date_and_ambiguous_text(lines) == (date, "")


def test_a_date_of_two_readings_is_none():
    assert date_and_ambiguous_text(["Date: 3/1/2024 14:05:06"]) == (None, "3/1/2024")
    assert date_and_ambiguous_text(["Date: 3/3/2024 14:05:06"])[0] == datetime(2024, 3, 3, 14, 5, 6)


@pytest.mark.parametrize(
    ("rows", "rate_hz"),
    [
        ([["Sample rate: 5000"]], 5000.0),
        ([["Sampling rate", "5,12 kHz"]], 5120.0),
        ([["Abtastrate [kHz]", "5,12"]], 5120.0),
        ([["X-axis delta:", "1.953125e-03"]], 512.0),
        ([["Sample Interval", "4e-06"]], 250000.0),
        ([["Sampling period (ms)", "0.5"]], 2000.0),
        ([["X", "Start", "Increment"], ["Sequence", "0", "0.002"]], 500.0),
        ([["fs = 1024 Hz"]], 1024.0),
        ([["Heart rate", "60"], ["Samples", "1000"]], None),
        ([["Sample rate", "unknown"]], None),
    ],
)
def test_the_rate_of_a_header(rows, rate_hz):
    assert stated_sampling_rate_hz(rows, ",") == rate_hz
