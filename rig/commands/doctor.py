"""Report of what is installed, and of names that another package or program has taken: `rig doctor`.

It imports nothing of the project or of its libraries, as they may be what is broken.
"""

import re
import shutil
import sys
import sysconfig
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, packages_distributions, requires, version
from importlib.util import find_spec
from pathlib import Path

NAME = "rig-identify"
COMMANDS = ("rig", "identify")
PURPOSES = {
    "simulate": "the plant ancf (Exudyn)",
    "view": "rig view (rerun)",
    "lab": "UFF, TDMS and MATLAB 7.3 files",
    "symbolic": "identify law",
    "cluster": "scenarios on several computers (dask)",
    "fmu": "rig fmu (FMI 3.0)",
    "mdf": "MDF 4 files",
}


def doctor() -> int:
    """Print the report; return 1 if there is a name conflict to resolve, else 0."""
    print(f"{NAME} {version(NAME)}, Python {sys.version.split()[0]}")
    for extra, purpose in PURPOSES.items():
        missing = [package for package in packages_of(extra) if installed(package) is None]
        state = f"{', '.join(missing)} missing: pip install '{NAME}[{extra}]'" if missing else "installed"
        print(f"  {extra:9} {purpose}: {state}")
    complaints = [*taken_packages(), *taken_commands()]
    for sentence in complaints:
        print(sentence)
    return int(bool(complaints))


def packages_of(extra: str) -> list[str]:
    """Packages that an extra installs, from the metadata of the installation."""
    ending = re.compile(rf"extra == ['\"]{extra}['\"]")
    return [re.split(r"[\s<>=!~;\[(]", line)[0] for line in requires(NAME) or () if ending.search(line)]


def installed(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def taken_packages() -> Iterator[str]:
    """Sentence for each of the project's packages that another distribution provides too."""
    packages = packages_distributions()
    for name in COMMANDS:
        owners = sorted(set(packages.get(name, ())) - {NAME})
        spec = find_spec(name)
        place = Path((spec and spec.origin) or ".").parent
        if owners:
            yield (
                f"the Python package {name} is also that of {', '.join(owners)} (pre-commit needs one called "
                f"identify): keep what needs it in an environment of its own; here pip uninstall {' '.join(owners)}, "
                f"then pip install --force-reinstall --no-deps {NAME}"
            )
        elif not (place / "commands" / "cli.py").is_file():
            yield f"the Python package {name} in {place} is not that of {NAME}: start in another folder, or remove it"


def taken_commands() -> Iterator[str]:
    """Sentence for each command that the shell finds elsewhere, or not at all."""
    scripts = Path(sysconfig.get_path("scripts")).resolve()
    for name in COMMANDS:
        command_path = shutil.which(name)
        if command_path is None:
            yield f"the command {name} is not on the PATH: activate the environment, or add {scripts}"
        elif Path(command_path).parent.resolve() != scripts:
            yield (
                f"the command {name} is {command_path}, another program (ImageMagick has one called identify): put "
                f"{scripts} first on the PATH, or say {NAME} {name}"
            )
