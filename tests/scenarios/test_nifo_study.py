"""The studies of NIFO: the record is worked on in pieces, as if it were one; the tables and figures."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.signals.spectra import Averaging, blocks
from scenarios import nifo_study, nifo_sweep
from scenarios.nifo_study import LONG_RECORD_RIG, Study, incoherent_rms_shares, nifo_outcome, record_length_s
from scenarios.nifo_sweep import NOISE_DENSITY, Point, ideal_range, print_and_draw
from tests.running import environment

STUDY = Study(settings=LONG_RECORD_RIG, block_s=(1.0, 2.5))


@pytest.fixture(scope="module")
def outcome():
    return nifo_outcome(STUDY)


def test_the_paper_needs_24_600_s_for_its_finest_resolution():
    assert record_length_s(1200.0) == 24_600.0


def test_pieces_join_without_a_seam(monkeypatch):
    found = []
    for piece_s in (60.0, 20.0):
        monkeypatch.setattr(nifo_study, "PIECE_S", piece_s)
        assert STUDY.piece_count * piece_s == 60.0
        found.append(nifo_outcome(STUDY))
    for one, other in zip(*(f.estimates for f in found), strict=True):
        assert (other.form, other.block_s, other.contact) == (one.form, one.block_s, one.contact)
        assert other.mean_n_per_m == pytest.approx(one.mean_n_per_m, rel=1e-4)


def test_the_weak_form_is_right_where_the_papers_leaks(outcome):
    found = {(e.form, e.block_s, e.contact): e for e in outcome.estimates}
    for contact in ("contact_1", "contact_2"):
        assert abs(found["weak", 2.5, contact].mean_error_percent) < 0.01
        for block_s in STUDY.block_s:
            assert (
                found["weak", block_s, contact].spread_percent < 0.1 * found["paper", block_s, contact].spread_percent
            )
        assert found["paper", 2.5, contact].spread_percent < 0.6 * found["paper", 1.0, contact].spread_percent
    assert all(0.1 < share < 0.5 for share in outcome.closed_shares)


def test_noise_spoils_weak_contact():
    both = Study(settings=replace(LONG_RECORD_RIG, rms_n=0.5), block_s=(2.5,), noise_densities=(0.0, NOISE_DENSITY))
    alone = Study(settings=replace(LONG_RECORD_RIG, rms_n=0.5), block_s=(2.5,))
    found, quiet = nifo_outcome(both).estimates, nifo_outcome(alone).estimates
    assert found[: len(quiet)] == quiet
    for clean, spoiled in zip(quiet, found[len(quiet) :], strict=True):
        assert spoiled.spread_percent > 2 * clean.spread_percent


def test_the_table_and_the_figure(outcome, tmp_path, capsys):
    points = [
        Point(1 / e.block_s, e, outcome.closed_shares[0], outcome.incoherent_rms_shares) for e in outcome.estimates
    ]
    with environment(COLUMNS="160"):
        print_and_draw("a title", "resolution, Hz", points, tmp_path / "out" / "figure.png", (0.5, 0.9))
    printed = capsys.readouterr().out
    assert all(text in printed for text in ("a title", "resolution, Hz", "0.4", "weak form", "contact 2"))
    assert (tmp_path / "out" / "figure.png").stat().st_size > 10_000


def test_the_command_goes_on_where_it_was(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(nifo_sweep, "BLOCK_SHARES", (1.0,))
    nifo_sweep.nifo_sweep("resolution", tmp_path, block=1.0, records=1)
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "tasks").iterdir()}
    nifo_sweep.nifo_sweep("resolution", tmp_path, block=1.0, records=1)
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "tasks").iterdir()} == before
    assert np.count_nonzero([p.suffix == ".png" for p in tmp_path.iterdir()]) == 1
    assert "1" in capsys.readouterr().out


def test_the_ideal_range_is_where_the_weak_form_errs_least(outcome):
    weak = next(e for e in outcome.estimates if e.form == "weak")
    true = weak.true_n_per_m
    errors = {1.0: 0.05, 3.0: 0.002, 10.0: -0.001, 30.0: 0.0025, 100.0: 0.02, 1000.0: 0.002}  # 1000 beyond a bad one
    points = [Point(v, replace(weak, mean_n_per_m=true * (1 + error)), 0.2, ()) for v, error in errors.items()]
    wrong_form = Point(300.0, replace(weak, form="paper", mean_n_per_m=true), 0.2, ())
    assert ideal_range([*points, wrong_form]) == (3.0, 30.0)


def test_free_shares_of_signals_that_share_a_part():
    rng = np.random.default_rng(1)
    common, one, other = rng.standard_normal((3, 4000))
    cut = blocks(4000, 100.0, Averaging(block_s=1.0), (5.0, 40.0))
    shares = incoherent_rms_shares([common + one, common + other, rng.standard_normal(4000)], cut)
    averages = len(cut.starts)
    left = np.sqrt((averages - 2) / averages)  # of what is fitted by two others from so many blocks
    assert shares == pytest.approx((np.sqrt(3) / 2 * left, np.sqrt(3) / 2 * left, left), abs=0.03)
