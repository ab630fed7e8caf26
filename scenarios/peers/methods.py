"""The methods that are compared: what each is, must be told, covers and needs installed."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

from identify.contacts import identify_contact
from identify.pages.wording import COVERED
from rig.model.tolerances import EXACT
from rig.recording import Recording
from scenarios.peers.mujoco_sysid import mujoco_sysid
from scenarios.peers.output_error import output_error
from scenarios.peers.peer_data import ContactAnswer, peer_data
from scenarios.peers.sparse_regression import sparse_regression
from scenarios.peers.subspace import subspace

THIS_PROJECT = "this project"


@dataclass(frozen=True)
class Method:
    """A method by its name: modules that it imports, packages that they come from, and what it is told."""

    title: str
    modules: tuple[str, ...]
    packages: tuple[str, ...]
    prior_knowledge: str
    answers: Callable[[Recording], tuple[ContactAnswer, ...]]

    @property
    def versions(self) -> str:
        """Packages with their versions; raises PackageNotFoundError unless all are installed."""
        return ", ".join(f"{package} {version(package)}" for package in self.packages)

    @property
    def installed(self) -> bool:
        try:
            return bool(self.versions) and all(find_spec(module) for module in self.modules)
        except (PackageNotFoundError, ModuleNotFoundError):
            return False


def this_project(recording: Recording) -> tuple[ContactAnswer, ...]:
    """Accelerometers alone, the rig believed to be exact, as the peers believe it."""
    return tuple(
        ContactAnswer(
            contact=contact.name,
            clearance_m=contact.clearance_m.value,
            stiffness_n_per_m=contact.stiffness_n_per_m.value,
            clearance_half_width_m=COVERED * contact.clearance_m.standard_error,
            stiffness_half_width_n_per_m=COVERED * contact.stiffness_n_per_m.standard_error,
        )
        for contact in identify_contact(recording, use="acceleration", tolerances=EXACT).report.contacts
    )


METHODS = {
    "ours": Method(THIS_PROJECT, (), ("rig-identify",), "linear model; accelerometers", this_project),
    "output_error": Method(
        "output error, multiple shooting",
        (),
        ("scipy",),
        "linear model; start values off by 20 and 50 %; displacement and velocity",
        lambda recording: output_error(peer_data(recording)),
    ),
    "sparse_regression": Method(
        "sparse regression",
        ("pysindy",),
        ("pysindy",),
        "mode shapes; form of the law; displacement and velocity; accelerometers",
        lambda recording: sparse_regression(peer_data(recording)),
    ),
    "subspace": Method(
        "nonlinear subspace (as FNSI)",
        ("nfoursid",),
        ("nfoursid",),
        "true clearance; order of the system; displacement; accelerometers",
        lambda recording: subspace(peer_data(recording)),
    ),
    "mujoco_sysid": Method(
        "MuJoCo sysid",
        ("mujoco.sysid", "absl", "tabulate"),
        ("mujoco",),
        "linear model; start values off by 20 and 50 %; displacement and velocity",
        lambda recording: mujoco_sysid(peer_data(recording)),
    ),
}
