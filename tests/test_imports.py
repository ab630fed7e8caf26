"""The walls between the packages, and what an import may cost."""

import subprocess
import sys
from pathlib import Path

import pytest

import identify
import rig

ROOT = Path(__file__).parent.parent
IMPORT_ALL = """
import importlib, pkgutil, sys
package = importlib.import_module({package!r})
for module in pkgutil.walk_packages(package.__path__, {package!r} + "."):
    if module.name not in {spared!r}:
        importlib.import_module(module.name)
        heavy = {{"bokeh", "exudyn", "matplotlib", "rerun"}} & set(sys.modules)
        assert not heavy, f"{{module.name}} pulls in {{heavy}}"
print("imported")
"""


DRAWS = (
    "axes",
    "blueprint",
    "contact_view",
    "drawing",
    "gap_view",
    "model_view",
    "orbit",
    "phase_view",
    "prediction_view",
    "spectra",
    "viewing",
    "web",
)
"""What draws for the viewer, by rerun."""


def test_the_contracts_on_imports_hold():
    linter = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run([linter, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("package", [rig, identify])
def test_every_name_that_a_package_offers_is_loaded_when_it_is_asked_for(package):
    assert all(getattr(package, name) is not None for name in package.__all__)
    assert not hasattr(package, "no_such_name")


@pytest.mark.parametrize(
    ("package", "spared"),
    [
        ("rig", tuple(f"rig.viewer.{name}" for name in DRAWS)),
        ("identify", ()),
    ],
)
def test_importing_a_package_pulls_in_nothing_heavy(package, spared):
    program = IMPORT_ALL.format(package=package, spared=spared)
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stdout == "imported\n", done.stdout + done.stderr


@pytest.mark.parametrize("command", [rig, identify], ids=["rig", "identify"])
def test_the_help_of_a_command_waits_for_no_numerical_library(command):
    program = f"""
import atexit, sys
sys.argv = ["{command.__name__}", "--help"]
atexit.register(lambda: print({{"numpy", "scipy", "google", "mcap"}} & set(sys.modules), file=sys.stderr))
from rig.commands.start import {command.__name__} as start
start()
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert f"Usage: {command.__name__}" in done.stdout
    assert done.stderr == "set()\n"
