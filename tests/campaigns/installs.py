"""What an installation costs: python -m tests.campaigns.installs

For the core, every extra and `all`: a fresh virtual environment, `pip install ".[EXTRA]"` into it from a copy of this
clone, everything downloaded anew, and commands that need what the extra brings. Prints the environment's size, how long
pip and the commands took, and what ran. Needs Python alone; of the environments only one is there at a time.
"""

import argparse
import os
import shlex
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[2]
NOT_COPIED = shutil.ignore_patterns(".git", "build", "*.egg-info", "out", "__pycache__", "*.mcap")
TDMS = """
import csv, nptdms, numpy
names, *rows = csv.reader(open('run.csv'))
columns = dict(zip(names, numpy.array(rows, float).T))
with nptdms.TdmsWriter('run.tdms') as writer:
    writer.write_segment([nptdms.ChannelObject('run', n, v, {'wf_increment': 1 / 512}) for n, v in columns.items()])
open('tdms.toml', 'w').write(open('csv.toml').read().replace('column = "', 'column = "run/'))
"""
CORE = (
    "rig record sdof --plant modal --duration 40 --out run.mcap",
    "rig export run.mcap --format csv --out run.csv --map csv.toml",
    "rig import run.csv --map csv.toml --out csv.mcap",
    "identify check csv.mcap",
    "identify contact csv.mcap --use acceleration --out contact",
    "rig doctor",
)
PARTS: Mapping[str, tuple[str, ...]] = {
    "simulate": ("rig record barrel_cradle --plant ancf --duration 2 --out ancf.mcap",),
    "view": ("rig view run.mcap --out run.rrd", "rerun rrd verify run.rrd"),
    "lab": (
        "rig export run.mcap --format uff --out run.uff --map uff.toml --force",
        "rig import run.uff --map uff.toml --out uff.mcap",
        "rig export run.mcap --format h5 --out run.h5 --map h5.toml --force",
        "rig import run.h5 --map h5.toml --out h5.mcap",
        f"python -c {shlex.quote(TDMS)}",
        "rig import run.tdms --map tdms.toml --out tdms.mcap",
    ),
    "symbolic": ("identify law run.mcap --seconds 10 --out law",),
    "cluster": ("python -m tests.campaigns.blind_gap make --cases 1 --nulls-only --dask local --out blind",),
    "fmu": ("rig fmu contact/rig.json --out run.fmu",),
    "mdf": ("rig export run.mcap --format mf4 --out run.mf4",),
}
"""What runs in the environment of an extra, after what runs in that of the core."""


def measured(extra: str) -> tuple[str, ...]:
    """A row: extra, MB of its environment, s that pip took, s that the commands took, and the commands of its part.

    Raises CalledProcessError if pip or a command fails.
    """
    with TemporaryDirectory() as folder:
        place, work = Path(folder) / "venv", Path(folder) / "work"
        source = shutil.copytree(ROOT, Path(folder) / "source", ignore=NOT_COPIED)
        for folder_name in ("scenarios", "tests/campaigns"):
            shutil.copytree(ROOT / folder_name, work / folder_name, ignore=NOT_COPIED)
        subprocess.run([sys.executable, "-m", "venv", place], check=True)
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        environment |= {"PATH": f"{place / 'bin'}{os.pathsep}{environment['PATH']}", "VIRTUAL_ENV": str(place)}
        wanted = str(source) if extra == "(none)" else f"{source}[{extra}]"
        begun = time.monotonic()
        _run(["python", "-m", "pip", "install", "--quiet", "--no-cache-dir", wanted], work, environment)
        installed = time.monotonic()
        size = sum(path.lstat().st_blocks * 512 for path in place.rglob("*")) / 2**20
        parts = [*PARTS.values()] if extra == "all" else [PARTS.get(extra, ())]
        commands = [*CORE, *(command for part in parts for command in part)]
        for command in commands:
            _run(shlex.split(command), work, environment)
        ran = time.monotonic() - installed
        told = [command for command in commands[len(CORE) :] or CORE if not command.startswith("python -c")]
        return extra, f"{size:.0f}", f"{installed - begun:.0f}", f"{ran:.0f}", "; ".join(told)


def _run(words: list[str], folder: Path, environment: Mapping[str, str]) -> None:
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        print(done.stdout, done.stderr, sep="\n", file=sys.stderr)
        done.check_returncode()


def main() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    known = ["(none)", *(name for name in extras if name in PARTS), "all"]
    parser = argparse.ArgumentParser(description="Size and time of the core, of every extra and of all.")
    parser.add_argument("--only", nargs="+", choices=known, default=known, help="these alone")
    chosen = parser.parse_args()
    print("| extra | MB | pip, s | commands, s | what ran |\n|---|---|---|---|---|")
    for extra in chosen.only:
        print("| " + " | ".join(measured(extra)) + " |", flush=True)


if __name__ == "__main__":
    main()
