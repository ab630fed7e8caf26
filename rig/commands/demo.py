"""Demonstration: the barrel-cradle rig recorded, identified, changed and diagnosed, each answer beside the truth.

Notes for maintainers
1. Every step is a command of `rig` or `identify` in a process of its own, as a user would type it; nothing here knows
   how an answer is found. Answers are read from contact.json and gap.json.
2. Two chains run at the same time, one a core: record and identify; record the changed machine and diagnose it.
"""

import json
import os
import re
import subprocess
import sys
import time
import webbrowser
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from shlex import quote
from shutil import get_terminal_size
from textwrap import wrap
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from rig.commands.command_line import Force, fitted, refuse_existing, say
from rig.errors import RigError

MASS_KG, POSITION_M = 0.5, 0.8
"""Unknown mass, and its place on the barrel, of the changed machine: an eighth of the barrel, whose effect is seen."""
DEMO_SETTINGS = {"sensors": "acceleration", "noise_density": 1e-3, "stations": 4, "sample_rate_hz": 2048, "high_hz": 60}
NOMINAL_S, CHANGED_S = 10.0, 32.0
"""Lengths of the two records: of the shortest that bound the contacts to 1 %, and that leave 4 s for validation."""
HALF_WIDTH_95_FACTOR = 1.96
"""Half-width of a 95 % interval over its standard error."""

ShowText = Callable[[str], None]


def demo(
    out: Annotated[Path, typer.Option(help="Folder for recordings, answers and pages.")] = Path("demo"),
    show: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser at the end.")] = True,
    force: Force = False,
) -> None:
    """Record, identify, change and diagnose the barrel-cradle rig in about a minute, each answer beside the truth.

    Example: rig demo --out demo
    """
    from rig.simulation.reference import BarrelCradle

    started_s = time.monotonic()
    plant = "ancf" if find_spec("exudyn") else "modal"
    setting_options = [argument for key, value in DEMO_SETTINGS.items() for argument in ("--set", f"{key}={value}")]
    nominal_path, changed_path = out / "nominal.mcap", out / "changed.mcap"
    page_paths = out / "contact" / "contact.html", out / "gap" / "gap.html"
    for path in (nominal_path, changed_path, *page_paths):
        refuse_existing(path, force, new_folder=True)
    out.mkdir(parents=True, exist_ok=True)
    mass_effect = f"added_mass:mass_kg={MASS_KG},relative_position={POSITION_M / BarrelCradle().length_m}"
    record_command = ("rig", "record", "barrel_cradle", *setting_options)
    force_option = ("--force",) if force else ()
    change_options = ("--duration", CHANGED_S, "--seed", 2, "--effect", mass_effect)
    identification_commands = (
        (*record_command, "--plant", plant, "--duration", NOMINAL_S, "--out", nominal_path, *force_option),
        ("identify", "contact", nominal_path, "--out", out / "contact", *force_option),
    )
    diagnosis_commands = (
        (*record_command, "--plant", "modal", *change_options, "--out", changed_path, *force_option),
        ("identify", "gap", changed_path, "--out", out / "gap", *force_option),
    )

    def show_line(text: str) -> None:
        print(f"{text} ...", file=sys.stderr, flush=True)

    console = Console(stderr=True)
    progress_columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    with Progress(
        *progress_columns,
        console=console,
        disable=not console.is_terminal,
        transient=True,
        redirect_stdout=sys.stdout.isatty(),  # what goes to a file stays out of standard error
    ) as progress:

        def task_description(task: Any) -> ShowText:
            return show_line if progress.disable else lambda text: progress.update(task, description=text)

        with ThreadPoolExecutor(2) as pool:
            chain_futures = [
                pool.submit(_run_all, commands, task_description(progress.add_task("")))
                for commands in (identification_commands, diagnosis_commands)
            ]
            chain_futures[0].result()
            _print_contacts(identification_commands, out / "contact")
            chain_futures[1].result()
            _print_diagnosis(diagnosis_commands, out / "gap")
    print()
    say(f"{time.monotonic() - started_s:.0f} s. Pages: {page_paths[0]}, {page_paths[1]}")
    if show and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") or sys.platform in ("darwin", "win32")):
        with suppress(webbrowser.Error):
            webbrowser.open(page_paths[1].resolve().as_uri())


def _run_all(commands: tuple[tuple[object, ...], ...], show_text: ShowText) -> None:
    """Run commands one after another; raise RigError with the last line of one that fails."""
    for command in commands:
        show_text(" ".join(map(str, command[:3])))
        arguments = [sys.executable, "-m", "rig.commands.start", *map(str, command)]
        finished_process = subprocess.run(arguments, capture_output=True, text=True, check=False)
        if finished_process.returncode:
            reason = finished_process.stderr.strip().splitlines()[-1:] or ["no reason was given"]
            raise RigError(f"{' '.join(map(str, command[:2]))} failed: {reason[0]}")


def _print_commands(commands: tuple[tuple[object, ...], ...]) -> None:
    """Print commands as they are typed, those that are wider than the terminal in lines that a shell joins."""
    print()
    for command in commands:
        command_words = ["$", *(quote(str(argument)).replace(" ", "\0") for argument in command)]
        bound_text = re.sub(r"(--\S+) (?!-)", "\\1\0", " ".join(command_words))  # an option and its value
        usable_width = get_terminal_size().columns - len(" \\")
        lines = wrap(bound_text, usable_width, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
        for line_number, line in enumerate(lines, start=1):
            say(line.replace("\0", " ") + " \\" * (line_number < len(lines)))


def _print_contacts(commands: tuple[tuple[object, ...], ...], folder: Path) -> None:
    """Clearance and stiffness of each contact with 95 % intervals, beside the settings of the rig."""
    from rig.simulation.reference import BarrelCradle

    _print_commands(commands)
    true_settings = BarrelCradle()
    contact_json = json.loads((folder / "contact.json").read_text(encoding="utf-8"))
    clearances_m = true_settings.clearance_1_m, true_settings.clearance_2_m
    stiffnesses_n_per_m = true_settings.stiffness_1_n_per_m, true_settings.stiffness_2_n_per_m
    for contact, clearance_m, stiffness_n_per_m in zip(
        contact_json["contacts"], clearances_m, stiffnesses_n_per_m, strict=True
    ):
        _print_value(f"clearance of {contact['name']}", contact["clearance_m"], clearance_m, 1e3, "mm", 3)
        _print_value(
            f"stiffness of {contact['name']}", contact["stiffness_n_per_m"], stiffness_n_per_m, 1e-3, "N/mm", 2
        )


def _print_value(
    quantity: str, estimate: dict[str, float], true_value: float, unit_factor: float, unit: str, decimal_count: int
) -> None:
    value, half_width = unit_factor * estimate["value"], HALF_WIDTH_95_FACTOR * unit_factor * estimate["standard_error"]
    say(
        f"  {quantity}: {value:.{decimal_count}f} ± {half_width:.{decimal_count}f} {unit}   "
        f"(true: {unit_factor * true_value:g} {unit})"
    )


def _print_diagnosis(commands: tuple[tuple[object, ...], ...], folder: Path) -> None:
    """Verdict and its first sentence, beside the effect that the changed machine has."""
    _print_commands(commands)
    gap_json = json.loads((folder / "gap.json").read_text(encoding="utf-8"))
    answer_text = f"{gap_json['verdict'].replace('_', ' ')}: {gap_json['sentence']}"
    for line in fitted(f"  {answer_text}", get_terminal_size().columns).splitlines():
        say(line)
    say(f"  (true: a mass of {1e3 * MASS_KG:g} g on the barrel at {POSITION_M:g} m)")
