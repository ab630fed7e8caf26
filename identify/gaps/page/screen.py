"""A diagnosis on the screen."""

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from identify.gaps.decision_table import Verdict
from identify.gaps.page.advice import next_steps
from identify.gaps.results import Gap
from identify.gaps.wording import WHEN, cause_name, closes, interval, leaves, not_computed, others, probability, verdict
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
MOST = 5
"""Causes in the table."""


def colour(gap: Gap) -> Colour:
    return COLOURS[gap.verdict]


def shown(gap: Gap) -> RenderableType:
    """The sentence, the causes with what each closes and leaves, the unknown force, and what to do next."""
    lines: list[RenderableType] = [
        Text.assemble((verdict(gap), f"bold {colour(gap)}"), ": ", gap.sentence),
        _table(gap),
    ]
    if gap.unknown:
        lines.append(Text.assemble(("what is unknown: ", "bold"), gap.unknown.sentence, f"; {in_short(gap.unknown)}"))
    lines += [Text(note) for note in not_computed(gap)]
    lines.append(Text("what to do next:", style="bold"))
    steps = Table.grid(padding=(0, 1))
    for i, step in enumerate(next_steps(gap), 1):
        steps.add_row(f" {i}.", Text(step))
    return Group(*lines, steps)


def in_short(unknown: UnmeasuredForce) -> str:
    """Its size, its band, when it acts, and how much it explains."""
    low, high = unknown.band_hz
    unit = "m/s²" if unknown.kind == "sensor" else "N"
    when = "" if unknown.when == "always" else f", {WHEN[unknown.when]}"
    return (
        f"{number(unknown.rms_n, 3)} {unit} rms, mostly from {low:.3g} to {high:.3g} Hz{when}; it explains "
        f"{percent(unknown.explained)} of the linear residual's mean square"
    )


def _table(gap: Gap) -> Table:
    """Probabilities sum to one."""
    table = Table("cause", "probability", "closes (95 %)", "leaves")
    table.add_column("parameters ± 95 %", overflow="fold")
    for cause in gap.causes[:MOST]:
        found = "\n".join(f"{name} {interval(value)}" for name, value in cause.parameters.items())
        row = (cause_name(cause), probability(cause.probability), closes(cause), leaves(cause.left), found)
        table.add_row(*(Text(cell) for cell in row))
    if further := gap.causes[MOST:]:
        table.add_row(f"{len(further)} further", probability(sum(c.probability for c in further)), "", "", "")
    (nominal, likely), unmeasured = others(gap)
    table.add_row(nominal, probability(likely), "", Text(leaves(gap.before)), "")
    table.add_row(unmeasured[0], probability(unmeasured[1]), "", "", "")
    return table
