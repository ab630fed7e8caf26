"""The studies of NIFO: the record is worked on in pieces, as if it were one; the tables and figures."""

import numpy as np
import pytest
from msgspec.structs import replace

from scenarios import excitation_sweep, frequency_resolution, nifo_study
from scenarios.nifo_study import LONG, Study, estimated, needed_s
from scenarios.nifo_sweep import Point, shown

STUDY = Study(settings=LONG, block_s=(1.0, 2.5))


@pytest.fixture(scope="module")
def outcome():
    return estimated(STUDY)


def test_the_paper_needs_24_600_s_for_its_finest_resolution():
    assert needed_s(1200.0) == 24_600.0


def test_pieces_join_without_a_seam(monkeypatch):
    found = []
    for piece_s in (60.0, 20.0):
        monkeypatch.setattr(nifo_study, "PIECE_S", piece_s)
        assert STUDY.pieces * piece_s == 60.0
        found.append(estimated(STUDY))
    for one, other in zip(*(f.estimates for f in found), strict=True):
        assert (other.form, other.block_s, other.contact) == (one.form, one.block_s, one.contact)
        assert other.mean_n_per_m == pytest.approx(one.mean_n_per_m, rel=1e-4)


def test_the_weak_form_is_right_where_the_papers_leaks(outcome):
    found = {(e.form, e.block_s, e.contact): e for e in outcome.estimates}
    for contact in ("contact_1", "contact_2"):
        assert abs(found["weak", 2.5, contact].off_percent) < 0.01
        for block_s in STUDY.block_s:
            assert (
                found["weak", block_s, contact].spread_percent < 0.1 * found["paper", block_s, contact].spread_percent
            )
        assert found["paper", 2.5, contact].spread_percent < 0.6 * found["paper", 1.0, contact].spread_percent
    assert all(0.1 < share < 0.5 for share in outcome.closed)


def test_noise_spoils_weak_contact():
    quiet, noisy = (
        estimated(Study(settings=replace(LONG, rms_n=0.5), block_s=(2.5,), noise_density=density))
        for density in (0.0, excitation_sweep.NOISE)
    )
    for clean, spoiled in zip(quiet.estimates, noisy.estimates, strict=True):
        assert spoiled.spread_percent > 2 * clean.spread_percent


def test_the_table_and_the_figure(outcome, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    points = [Point(1 / e.block_s, e, share) for e in outcome.estimates for share in outcome.closed[:1]]
    shown("a title", "resolution, Hz", points, tmp_path / "out" / "figure.png")
    printed = capsys.readouterr().out
    assert all(text in printed for text in ("a title", "resolution, Hz", "0.4", "weak form", "contact 2"))
    assert (tmp_path / "out" / "figure.png").stat().st_size > 10_000


def test_the_command_goes_on_where_it_was(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(frequency_resolution, "SHARES", (1.0,))
    frequency_resolution.frequency_resolution(tmp_path, block=1.0, seeds=1)
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "tasks").iterdir()}
    frequency_resolution.frequency_resolution(tmp_path, block=1.0, seeds=1)
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "tasks").iterdir()} == before
    assert np.count_nonzero([p.suffix == ".png" for p in tmp_path.iterdir()]) == 1
    assert "1" in capsys.readouterr().out
