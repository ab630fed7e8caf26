"""Free decays of held bodies with contacts, by displacements from the release on, of machines of the world "bench"."""

import numpy as np
import pytest

from identify.gaps.residual.likelihood import nominal_variances_of
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.hypothesis import Search
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.search.sparse import ranked_hypotheses
from rig.recording import read
from tests.campaigns.earlier_faults import Row, machine_of
from tests.campaigns.worlds.instruments import measured
from tests.campaigns.worlds.making import write

pytestmark = pytest.mark.long
TRIED = {
    "added_mass",
    "base_motion",
    "clamp_compliance",
    "contact_clearance",
    "contact_damping",
    "contact_stiffness",
    "coulomb_friction",
    "ground_damper",
    "ground_friction",
    "linear_spring",
    "youngs_modulus",
}
DURATION_S = {"mass_decay": 20.0, "cantilever_decay": 10.0}


def recorded(folder, machine, seed, *effects):
    """First record of such a machine with effects, as the diagnosis reads it."""
    rig, true, (excitation, _) = machine_of(Row("", machine, effects), np.random.default_rng(seed))
    assert {s.quantity for s in rig.sensors} == {"displacement"}
    samples = round(DURATION_S[machine] * rig.sample_rate_hz)
    write(folder / "r.mcap", rig, measured(true, excitation, samples, rig.sample_rate_hz, seed))
    return record_of(read(folder / "r.mcap"))


def likeliest(record):
    """Likeliest hypothesis of a search among effects of several kinds."""
    known = candidates(effect_range_scale(record, record.rig), (), record.zero_known, has_force=False)
    known = [candidate for candidate in known if candidate.kind.name in TRIED]
    search = Search(
        nominal_variances_of(linearized(record, record.rig)), *fit_nuisance(record, record.rig), tuple(known)
    )
    return ranked_hypotheses(search)[0]


def holds(hypothesis, effect, value):
    """True if an effect stands alone in a hypothesis, its first value within three standard errors of the true one."""
    names = [candidate.kind.name for candidate in hypothesis.candidates]
    return names == [effect] and abs(hypothesis.values[0] - value) < 3 * np.sqrt(hypothesis.covariance[0, 0])


def test_a_damper_is_found_though_the_mass_rests_after_a_quarter_of_a_second(tmp_path):
    """Its look-alike, a larger damping of the mass, is as likely on other machines of this kind."""
    place = {"body": "mass", "position_m": 0.0}
    record = recorded(tmp_path, "mass_decay", 2, ("ground_damper", {"damping_n_s_per_m": 45.0}, place))
    assert record.residual_times_s[0] == 0
    assert holds(likeliest(record), "ground_damper", 45.0)


def test_nothing_is_found_in_a_mass_as_it_is_believed(tmp_path):
    assert not likeliest(recorded(tmp_path, "mass_decay", 2)).candidates


@pytest.mark.study
@pytest.mark.parametrize(
    ("effect", "parameter", "value", "place"),
    [("clamp_compliance", "compliance", 0.02, {"beam": "beam"}), ("youngs_modulus", "factor", 0.8, {"beam": "beam"})],
)
def test_an_effect_on_a_cantilever_is_found_beside_its_stop(effect, parameter, value, place, tmp_path):
    """By the modes, which ring on when the stop is no longer reached, and by the motion from the release on."""
    record = recorded(tmp_path, "cantilever_decay", 8, (effect, {parameter: value}, place))
    assert record.measured_modes
    assert record.residual_times_s[0] == 0
    assert holds(likeliest(record), effect, value)
