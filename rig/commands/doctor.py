"""Report on installed packages, and on names that another package or program uses: `rig doctor`.

It imports nothing of the project or of its libraries, as they may be what is broken.
"""

import re
import shutil
import site
import sys
import sysconfig
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, packages_distributions, requires, version
from importlib.util import find_spec
from pathlib import Path

NAME = "rig-identify"
COMMANDS = ("rig", "identify")
PURPOSE_BY_EXTRA = {
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
    for extra, purpose in PURPOSE_BY_EXTRA.items():
        missing_packages = [package for package in packages_of(extra) if installed_version(package) is None]
        installation_words = (
            f"{', '.join(missing_packages)} missing: pip install '{NAME}[{extra}]'" if missing_packages else "installed"
        )
        print(f"  {extra:9} {purpose}: {installation_words}")
    conflict_sentences = [*package_conflict_sentences(), *command_conflict_sentences()]
    for sentence in conflict_sentences:
        print(sentence)
    return int(bool(conflict_sentences))


def packages_of(extra: str) -> list[str]:
    """Packages that an extra installs, from the metadata of the installation."""
    extra_marker = re.compile(rf"extra == ['\"]{extra}['\"]")
    return [re.split(r"[\s<>=!~;\[(]", line)[0] for line in requires(NAME) or () if extra_marker.search(line)]


def installed_version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def package_conflict_sentences() -> Iterator[str]:
    """Sentence for each of the project's packages that another distribution provides too."""
    owners_by_package = packages_distributions()
    for package_name in COMMANDS:
        owners = sorted(set(owners_by_package.get(package_name, ())) - {NAME})
        package_folder = package_folder_of(package_name)
        if owners:
            yield (
                f"the Python package {package_name} is also that of {', '.join(owners)} (pre-commit needs one called "
                f"identify): keep what needs it in an environment of its own; here pip uninstall {' '.join(owners)}, "
                f"then pip install --force-reinstall --no-deps {NAME}"
            )
        elif package_folder is None:
            yield f"the Python package {package_name} is not there: install {NAME} again"
        elif not (package_folder / "__init__.py").is_file() and is_of_installed_packages(package_folder):
            yield (
                f"the folder {package_folder} holds left-over files of an earlier installation, no package, and hides "
                f"the installed {package_name}: delete this folder"
            )
        elif not (package_folder / "commands" / "cli.py").is_file():
            yield (
                f"the Python package {package_name} in {package_folder} is not that of {NAME}: "
                "start in another folder, or rename this one"
            )


def package_folder_of(package_name: str) -> Path | None:
    """Folder in which Python finds a package, with or without an __init__.py; None where it finds none."""
    module_spec = find_spec(package_name)
    return next((Path(folder) for folder in (module_spec and module_spec.submodule_search_locations) or ()), None)


def is_of_installed_packages(folder: Path) -> bool:
    """True if the folder lies where pip installs packages, for all or for this user."""
    folders = *site.getsitepackages(), site.getusersitepackages(), *map(sysconfig.get_path, ("purelib", "platlib"))
    return folder.parent.resolve() in {Path(packages_folder).resolve() for packages_folder in folders}


def command_conflict_sentences() -> Iterator[str]:
    """Sentence for each command that the shell finds elsewhere, or not at all."""
    scripts_folder = Path(sysconfig.get_path("scripts")).resolve()
    for command_name in COMMANDS:
        command_path = shutil.which(command_name)
        if command_path is None:
            yield f"the command {command_name} is not on the PATH: activate the environment, or add {scripts_folder}"
        elif Path(command_path).parent.resolve() != scripts_folder:
            yield (
                f"the command {command_name} is {command_path}, another program (ImageMagick has one called identify): "
                f"put {scripts_folder} first on the PATH, or say {NAME} {command_name}"
            )
