"""Two recordings a case, no truth beside them, the same bytes again, and a truth that survives its JSON."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from rig.errors import RigError
from rig.recording import read
from tests.campaigns.worlds import making
from tests.campaigns.worlds.drawing import drawn_case, kind_and_names
from tests.campaigns.worlds.making import made, planned
from tests.campaigns.worlds.truth import Case


def first_of(kind, world="wide", seed=1):
    return next(k for k in range(40) if kind_and_names(world, seed, k)[0] == kind)


def plan(folder, number=0, world="wide", nulls_only=False):
    for name in ("recordings", "sealed/work"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    return planned(folder, world, 1, number + 1, 1.5, nulls_only)[number]


@pytest.fixture
def measure_by(monkeypatch):
    """Puts another function in the place of the instruments of the worlds."""
    return lambda function: monkeypatch.setattr(making, "measured", function)


def test_a_case_leaves_two_recordings_and_no_truth(tmp_path):
    number = first_of("outside")
    case = made(plan(tmp_path, number))
    names = [f"case_{number:03d}.mcap", f"case_{number:03d}_validate.mcap"]
    assert sorted(p.name for p in tmp_path.rglob("*") if p.is_file()) == names == sorted(case.sha256)
    fit, validate = (read(tmp_path / "recordings" / name) for name in names)
    assert fit.rig == validate.rig == drawn_case("wide", 1, number).rig
    assert fit.samples == round(1.5 * fit.rig.sample_rate_hz)
    assert set(fit.signals) == {"force", "acceleration"}
    assert case.effects[0].name not in str((fit.provenance, fit.rig))
    assert [r.file for r in case.records] == names
    assert case.expected is not None


def test_the_same_plan_gives_the_same_bytes_and_truth(tmp_path):
    one, two = (made(plan(tmp_path / name, 1)) for name in ("one", "two"))
    assert one == two
    assert msgspec.json.decode(msgspec.json.encode(one), type=Case) == one


def test_levels_and_closed_contacts_are_told(tmp_path):
    case = made(plan(tmp_path, 0, "other", nulls_only=True))
    for told in case.records:
        force = read(tmp_path / "recordings" / told.file).force_n
        excited = force[round(told.excitation.begins_s * 4096) :]
        assert np.sqrt(np.mean(excited**2)) == pytest.approx(told.excitation.level_n, rel=0.02)
        assert set(told.closed_fraction) == {"contact_1", "contact_2"}
        assert all(0 <= share <= 1 for share in told.closed_fraction.values())


def test_a_draw_that_cannot_be_simulated_is_drawn_again(tmp_path, measure_by):
    calls, real = [], making.measured

    def failing(*given):
        calls.append(1)
        if len(calls) < 3:
            raise RigError("diverged")
        return real(*given)

    measure_by(failing)
    case = made(plan(tmp_path))
    assert case.draw == 2
    assert [r.rpartition(": ")[2] for r in case.refused] == ["diverged", "diverged"]
    assert case.drawn == drawn_case("wide", 1, 0, 2).drawn


def test_a_case_that_never_runs_is_one_clear_sentence(tmp_path, measure_by):
    def failing(*_):
        raise RigError("diverged")

    measure_by(failing)
    with pytest.raises(RigError, match=r"case_000: none of 20 draws could be simulated, the last: .*diverged"):
        made(plan(tmp_path))


def test_a_motion_that_is_no_number_is_not_written(tmp_path):
    drawn = drawn_case("own", 1, 0)
    broken = making.Measured(np.full(8, np.nan), np.zeros((len(drawn.rig.sensors), 8)), {})
    with pytest.raises(RigError, match="the force is no finite number"):
        making.write(Path(tmp_path, "x.mcap"), drawn.rig, broken)
