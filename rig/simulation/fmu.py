"""A rig as an FMU 3.0 (Co-Simulation), for Simulink, Modelica and other programs."""

from pathlib import Path
from tempfile import TemporaryDirectory

from rig.extras import needs_extra
from rig.files import write_bytes
from rig.model.description import Rig, to_json
from rig.recording import RIG_NAME
from rig.simulation.plants.stepwise import Stepwise

STEP_S = 2.0**-14
SLAVE_SCRIPT = Path(__file__).with_name("fmu_slave.py")


def export_fmu(rig: Rig, out: Path, step_s: float = STEP_S) -> None:
    """Write an FMU of the stepwise modal plant; communication steps are multiples of step_s.

    Input `force` (N), the value at the end of the next step, to which it goes in a straight line. Outputs
    `sensors.NAME` in SI, before any instrument, and `contacts.NAME.eta` (m) and `contacts.NAME.force` (N). Raises
    RigError if pythonfmu3 is not installed, the rig cannot be simulated so, or the file cannot be written.
    """
    with needs_extra("fmu", f"{out}: an FMU"):
        from pythonfmu3.builder import FmuBuilder
    Stepwise(rig, step_s)
    with TemporaryDirectory() as folder_name:
        folder = Path(folder_name)
        (folder / RIG_NAME).write_bytes(to_json(rig))
        (folder / "step.txt").write_text(repr(step_s))
        fmu_path = FmuBuilder.build_FMU(SLAVE_SCRIPT, folder / "out", [folder / RIG_NAME, folder / "step.txt"])
        write_bytes(fmu_path.read_bytes(), out)
