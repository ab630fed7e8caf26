"""Effects of the instruments in a recording whose rig.json stays nominal; and the command."""

import msgspec
import numpy as np
import pytest

from rig.effects import effect_named
from rig.recording import read, read_truth, truth_path
from rig.simulation.excitation import BandLimitedGaussian
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle
from tests.running import exit_status

_WIDE = BarrelCradle(stations=4, clearance_1_m=1.0, clearance_2_m=1.0).rig()
TWIN = msgspec.structs.replace(_WIDE.sensors[-1], name="twin")
LINEAR = msgspec.structs.replace(_WIDE, sensors=(TWIN, *_WIDE.sensors))
FORCE = BandLimitedGaussian(rms_n=14.0, low_hz=0.5, high_hz=100.0)
STEP_S = 2.0**-13


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("effects")

    def make(text):
        path = folder / f"{text.replace(':', '_')}.mcap"
        actual = effect_named(text).applied_to(LINEAR) if text else None
        record(
            LINEAR,
            FORCE,
            plant=modal.simulate,
            duration_s=1.6,
            step_s=STEP_S,
            path=path,
            progress=lambda _: None,
            actual=actual,
        )
        assert read(path).rig == LINEAR
        assert read_truth(truth_path(path)).rig == (actual or LINEAR)
        return read(path)

    return make


@pytest.fixture(scope="module")
def nominal(recorded):
    return recorded("")


def test_a_wrong_force_cell_leaves_the_force_and_shrinks_the_motion(recorded, nominal):
    recording = recorded("force_gain:factor=1.25")
    np.testing.assert_array_equal(recording.force_n, nominal.force_n)
    for quantity, signals in nominal.signals.items():
        scale = 1.0 if quantity == "force" else 1 / 1.25
        values = recording.signals[quantity].values
        np.testing.assert_allclose(values, scale * signals.values, atol=1e-9 * np.abs(values).max())


def test_a_late_force_leaves_the_force_and_delays_every_motion(recorded, nominal):
    late = 3
    recording = recorded(f"force_shift:shift_s={late / LINEAR.sample_rate_hz}")
    np.testing.assert_array_equal(recording.force_n, nominal.force_n)
    for quantity in ("displacement", "acceleration"):
        values, before = recording.signals[quantity].values, nominal.signals[quantity].values
        np.testing.assert_allclose(values[:, late:], before[:, :-late], atol=1e-6 * np.abs(before).max())


@pytest.mark.parametrize("text", ["sensor_gain:factor=1.1", "sensor_delay:delay_s=0.0009765625"])
def test_a_wrong_sensor_is_alone(recorded, text):
    """An identical sensor beside it is not affected."""
    recording = recorded(text)
    rows = dict(
        zip(recording.signals["acceleration"].channels.names, recording.signals["acceleration"].values, strict=True)
    )
    wrong, right = rows[LINEAR.sensors[-1].name], rows[TWIN.name]
    if "gain" in text:
        np.testing.assert_allclose(wrong, 1.1 * right)
    else:
        late = round(0.0009765625 * LINEAR.sample_rate_hz)
        np.testing.assert_allclose(wrong[late:], right[:-late], atol=1e-6 * np.abs(right).max())
    assert np.abs(right).max() > 1


def test_the_command_hides_its_effects_in_the_truth(tmp_path):
    path = tmp_path / "r.mcap"
    effects = ("preload:force_n=3", "contact_stiffness:factor=1.2,contact=contact_2")
    words = ("barrel_cradle", "--plant", "modal", "--duration", "1.2", "--out", path)
    assert exit_status("rig", "record", *words, "--effect", effects[0], "--effect", effects[1]) == 0
    believed = BarrelCradle().rig()
    actual = effect_named(effects[1]).applied_to(effect_named(effects[0]).applied_to(believed))
    recording, truth = read(path), read_truth(truth_path(path))
    assert recording.rig == believed
    assert truth.rig == actual
    assert not any(word in str(recording.provenance) for word in ("preload", "contact_stiffness", "StaticLoad"))
    quiet = truth.signals["contact_force"].values[:, 0]  # the barrel rests on its stops: the law of the lever
    np.testing.assert_allclose(quiet, 3 * np.array([0.05, 0.5]) / 0.55, rtol=1e-6)


@pytest.mark.parametrize("text", ["wind", "preload:weight=2", "sensor_gain:sensor=nose"])
def test_the_command_refuses_what_is_no_effect(tmp_path, capsys, text):
    path = tmp_path / "r.mcap"
    assert exit_status("rig", "record", "barrel_cradle", "--out", path, "--effect", text) == 2
    assert "--effect" in capsys.readouterr().err
    assert not path.exists()


def test_the_believed_rig_is_left_alone():
    before = msgspec.structs.replace(LINEAR)
    for text in ("preload", "sensor_gain", "clamp_compliance"):
        effect_named(text).applied_to(LINEAR)
    assert before == LINEAR
