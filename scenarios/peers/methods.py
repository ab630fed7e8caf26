"""The methods that are compared: what each is, must be told, covers and needs installed."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

from identify.contacts import identify_contact
from identify.pages.wording import COVERED
from rig.model.tolerances import EXACT
from rig.recording import Recording
from scenarios.peers.given import ContactAnswer, given
from scenarios.peers.mujoco_sysid import mujoco_sysid
from scenarios.peers.output_error import output_error
from scenarios.peers.sparse_regression import sparse_regression
from scenarios.peers.subspace import subspace

OURS = "this project"


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


def ours(recording: Recording) -> tuple[ContactAnswer, ...]:
    """Accelerometers alone, the rig believed to be exact, as the peers believe it."""
    return tuple(
        ContactAnswer(
            contact=contact.name,
            clearance_m=contact.clearance_m.value,
            stiffness_n_per_m=contact.stiffness_n_per_m.value,
            clearance_reach_m=COVERED * contact.clearance_m.standard_error,
            stiffness_reach_n_per_m=COVERED * contact.stiffness_n_per_m.standard_error,
        )
        for contact in identify_contact(recording, use="acceleration", tolerances=EXACT).report.contacts
    )


METHODS = {
    "ours": Method(OURS, (), ("rig-identify",), "linear model; accelerometers", ours),
    "output_error": Method(
        "output error, multiple shooting",
        (),
        ("scipy",),
        "linear model; start values off by 20 and 50 %; displacement and velocity",
        lambda recording: output_error(given(recording)),
    ),
    "sparse_regression": Method(
        "sparse regression",
        ("pysindy",),
        ("pysindy",),
        "mode shapes; form of the law; displacement and velocity; accelerometers",
        lambda recording: sparse_regression(given(recording)),
    ),
    "subspace": Method(
        "nonlinear subspace (as FNSI)",
        ("nfoursid",),
        ("nfoursid",),
        "true clearance; order of the system; displacement; accelerometers",
        lambda recording: subspace(given(recording)),
    ),
    "mujoco_sysid": Method(
        "MuJoCo sysid",
        ("mujoco.sysid", "absl", "tabulate"),
        ("mujoco",),
        "linear model; start values off by 20 and 50 %; displacement and velocity",
        lambda recording: mujoco_sysid(given(recording)),
    ),
}
