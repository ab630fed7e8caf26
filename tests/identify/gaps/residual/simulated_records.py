"""Records of rigs that the plant `modal` simulates."""

from identify.gaps.residual.record import Record
from identify.gaps.residual.spectra import record_of
from rig.model.description import Rig
from rig.simulation.excitation import force_history
from rig.simulation.reference import BarrelCradle, Sdof
from rig.simulation.replay import modal


def simulated_record(settings: Sdof | BarrelCradle, rig: Rig, actual: Rig | None = None) -> Record:
    """Record of a rig, or of the actual one that it describes, under the force of a reference rig."""
    force_n = force_history(settings.force(), settings.duration_s, 1 / rig.sample_rate_hz)
    return record_of(modal(rig, rig if actual is None else actual, force_n, 1))
