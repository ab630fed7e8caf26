"""Diagnoses made by hand, and machines that are recorded."""

import pytest

from rig.recording import read
from rig.simulation.plants import modal
from rig.simulation.record import record
from tests.identify.gaps.diagnoses import GAPS, ONE_MASS, RIGS


@pytest.fixture(scope="session", params=list(GAPS))
def diagnosis(request):
    return GAPS[request.param]


@pytest.fixture(scope="session", params=["explained", "pair", "unexplained", "one_mass"])
def drawn_diagnosis(request):
    """A diagnosis whose pictures are drawn: those that have different ones."""
    return GAPS[request.param]


@pytest.fixture(scope="session")
def rig_of():
    """The rig that a diagnosis is of."""
    return lambda gap: RIGS["one_mass" if gap.attribution is ONE_MASS else "consistent"]


@pytest.fixture(scope="session")
def gaps():
    return GAPS


@pytest.fixture(scope="session")
def recorded_machine(tmp_path_factory):
    """A function that records a reference rig with some effects, of which rig.json knows nothing."""

    def made(settings, *effects):
        path = tmp_path_factory.mktemp("machine") / "r.mcap"
        actual = settings.rig()
        for effect in effects:
            actual = effect.applied_to(actual)
        record(
            settings.rig(),
            settings.force(),
            plant=modal.simulate,
            duration_s=settings.duration_s,
            step_s=settings.step_s,
            path=path,
            actual=actual,
            progress=lambda _: None,
        )
        return read(path)

    return made
