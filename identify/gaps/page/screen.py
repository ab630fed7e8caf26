"""Diagnosis on the screen: sentence, table of causes, unmeasured force and next steps."""

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from identify.gaps.decision_table import Verdict
from identify.gaps.page.advice import next_steps
from identify.gaps.results import Gap
from identify.gaps.wording import (
    WHEN,
    cause_name,
    interval,
    not_computed,
    probability,
    remaining_probabilities,
    removed_share_words,
    unexplained_words,
    verdict,
)
from identify.pages.page import Colour
from identify.pages.wording import number, percent
from rig.model.unmeasured_force import UnmeasuredForce

COLOURS: dict[Verdict, Colour] = {
    Verdict.CONSISTENT: "green",
    Verdict.CANNOT_TELL: "yellow",
    Verdict.SMALL: "green",
    Verdict.EXPLAINED: "green",
    Verdict.PARTLY_EXPLAINED: "yellow",
    Verdict.UNEXPLAINED: "red",
}
MAX_CAUSES = 5
"""Rows of causes in the table at most."""


def colour(gap: Gap) -> Colour:
    return COLOURS[gap.verdict]


def screen_view(gap: Gap) -> RenderableType:
    """Sentence, causes with what each removes and leaves, unmeasured force, and next steps."""
    lines: list[RenderableType] = [
        Text.assemble((verdict(gap), f"bold {colour(gap)}"), ": ", gap.sentence),
        _cause_table(gap),
    ]
    if gap.unknown:
        lines.append(
            Text.assemble(("what is unknown: ", "bold"), gap.unknown.sentence, f"; {_unknown_summary(gap.unknown)}")
        )
    lines += [Text(note) for note in not_computed(gap)]
    lines.append(Text("what to do next:", style="bold"))
    steps = Table.grid(padding=(0, 1))
    for i, step in enumerate(next_steps(gap), 1):
        steps.add_row(f" {i}.", Text(step))
    return Group(*lines, steps)


def _unknown_summary(unknown: UnmeasuredForce) -> str:
    """Size, band, times and explained share of an unmeasured force."""
    low, high = unknown.band_hz
    unit = "m/s²" if unknown.kind == "sensor" else "N"
    when = "" if unknown.when == "always" else f", {WHEN[unknown.when]}"
    return (
        f"{number(unknown.rms_n, 3)} {unit} rms, mostly from {low:.3g} to {high:.3g} Hz{when}; it explains "
        f"{percent(unknown.explained)} of the linear residual's mean square"
    )


def _cause_table(gap: Gap) -> Table:
    """Table of causes, no cause and something unmeasured, whose probabilities sum to one."""
    table = Table("cause", "probability", "closes (95 %)", "leaves")
    table.add_column("parameters ± 95 %", overflow="fold")
    for cause in gap.causes[:MAX_CAUSES]:
        parameter_lines = "\n".join(f"{name} {interval(value)}" for name, value in cause.parameters.items())
        row = (
            cause_name(cause),
            probability(cause.probability),
            removed_share_words(cause),
            unexplained_words(cause.left),
            parameter_lines,
        )
        table.add_row(*(Text(cell) for cell in row))
    if further := gap.causes[MAX_CAUSES:]:
        table.add_row(f"{len(further)} further", probability(sum(c.probability for c in further)), "", "", "")
    (nominal_words, nominal_probability), unmeasured = remaining_probabilities(gap)
    table.add_row(nominal_words, probability(nominal_probability), "", Text(unexplained_words(gap.before)), "")
    table.add_row(unmeasured[0], probability(unmeasured[1]), "", "", "")
    return table
