"""Installed packages are only read: what use leaves behind is in the user's folders, or nowhere."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import rig

SOURCE = Path(rig.__file__).parents[1]
OWN_FOLDERS = ("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA", "NUMBA_CACHE_DIR", "PYTHONPATH")
RECORD = ("rig", "record", "sdof", "--plant", "modal", "--duration", "2", "--out")
COMPILED_CODE = "import rig.simulation.plants.stepping as s; print(s.advance.stats.cache_path)"


@pytest.fixture
def installed(tmp_path):
    """Function that makes an installation of both packages that nobody may write to."""
    folders = []

    def install(name):
        folder = tmp_path / name
        for package in ("rig", "identify"):
            shutil.copytree(SOURCE / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
        folders.append(folder)
        for path in (folder, *folder.rglob("*")):
            path.chmod(path.stat().st_mode & ~0o222)
        return folder

    yield install
    for folder in folders:
        for path in (folder, *folder.rglob("*")):
            path.chmod(path.stat().st_mode | 0o200)


def run(installation, *words, **variables):
    """Standard output of a command or of `-c` and code, of an installation of its own; pytest's compiled files stay."""
    inherited = {name: value for name, value in os.environ.items() if name not in OWN_FOLDERS}
    own = {"PYTHONPATH": str(installation), "PYTHONDONTWRITEBYTECODE": "1"}
    program = ("-c", words[1]) if words[0] == "-c" else ("-m", "rig.commands.start", *map(str, words))
    done = subprocess.run(
        [sys.executable, *program],
        env=inherited | own | variables,
        cwd=installation.parent,  # the folder that Python looks in first
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def files(folder):
    return sorted(path.relative_to(folder) for path in folder.rglob("*"))


@pytest.mark.parametrize("cache", ["kept", "not kept"])
def test_use_writes_nothing_into_an_installation(installed, tmp_path, cache):
    place = installed("installed")
    before = files(place)
    home = tmp_path / "home"
    home.mkdir() if cache == "kept" else home.touch()
    recording = tmp_path / "r.mcap"
    run(place, *RECORD, recording, HOME=str(home), LOCALAPPDATA=str(home))
    assert recording.exists()
    assert files(place) == before
    assert [path.suffix for path in home.rglob("*.nbi")] == [".nbi"] * (cache == "kept")


def test_installations_side_by_side_share_no_compiled_code(installed, tmp_path):
    folders = {run(installed(name), "-c", COMPILED_CODE, XDG_CACHE_HOME=str(tmp_path / "cache")) for name in "ab"}
    assert len(folders) == 2
    assert all(folder.startswith(str(tmp_path / "cache" / "rig-identify" / rig.__version__)) for folder in folders)


def test_the_folder_that_the_user_names_for_numba_is_taken(installed, tmp_path):
    folder = run(installed("installed"), "-c", COMPILED_CODE, NUMBA_CACHE_DIR=str(tmp_path / "numba"))
    assert folder.startswith(str(tmp_path / "numba"))
