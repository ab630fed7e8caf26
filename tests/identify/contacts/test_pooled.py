"""Long records: identified segment by segment, and pooled."""

import os

import msgspec
import numpy as np
import pytest

from identify.contacts.pooled import (
    LARGE_FILE_BYTES,
    identify_by_segments,
    pooled_estimate,
    pooled_report,
    segment_length_within_memory_s,
)
from identify.contacts.results import Estimate
from rig.errors import RigError
from rig.model.tolerances import EXACT, LABORATORY
from rig.recording import channel_groups, writing
from rig.simulation.reference import BarrelCradle, Sdof

pytestmark = pytest.mark.long


@pytest.mark.parametrize("shared", [0.0, 0.8, 3.0])
def test_pooled_intervals_cover(shared):
    """A part of the error is shared by all segments; the estimates' own errors hold both parts."""
    rng = np.random.default_rng(3)
    covered = []
    for _ in range(2000):
        own_errors = rng.uniform(0.5, 2.0, 40)
        values = 7 + shared * rng.standard_normal() + own_errors * rng.standard_normal(40)
        estimate = pooled_estimate(
            [Estimate(v, float(np.hypot(shared, o))) for v, o in zip(values, own_errors, strict=True)]
        )
        covered.append(abs(estimate.value - 7) < 1.96 * estimate.standard_error)
    assert np.mean(covered) > 0.94


def test_what_scatters_more_than_it_should_is_less_certain():
    quiet, loud = (pooled_estimate([Estimate(5 + s, 0.1) for s in (-size, 0, size, 0)]) for size in (0.1, 1.0))
    assert loud.standard_error > 3 * quiet.standard_error
    assert pooled_estimate([Estimate(5.0, 0.1)]) == Estimate(5.0, 0.1)


@pytest.mark.parametrize(
    ("tolerances", "relative_error"), [pytest.param(EXACT, 1e-5, marks=pytest.mark.study), (LABORATORY, 1e-3)]
)
def test_a_long_record_in_segments(one_mass, tolerances, relative_error):
    report, segments = identify_by_segments(one_mass, segment_s=200.0, use="displacement", tolerances=tolerances)
    assert [round(p.start_s) for p in segments] == [0, 212, 412, 612]
    assert segments[-1].end_s == pytest.approx(825.0)
    (contact,) = report.contacts
    truth = Sdof()
    for estimate, true in (
        (contact.clearance_m, truth.clearance_m),
        (contact.stiffness_n_per_m, truth.stiffness_n_per_m),
    ):
        assert estimate.value == pytest.approx(true, rel=relative_error)
        if tolerances == LABORATORY:  # else the step of the simulation is the larger error
            assert abs(estimate.value - true) < 4 * estimate.standard_error
    assert sum(n.averages for p in segments for n in p.report.nifo) == report.nifo[0].averages
    assert msgspec.convert(msgspec.to_builtins(report), type(report)) == report


@pytest.mark.study
def test_accelerometers_in_motion_tell_as_much(simulate, tmp_path):
    settings = BarrelCradle(sensors="acceleration", noise_density=1e-3, duration_s=58.0, step_s=2.0**-13)
    path = simulate(settings, tmp_path / "long.mcap")
    report, segments = identify_by_segments(path, segment_s=24.0)
    assert len(segments) == 2
    for each_report in (*(s.report for s in segments), report):
        for contact in each_report.contacts:
            assert contact.clearance_m.value == pytest.approx(5e-3, rel=2e-3)
            assert contact.stiffness_n_per_m.value == pytest.approx(1e5, rel=1e-2)
            assert abs(contact.clearance_m.value - 5e-3) < 3 * contact.clearance_m.standard_error


def test_a_contact_that_one_segment_tells_is_answered(simulate, tmp_path):
    path = simulate(Sdof(duration_s=30.0, step_s=2.0**-12), tmp_path / "short.mcap")
    determined, _ = identify_by_segments(path, segment_s=40.0)
    silent = msgspec.structs.replace(determined, contacts=(), unanswered=({"name": "stop", "reason": "open"},))
    silent = msgspec.convert(msgspec.to_builtins(silent), type(determined))
    both = pooled_report([silent, determined])
    assert [c.name for c in both.contacts] == ["stop"]
    assert both.unanswered == ()
    assert pooled_report([silent]).unanswered == silent.unanswered


def test_bad_segments_are_refused(one_mass, tmp_path):
    for length in (-1.0, 0.0, np.nan, np.inf):
        with pytest.raises(RigError, match="10 s or more"):
            identify_by_segments(one_mass, segment_s=length)
    with pytest.raises(RigError, match="cannot be opened"):
        identify_by_segments(tmp_path / "none.mcap", segment_s=10.0)


@pytest.mark.parametrize(
    ("rate_hz", "length_s"), [(512.0, 40.0), (4096.0, 40.0), (1e5, 19.8), (2e5, None), (1e6, None)]
)
def test_segments_take_no_more_memory_than_their_file_may(tmp_path, rate_hz, length_s):
    """Of 128 MiB: 1374 MB (rig/limits.py), a segment with 12 s in front and half of it behind being copied 18 times."""
    path, rig = tmp_path / "r.mcap", Sdof(sensors="displacement").rig()
    rig = msgspec.structs.replace(rig, sample_rate_hz=rate_hz)
    with writing(path, rig, channel_groups(rig), {}) as recording:
        recording.append_all({name: np.ones((1, 2048)) for name in channel_groups(rig)})
    os.truncate(path, 2 * LARGE_FILE_BYTES)  # as a long record: what is asked for stands in front
    if length_s is None:
        with pytest.raises(RigError, match="MB a second, of which 22 s at once take more memory than 1374 MB; sample"):
            segment_length_within_memory_s(path)
    else:
        assert segment_length_within_memory_s(path) == pytest.approx(length_s, rel=1e-2)
