"""Fifteen rigs, from nothing to a clearance by what the READMEs say: python -m tests.campaigns.fifteen_rigs."""

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tests.campaigns.fifteen_rigs.field_rig import TAIL, FieldRig
from tests.campaigns.fifteen_rigs.rigs_beams import RIGS as BEAMS
from tests.campaigns.fifteen_rigs.rigs_lumped import RIGS as LUMPED
from tests.campaigns.fifteen_rigs.rigs_pairs import RIGS as PAIRS
from tests.campaigns.fifteen_rigs.session import UserSession, answers

RIGS: dict[str, FieldRig] = {**BEAMS, **LUMPED, **PAIRS}
ANSWERED = ("clearance_m", "stiffness_n_per_m", "damping_n_s_per_m")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns.fifteen_rigs", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/fifteen"))
    parser.add_argument("--only", nargs="*", choices=list(RIGS), help="these rigs alone")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--table", action="store_true", help="of what is there, without further runs")
    asked = parser.parse_args()
    cases = [(name, seed) for seed in range(1, asked.seeds + 1) for name in asked.only or RIGS]
    results = []
    for number, (name, seed) in enumerate(cases, start=1):
        folder, begin = asked.out / f"{name}_{seed}", time.monotonic()
        if asked.table and not (folder / "result.json").exists():
            continue
        results.append(solved(name, seed, folder))
        if not asked.table:
            print(f"{number} of {len(cases)}, {name} {seed}: {time.monotonic() - begin:.0f} s", flush=True)
            print(*(f"    {line}" for line in told(results[-1])), sep="\n", flush=True)
    show(results)


def solved(name: str, seed: int, folder: Path) -> dict[str, Any]:
    """The kept result, or the machine measured, described, imported and identified."""
    kept = folder / "result.json"
    if kept.exists():
        return dict(json.loads(kept.read_bytes()))
    folder.mkdir(parents=True, exist_ok=True)
    rig = RIGS[name]
    truth = list(rig.measure(folder, np.random.default_rng([seed, *name.encode()])))
    session = UserSession(folder)
    rig.describe(session)
    session.run(TAIL)
    session.run("identify contact run.mcap --out contact --force")
    result: dict[str, Any] = {"rig": name, "seed": seed, "commands": len(session.done), "edits": session.edits}
    result["seconds"] = sum(c.seconds for c in session.done)
    result["refused"] = [f"{c.words}\n{c.said}" for c in session.done if c.status]
    if not result["refused"]:
        result |= answers(folder / "contact", truth)
        if rig.remedy and (result["findings"] or result["unanswered"]):
            again = session.run(f"identify contact run.mcap {rig.remedy} --out remedied --force")
            result["remedied"] = {"refused": again.said} if again.status else answers(folder / "remedied", truth)
    result["runs"] = [asdict(c) for c in session.done]
    kept.write_text(json.dumps(result, indent=1), encoding="utf-8")
    return result


def told(result: dict[str, Any]) -> Iterator[str]:
    """What was refused, found and answered, one line each."""
    yield from (f"refused: {r}" for r in result.get("refused", []))
    yield from (f"unanswered: {u}" for u in result.get("unanswered", []))
    yield from (f"finding: {f}" for f in result.get("findings", []))
    for name, (value, half, true) in result.get("values", {}).items():
        yield f"{name}: {100 * (value / true - 1):+.2f} ± {100 * half / abs(true):.2f} %"
    if "remedied" in result:
        yield "after the remedy:"
        yield from told(result["remedied"])


def show(results: list[dict[str, Any]]) -> None:
    """A row a rig: largest error and interval over its seeds and contacts, values inside, what was said against it."""
    columns = ("rig", "commands, edits, s", "clearance off by, %", "stiffness off by, %", "inside", "findings, refused")
    table = Table(*columns, "after the remedy: clearance, stiffness, inside")
    for name in dict.fromkeys(r["rig"] for r in results):
        runs = [r for r in results if r["rig"] == name]
        seconds = np.mean([r["seconds"] for r in runs])
        against = (
            sum(bool(r.get("findings")) for r in runs),
            sum(bool(r["refused"] or r.get("unanswered")) for r in runs),
        )
        errors = worst_errors(runs)
        table.add_row(
            name,
            f"{runs[0]['commands']}, {runs[0]['edits']}, {seconds:.0f}",
            *(errors if len(errors) == len(ANSWERED) else ["", "", ""]),
            f"{against[0]}, {against[1]} of {len(runs)}",
            ", ".join(worst_errors([r["remedied"] for r in runs if "remedied" in r])),
        )
    Console(width=150).print(table)
    inside = [abs(value - true) <= half for r in results for _, (value, half, true) in answered(r)]
    print(f"{sum(inside)} of {len(inside)} clearances, stiffnesses and dampings within their 95 % intervals")
    for quantity in ANSWERED:
        halves = [half / true for r in results for name, (_, half, true) in answered(r) if name.endswith(quantity)]
        print(f"half the interval of {quantity}, median: {100 * np.median(halves):.2f} %")


def answered(result: dict[str, Any]) -> list[tuple[str, list[float]]]:
    return [(name, v) for name, v in result.get("values", {}).items() if name.split()[-1] in ANSWERED]


def worst_errors(results: list[dict[str, Any]]) -> list[str]:
    """Largest error of clearance and of stiffness with the median interval, and how many values are inside."""
    values = [item for r in results for item in answered(r)]
    if not values:
        return [""]
    texts = []
    for quantity in ANSWERED[:2]:
        shares = [(abs(v / true - 1), half / abs(true)) for name, (v, half, true) in values if name.endswith(quantity)]
        largest, interval = 100 * np.max(shares, axis=0)[0], 100 * np.median(shares, axis=0)[1]
        texts.append(f"{largest:.2f} (± {interval:.2f})")
    inside = [abs(value - true) <= half for _, (value, half, true) in values]
    return [*texts, f"{sum(inside)} of {len(inside)}"]


if __name__ == "__main__":
    main()
