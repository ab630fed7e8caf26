"""Findings of `rig doctor`, and the errors of commands that lack an extra."""

import importlib
import os
import subprocess
import sys
from functools import partial
from importlib.machinery import PathFinder
from pathlib import Path

import pytest

import rig.viewer
from rig.commands import doctor
from rig.commands.cli import main
from tests.running import environment, exit_status

SCRIPTS = Path(sys.executable).parent
LACKING = {
    "exudyn": ("rig", "record", "sdof", "--plant", "ancf", "--out", "o.mcap"),
    "rerun": ("rig", "view", "r.mcap"),
}


@pytest.fixture
def single_package(tmp_path, monkeypatch):
    """A folder of installed packages of which one has a name of ours."""
    for name, files in {"identify": ("identify/__init__.py",), "other": ("other/__init__.py",)}.items():
        metadata = tmp_path / f"{name}-2.6.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 2.6\n")
        (metadata / "RECORD").write_text("".join(f"{file},,\n" for file in files))
        for file in files:
            (tmp_path / file).parent.mkdir()
            (tmp_path / file).touch()
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    importlib.invalidate_caches()


@pytest.mark.usefixtures("single_package")
def test_a_package_of_the_same_name_is_found():
    assert [sentence[:57] for sentence in doctor.package_conflict_sentences()] == [
        "the Python package identify is also that of identify (pre"
    ]


def test_a_sound_installation_has_no_finding():
    assert list(doctor.package_conflict_sentences()) == []


@pytest.mark.parametrize(
    ("in_packages", "said"),
    [
        (
            True,
            "the folder {0} holds left-over files of an earlier installation, no package, and hides",
        ),
        (False, "the Python package rig in {0} is not that of rig-identify: start in another folder"),
    ],
)
def test_a_folder_that_shadows_a_package_is_named(tmp_path, monkeypatch, in_packages, said):
    """As after `pip install .` and `pip install -e .`, where use had written into the installed package."""
    left_file = tmp_path / "rig" / "simulation" / "__pycache__" / "stepping.py311.nbi"
    left_file.parent.mkdir(parents=True)
    left_file.touch()
    monkeypatch.setattr(doctor, "find_spec", partial(PathFinder.find_spec, path=[str(tmp_path)]))
    monkeypatch.setattr(doctor.site, "getsitepackages", lambda: [str(tmp_path)] * in_packages)
    sentence, *_ = doctor.package_conflict_sentences()
    assert sentence.startswith(said.format(tmp_path / "rig"))


def test_another_program_of_the_same_name_is_found(tmp_path, monkeypatch):
    program = tmp_path / "identify"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setattr(doctor.sysconfig, "get_path", lambda _: str(SCRIPTS))
    with environment(PATH=f"{tmp_path}{os.pathsep}{SCRIPTS}"):
        (said,) = doctor.command_conflict_sentences()
    assert said.startswith(f"the command identify is {program}, another program")
    assert said.endswith("or say rig-identify identify")
    with environment(PATH=f"{SCRIPTS}{os.pathsep}{tmp_path}"):
        assert list(doctor.command_conflict_sentences()) == []


def test_extras_are_those_of_the_installation():
    assert doctor.packages_of("simulate") == ["exudyn"]
    assert all(doctor.packages_of(extra) for extra in doctor.PURPOSE_BY_EXTRA)
    assert doctor.installed_version("numpy")
    assert doctor.installed_version("no-such-package") is None


@pytest.mark.parametrize("package", LACKING)
@pytest.mark.usefixtures("in_folder")
def test_what_lacks_an_extra_says_which(package, monkeypatch, capsys):
    Path("r.mcap").touch()
    monkeypatch.setattr(rig, "viewer", rig.viewer)  # the import below binds another module to this name
    for name in [n for n in sys.modules if n.partition(".")[0] == package or n.startswith("rig.viewer")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    assert exit_status(*LACKING[package], main=main) == 1
    extra = {"exudyn": "simulate", "rerun": "view"}[package]
    assert f"pip install 'rig-identify[{extra}]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("--version",), 0, "rig-identify "),
        (("-V",), 0, "rig-identify "),
        (("-h",), 0, "Usage: rig-identify rig"),
        (("identify", "--version"), 0, "rig-identify "),
        (("rig", "--help"), 0, "Usage: rig "),
        (("doctor",), 0, "installed"),
        (("no",), 2, "Usage: rig-identify rig"),
    ],
)
def test_one_command_has_both(words, status, said):
    program = [sys.executable, "-c", "from rig.commands.start import both; both()", *words]
    path = f"{SCRIPTS}{os.pathsep}{os.environ['PATH']}"
    completed = subprocess.run(program, capture_output=True, text=True, check=False, env=os.environ | {"PATH": path})
    assert (completed.returncode, completed.stderr) == (status, "")
    assert said in completed.stdout
