"""Whether answers say what their own numbers say: a table of violations, and how many answers have none.

python -m tests.campaigns.consistency out/found/found.json results/gap.json
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace
from rich.console import Console
from rich.table import Table

from identify.gaps.decision_table import NAMED_PROBABILITY, USUAL_P_VALUE, Bounded, Verdict, are_all_below_threshold
from identify.gaps.results import Gap
from rig.commands.command_line import run
from tests.campaigns.blind_comparison import decoded
from tests.campaigns.blind_diagnosis import Found

SHARE = "1"
"""The unit of a share; contact parameters have others."""
Rule = Callable[[Gap], Iterator[str]]
"""What violates it in an answer, each in a sentence."""

app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def consistency(
    files: Annotated[list[Path], typer.Argument(help="found.json of `blind_gap diagnose`, or gap.json.")],
) -> None:
    """Holds every answer against its own numbers; the exit code is 1 if any says something else."""
    table = Table(title="Answers that their own numbers contradict")
    for heading in ("answer", "rule", "violated by"):
        table.add_column(heading, overflow="fold")
    answers = [pair for path in files for pair in answers_of(path)]
    for name, gap in answers:
        for rule, sentence in violations(gap):
            table.add_row(name, rule, sentence)
    console = Console()
    console.print(table)
    console.print(f"{table.row_count} violations in {len(answers)} answers", highlight=False)
    if table.row_count:
        raise typer.Exit(1)


def answers_of(path: Path) -> list[tuple[str, Gap]]:
    """With a name each."""
    if path.name == "found.json":
        return [(f"{path.parent.name}/{found.case}", found.gap) for found in decoded(path, list[Found])]
    return [(str(path), decoded(path, Gap))]


def violations(gap: Gap) -> list[tuple[str, str]]:
    """Rules that the answer violates, and by what."""
    return [(name, sentence) for name, rule in RULES.items() for sentence in rule(gap)]


def _by_the_table(gap: Gap) -> Iterator[str]:
    if gap.verdict != gap.evidence.verdict:
        yield f"{gap.verdict}, by its evidence {gap.evidence.verdict}"


def _leaves_nothing_that_matters(gap: Gap) -> Iterator[str]:
    evidence = gap.evidence
    if (
        gap.verdict == Verdict.EXPLAINED
        and evidence.p_value_after < USUAL_P_VALUE
        and not are_all_below_threshold(evidence.quantities_after)
    ):
        names = [one.name for one in evidence.quantities_after if not one.holds]
        yield f"p = {evidence.p_value_after:.2g}, {', '.join(names) or 'nothing looked at'}"


def _no_share_above_the_whole(gap: Gap) -> Iterator[str]:
    """It decides where the verdict is another one without it, or where `explained` leaves it to noise."""
    evidence = gap.evidence
    known = tuple(one for one in evidence.quantities if not _above_the_whole(one))
    if known and known != evidence.quantities:
        without = replace(evidence, quantities=known).verdict
        if without != gap.verdict:
            yield f"{without} without {_names(evidence.quantities)}"
    if gap.verdict == Verdict.EXPLAINED and any(map(_above_the_whole, evidence.quantities_after)):
        yield f"explained, and leaves {_names(evidence.quantities_after)}"


def _above_the_whole(one: Bounded) -> bool:
    return one.unit == SHARE and one.value is not None and one.value > 1


def _names(quantities: tuple[Bounded, ...]) -> str:
    return ", ".join(f"{100 * (one.value or 0):.0f} % of {one.name}" for one in quantities if _above_the_whole(one))


def _names_are_sure(gap: Gap) -> Iterator[str]:
    strengths = gap.evidence.strengths
    for name in gap.criteria.named:
        sure = [s.inclusion_probability >= NAMED_PROBABILITY and _apart(*s.interval_95, s.neutral) for s in strengths]
        if not any(s.effect == name and is_sure for s, is_sure in zip(strengths, sure, strict=True)):
            told = [f"{s.inclusion_probability:.3g}, {s.interval_95} about {s.neutral:g}" for s in strengths]
            own = [text for s, text in zip(strengths, told, strict=True) if s.effect == name]
            yield f"{name}: {'; '.join(own) or 'no strength'}"


def _apart(low: float, high: float, neutral: float) -> bool:
    return not low <= neutral <= high


def _contacts_were_seen(gap: Gap) -> Iterator[str]:
    if gap.verdict != Verdict.CONSISTENT:
        return
    parameters = [one for one in gap.evidence.quantities if one.unit != SHARE]
    if gap.before.contact_shares and not parameters:
        yield "no contact's parameters were looked at"
    for one in parameters:
        if one.value is None or not one.value < one.threshold:
            yield f"{one.name}: {one.value} {one.unit} off, three tolerances are {one.threshold:.3g}"


def _no_veto(gap: Gap) -> Iterator[str]:
    if gap.verdict == Verdict.EXPLAINED and gap.rollout is not None and gap.rollout.vetoed:
        yield f"prediction: {gap.rollout.code}"


RULES: dict[str, Rule] = {
    "the verdict is that of the table": _by_the_table,
    "explained leaves nothing that matters, or p says noise": _leaves_nothing_that_matters,
    "no share above 100 % decides": _no_share_above_the_whole,
    "no name has its neutral value in its interval": _names_are_sure,
    "consistent has every contact within three tolerances": _contacts_were_seen,
    "explained predicts no worse": _no_veto,
}


if __name__ == "__main__":
    run(app, "tests.campaigns.consistency")
