"""Are the effects that a diagnosis cannot tell apart foretold by `identify plan`?

python -m tests.campaigns.foretold_pairs --found out/blind.found --cases out/blind

A pair counts where a diagnosis of `blind_gap diagnose` names an effect and, in its place, a look-alike. The plan of a
test like the recording, of the rig that its owner believes, foretells the pair if either effect stands among the
other's look-alikes.
"""

from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from rich.console import Console

from identify.planning.detectable import DetectableEffect, detectable_effects
from identify.planning.planned_test import planned_test
from rig.commands.command_line import run
from rig.recording import read
from rig.simulation.replay import modal

app = typer.Typer()

SIMULATED_S = 20.0
SEED = 1


def confused_pairs(gap: dict[str, Any]) -> list[tuple[str, str]]:
    """Effects of the likeliest cause that are named, each with an effect that the records do not tell from it."""
    return [
        (strength["effect"], look_alike)
        for cause in gap["causes"][:1]
        for strength in cause["strengths"]
        for look_alike in strength.get("instead", ())
    ]


def is_foretold(pair: tuple[str, str], look_alikes: dict[str, tuple[str, ...]]) -> bool:
    """True if the plan lists either effect among the look-alikes of the other."""
    first, second = pair
    return second in look_alikes.get(first, ()) or first in look_alikes.get(second, ())


def look_alikes_by_effect(effects: tuple[DetectableEffect, ...]) -> dict[str, tuple[str, ...]]:
    """Look-alikes of every effect of a plan, by its name and places ("one_stop:contact_1:upper")."""
    return {":".join([e.effect, *filter(None, e.place.split(", "))]): e.alike for e in effects}


@app.command()
def compare(
    found: Annotated[list[Path], typer.Option(help="Folders that `blind_gap diagnose` wrote.")],
    cases: Annotated[list[Path], typer.Option(help="Their folders of cases, in the same order.")],
) -> None:
    """Print every confused pair, and whether the plan of its test foretells it."""
    console, foretold_count, pair_count = Console(), 0, 0
    for found_folder, case_folder in zip(found, cases, strict=True):
        for answer in msgspec.json.decode((found_folder / "found.json").read_bytes()):
            pairs = confused_pairs(answer["gap"]) if answer.get("gap") else []
            if not pairs:
                continue
            case = f"{found_folder.name}, {answer['case']}"
            test = planned_test(read(case_folder / "recordings" / f"{answer['case']}.mcap"))
            if not test.rig.contacts:
                console.print(f"{case}: no plan, as the rig has no contacts")
                continue
            look_alikes = look_alikes_by_effect(detectable_effects(test, modal, SEED, SIMULATED_S))
            for pair in pairs:
                foretold = is_foretold(pair, look_alikes)
                pair_count, foretold_count = pair_count + 1, foretold_count + foretold
                words = (
                    "foretold" if foretold else f"not foretold; {pair[0]} ~ {look_alikes.get(pair[0], 'not planned')}"
                )
                console.print(f"{case}: {pair[0]} ~ {pair[1]}: {words}", soft_wrap=True)
    console.print(f"{foretold_count} of {pair_count} pairs are foretold")


if __name__ == "__main__":
    run(import_module("tests.campaigns.foretold_pairs").app, "tests.campaigns.foretold_pairs")
