"""A diagnosis as `identify gap` writes it, drawn where and when it says."""

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.results import Share
from rig.errors import RigError
from rig.model.description import Station
from rig.recording import read, read_truth, truth_path
from rig.simulation.excitation import BandLimitedGaussian
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import Sdof
from rig.viewer.gap import Mark, ShownGap, read_gap
from rig.viewer.viewing import write_rrd
from tests.identify.gaps.diagnoses import GAPS, ONE_MASS, RIGS
from tests.rig.viewer.test_viewing import column, series, static

MASS = (Station("barrel", 0.9899), "an added mass of 0.1414 ± 0.0021 kg on the barrel at 0.9899 ± 0.0041 m")
MARKS = {
    "explained": [MASS],
    "small": [MASS],
    "pair": [(RIGS["pair"].contacts[1].at, "a dry friction of 0.764 ± 0.061 N in contact_2")],
    "cables": [
        (Station("barrel", 0.911), "an added mass of 0.01200 ± 0.00020 kg on the barrel at 0.9110 ± 0.0039 m"),
        (Station("barrel", 0.488), "an added mass of 0.00930 ± 0.00020 kg on the barrel at 0.4880 ± 0.0039 m"),
    ],
    "partly_explained": [MASS, (Station("cradle", 0.8), "unmeasured force, 0.99 N rms, always")],
    "vetoed": [],
    "unexplained": [(Station("barrel", 0.8914), "unmeasured force, 10.5 N rms, always")],
    "consistent": [],
    "cannot_tell": [],
    "one_mass": [(Station("mass", 0.0), MASS[1])],
}


@pytest.mark.parametrize("name", GAPS)
def test_what_acts_is_marked_at_its_place(tmp_path, name):
    (tmp_path / "gap.json").write_bytes(msgspec.json.encode(GAPS[name]))
    gap = read_gap(tmp_path, RIGS[name], 61.0)
    assert [(m.station, m.words) for m in gap.marks] == MARKS[name]
    assert GAPS[name].sentence in gap.text
    assert bool(gap.share_by_station) == (name not in ("consistent", "cannot_tell"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "is no gap.json"),
        ('{"schema_version": 3}', "schema_version is 3, and this program reads 1 to 2"),
        ('{"verdict": "unknown"}', "is no gap.json"),
        (GAPS["explained"], "has 0.2 m on 'cradle'"),
        (GAPS["one_mass"], "is of a record longer than 19 s"),
        (replace(GAPS["one_mass"], attribution=replace(ONE_MASS, positions_m={"mass": {0.0: -1.0}})), "is no gap.json"),
        (
            replace(GAPS["one_mass"], attribution=replace(ONE_MASS, positions_m={"mass": {2.0: 1.0}})),
            "has 2 m on 'mass'",
        ),
        (
            replace(GAPS["one_mass"], attribution=replace(ONE_MASS, time_s=(Share(np.nan, 20.0, 1.0),))),
            "is no gap.json",
        ),
    ],
)
def test_a_file_that_is_no_gap_json_of_the_rig_is_named(tmp_path, text, said):
    file = tmp_path / "gap.json"
    file.write_bytes(text.encode() if isinstance(text, str) else msgspec.json.encode(text))
    with pytest.raises(RigError, match=f"gap.json: .*{said}"):
        read_gap(file, RIGS["one_mass"], 19.0)


def test_a_force_in_contact_shows_while_one_is_closed_and_as_strong_as_it_is_then(tmp_path):
    path = tmp_path / "r.mcap"
    force = BandLimitedGaussian(rms_n=0.5, low_hz=0.5, high_hz=15.0)
    settings = {"plant": modal.simulate, "duration_s": 6.0, "step_s": 2.0**-13, "progress": lambda _: None}
    record(Sdof().rig(), force, path=path, **settings)
    recording, truth = read(path), read_truth(truth_path(path))
    gap = ShownGap(
        text="words",
        marks=(Mark(Station("mass"), "a force", (0.5, 1.0), in_contact=True),),
        share_by_station={Station("mass"): 1.0},
        share_spans=((0.0, 2.0, 0.25), (2.0, 4.0, 0.75)),
    )
    write_rrd(recording, truth, tmp_path / "r.rrd", gap=gap)
    times, radii = column(tmp_path / "r.rrd", "/model/gap/mark_0", "Points3D:radii")
    _, words = column(tmp_path / "r.rrd", "/model/gap/mark_0/words", "Points3D:labels")
    rows = np.round(times * recording.rig.sample_rate_hz).astype(int)
    eta = truth.signals["relative_displacement"].values[0, rows]
    acts = (np.abs(eta) > recording.rig.contacts[0].law.upper_clearance_m) & (times <= 4.0)
    drawn = -np.array(radii)[:, 0]
    np.testing.assert_array_equal(drawn > 0, acts)
    np.testing.assert_array_equal([w[0] == "a force" for w in words], acts)
    assert set(np.round(drawn[acts & (times < 2)], 3)) == {round(14 * 0.65, 3)}
    assert set(np.round(drawn[acts & (times > 2)], 3)) == {14.0}
    assert static(tmp_path / "r.rrd", "/diagnosis", "TextDocument:text") == ["words"]
    assert static(tmp_path / "r.rrd", "/model/gap/share_0", "Points3D:labels") == ["100 % of the gap"]
    write_rrd(recording, truth, tmp_path / "without.rrd")
    with_gap, without = (
        [static(tmp_path / name, f"/key/{i}", "Points2D:labels") for i in range(7)] for name in ("r.rrd", "without.rrd")
    )
    assert [words for words in with_gap if words not in without] == [["where and when the gap acts"]]
    assert ["found: identified or corrected"] not in with_gap
    np.testing.assert_allclose(series(tmp_path / "r.rrd", "/gap_over_time")[1][0], [25, 25, 75, 75])
