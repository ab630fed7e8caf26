"""Fifteen rigs, from nothing to a clearance by what the READMEs say: python -m tests.campaigns.fifteen_rigs."""

import argparse
import json
import time
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


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns.fifteen_rigs", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/fifteen"))
    parser.add_argument("--only", nargs="*", choices=list(RIGS), help="these rigs alone")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--identify-again", action="store_true", help="from the CSV files that are there")
    asked = parser.parse_args()
    results = []
    for seed in range(asked.first_seed, asked.first_seed + asked.seeds):
        for name in asked.only or RIGS:
            folder = asked.out / f"{name}_{seed}"
            begin = time.monotonic()
            results.append(solved(name, seed, folder, asked.identify_again))
            print(f"{name} {seed}: {time.monotonic() - begin:.0f} s  {summary(results[-1])}", flush=True)
    show(results)


def solved(name: str, seed: int, folder: Path, again: bool) -> dict[str, Any]:
    kept = folder / "result.json"
    if kept.exists() and not again:
        return dict(json.loads(kept.read_bytes()))
    folder.mkdir(parents=True, exist_ok=True)
    rig = RIGS[name]
    truth = rig.measure(folder, np.random.default_rng([seed, *name.encode()]))
    session = UserSession(folder)
    rig.describe(session)
    session.run(TAIL)
    found = session.run("identify contact run.mcap --out contact --force")
    result: dict[str, Any] = {"rig": name, "seed": seed, "commands": len(session.done), "edits": session.edits}
    result["seconds"] = sum(c.seconds for c in session.done)
    result["refused"] = [f"{c.words}\n{c.said}" for c in session.done if c.status]
    result["runs"] = [asdict(c) for c in session.done]
    if not found.status:
        result |= answers(folder / "contact", list(truth))
    kept.write_text(json.dumps(result, indent=1))
    return result


def summary(result: dict[str, Any]) -> str:
    lines = [f"REFUSED {r}" for r in result["refused"]]
    lines += [f"unanswered {u}" for u in result.get("unanswered", [])]
    lines += [f"finding {f}" for f in result.get("findings", [])]
    for name, (value, half, true) in result.get("values", {}).items():
        miss = abs(value - true) / half if half else float("inf")
        lines.append(f"{name}: {100 * (value / true - 1):+.2f} ± {100 * half / abs(true):.2f} % ({miss:.2f})")
    return "\n    ".join(["", *lines])


def show(results: list[dict[str, Any]]) -> None:
    table = Table("rig", "seed", "commands", "s")
    for r in results:
        table.add_row(r["rig"], str(r["seed"]), str(r["commands"]), f"{r['seconds']:.0f}")
    Console(width=150).print(table)


if __name__ == "__main__":
    main()
