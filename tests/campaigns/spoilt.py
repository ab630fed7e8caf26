"""Spoilt recordings: what `identify check` names, and whether anything that it does not name falsifies an answer.

python -m tests.campaigns.spoilt --seed 1 --sound 20 --out out/spoilt
"""

from collections.abc import Iterator, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer
from msgspec.structs import replace
from rich.console import Console
from rich.progress import track
from rich.table import Table

from identify.checks import Finding, check_recording
from identify.contacts.acceptance import estimated_contacts
from identify.contacts.joint_fit import JointEstimate
from identify.contacts.law_form import STIFFNESS_GRADIENT
from rig import RigError
from rig.commands.command_line import run
from rig.files import write_json
from rig.model.tolerances import LABORATORY
from rig.recording import Recording, read
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle
from scenarios.jitter import jittered
from tests.campaigns.spoiling.alteration import Alteration
from tests.campaigns.spoiling.alterations import alterations
from tests.campaigns.topologies import RIGS, Topology, one_mass
from tests.campaigns.worlds.drawing import drawn_case
from tests.campaigns.worlds.instruments import measured
from tests.campaigns.worlds.making import write

LIE = 3.0
"""An answer that is off by more of its own standard errors, without a finding, is a lie."""
MASSES = {
    "one mass, displacement": Topology(one_mass(5e-4), 6.0, ""),
    "one mass, accelerometer": Topology(one_mass(5e-4, quantity="acceleration"), 6.0, ""),
    "frame": RIGS["frame, free"],
}
BEAMS = "two beams"
Truth = dict[str, tuple[float, float]]
app = typer.Typer(pretty_exceptions_enable=False)


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """What was said of one alteration. worst is the largest error in standard errors where nothing was said."""

    rig: str
    alteration: str
    group: str
    findings: tuple[str, ...]
    right: tuple[bool, ...]
    worst: float | None = None
    refused: bool = False

    @property
    def lies(self) -> bool:
        return self.worst is not None and self.worst > LIE


@app.command()
def spoilt(
    out: Annotated[Path, typer.Option(help="Folder for the recordings and spoilt.json.")] = Path("out/spoilt"),
    seed: Annotated[int, typer.Option(help="Of the rigs, the records and the channels that are spoilt.")] = 1,
    sound: Annotated[int, typer.Option(help="How many sound recordings of each rig are checked too.")] = 10,
    duration: Annotated[float, typer.Option(help="Of each record, s.")] = 30.0,
) -> None:
    """Spoils a recording of each rig in every way, checks it, and identifies what no finding speaks against."""
    out.mkdir(parents=True, exist_ok=True)
    cases: list[Case] = []
    false: dict[str, tuple[int, list[str]]] = {}
    console = Console(stderr=True)
    for name in (BEAMS, *MASSES):
        recording, truth = recorded(name, out, seed, 0, duration)
        every = list(alterations(recording.rig, np.random.default_rng(seed)))
        done = _kept(out, seed)
        for alteration in track(every, name, console=console):
            case = done.get((name, alteration.name)) or of_one(name, alteration, recording, truth)
            cases.append(case)
            if (name, alteration.name) not in done:
                with _kept_path(out, seed).open("ab") as file:
                    file.write(msgspec.json.encode(case) + b"\n")
        wrong = []
        for k in track(range(1, sound + 1), f"{name}, sound", console=console):
            wrong += [f.sentence for f in check_recording(recorded(name, out, seed, k, duration)[0])[:1]]
        false[name] = (sound, wrong)
    write_json({"cases": cases, "sound": false}, out / "spoilt.json")
    for case in cases:
        if case.lies or not any(case.right):
            console.print(_told(case), highlight=False, soft_wrap=True)
    Console().print(table(cases, false))


def _kept_path(out: Path, seed: int) -> Path:
    return out / f"cases_{seed}.jsonl"


def _kept(out: Path, seed: int) -> dict[tuple[str, str], Case]:
    """Cases of an earlier run, by rig and alteration."""
    path = _kept_path(out, seed)
    cases = (msgspec.json.decode(line, type=Case) for line in path.read_text().splitlines()) if path.exists() else ()
    return {(case.rig, case.alteration): case for case in cases}


def _told(case: Case) -> str:
    said = f"names {case.findings[0]}" if case.findings else f"silent, {case.worst} standard errors off"
    return f"{case.rig}: {case.alteration}: {said}"


def recorded(
    name: str, out: Path, seed: int, number: int, duration_s: float, path: Path | None = None
) -> tuple[Recording, Truth]:
    """A sound recording as a laboratory makes it, and the true clearance and stiffness of its contacts."""
    path = path or out / f"{name.replace(' ', '_').replace(',', '')}_{seed}_{number}.mcap"
    if name == BEAMS:
        drawn = drawn_case("wide", 9000 + seed, number, nulls_only=True)
        rate = drawn.rig.sample_rate_hz
        if not path.exists():
            samples = round(duration_s * rate)
            write(path, drawn.rig, measured(drawn.true, drawn.excitations[0], samples, rate, drawn.seeds[0]))
        laws = {c.name: c.law for c in drawn.true.contacts}
        truth = {
            n: ((x.lower_m + x.upper_m) / 2, (x.stiffness_below_n_per_m + x.stiffness_above_n_per_m) / 2)
            for n, x in laws.items()
        }
        return read(path), truth
    case = MASSES[name]
    if not path.exists():
        record(
            case.rig,
            replace(BarrelCradle(rms_n=case.rms_n, duration_s=duration_s).force(), seed=1000 * seed + number),
            plant=partial(modal.simulate, modes_per_beam=20),
            duration_s=duration_s,
            step_s=2.0**-15,
            path=path,
            progress=lambda _: None,
            actual=jittered(case.rig, np.random.default_rng([seed, number])),
        )
    return read(path), {c.name: (c.law.clearance_m, c.law.stiffness_n_per_m) for c in case.rig.contacts}


def of_one(rig: str, alteration: Alteration, recording: Recording, truth: Truth) -> Case:
    """One alteration: checked, and identified where the check finds nothing."""
    changed = alteration.change(recording)
    findings = check_recording(changed)
    worst = None
    refused = False
    if not findings:
        try:
            found = estimated_contacts(changed, "auto", LABORATORY)
        except RigError:
            refused = True
        else:
            findings = found.findings
            errors = list(_errors(found.outcomes.estimates, truth))
            refused = not errors
            worst = None if findings or refused else max(errors)
    return Case(
        rig=rig,
        alteration=alteration.name,
        group=alteration.group,
        findings=tuple(f"{f.cause}: {f.sentence}" for f in findings),
        right=tuple(names_it(f, alteration) for f in findings),
        worst=worst,
        refused=refused,
    )


def names_it(finding: Finding, alteration: Alteration) -> bool:
    """Whether a finding names the cause, and one of the channels or the body."""
    anywhere = not alteration.channels and not alteration.of
    body = finding.of.rstrip("0123456789").strip()
    placed = set(finding.channels) & set(alteration.channels) or {body, finding.of} & set(alteration.of)
    return finding.cause in alteration.causes and (anywhere or bool(placed))


def _errors(estimates: Mapping[str, JointEstimate], truth: Truth) -> Iterator[float]:
    """Of every clearance and stiffness, in its own standard errors."""
    for name, estimate in estimates.items():
        clearance_m, stiffness = truth[name]
        yield abs(estimate.clearance_m - clearance_m) / estimate.clearance_error_m
        yield abs(estimate.stiffness_n_per_m - stiffness) / estimate.error(STIFFNESS_GRADIENT)


def table(cases: list[Case], false: dict[str, tuple[int, list[str]]]) -> Table:
    """A row a rig."""
    found = Table(title="Spoilt recordings")
    headings = ("rig", "alterations", "with a finding", "first finding right", "of all findings right")
    for heading in (*headings, "silent: refused or true", "silent and false", "findings on sound recordings"):
        found.add_column(heading, justify="left" if heading == "rig" else "right")
    for name in (*dict.fromkeys(c.rig for c in cases), "all"):
        own = [c for c in cases if name in (c.rig, "all")]
        told = [c for c in own if c.findings]
        every = [r for c in told for r in c.right]
        sounds = [v for k, v in false.items() if name in (k, "all")]
        found.add_row(
            name,
            str(len(own)),
            str(len(told)),
            str(sum(c.right[0] for c in told)),
            f"{sum(every)} of {len(every)}",
            str(sum(not c.findings and not c.lies for c in own)),
            str(sum(c.lies for c in own)),
            f"{sum(len(w) for _, w in sounds)} of {sum(n for n, _ in sounds)}",
        )
    return found


if __name__ == "__main__":
    run(import_module("tests.campaigns.spoilt").app, "tests.campaigns.spoilt")
