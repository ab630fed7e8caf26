"""Diagnosis on the screen: sentence, causes, unmeasured force and next steps."""

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from identify.gaps.decision.verdict import RIVAL_PROBABILITY
from identify.gaps.decision_table import Verdict
from identify.gaps.page.advice import next_steps
from identify.gaps.results import Cause, Gap
from identify.gaps.wording import (
    WHEN_WORDS,
    cause_name,
    failed_analysis_sentences,
    interval,
    probability,
    remaining_probabilities,
    removed_share_words,
    unexplained_words,
    verdict_words,
)
from identify.pages.page import Colour
from identify.pages.wording import number, percent
from rig.model.unmeasured_force import UnmeasuredForce

COLOUR_BY_VERDICT: dict[Verdict, Colour] = {
    Verdict.CONSISTENT: "green",
    Verdict.CANNOT_TELL: "yellow",
    Verdict.SMALL: "green",
    Verdict.EXPLAINED: "green",
    Verdict.PARTLY_EXPLAINED: "yellow",
    Verdict.UNEXPLAINED: "red",
}
MAX_CAUSES = 5
"""Causes shown one by one at most."""


def screen_view(gap: Gap) -> RenderableType:
    """Sentence, causes with what each removes and leaves, unmeasured force, and next steps."""
    renderables: list[RenderableType] = [
        Text.assemble((verdict_words(gap), f"bold {COLOUR_BY_VERDICT[gap.verdict]}"), ": ", gap.sentence),
        _cause_table(gap),
    ]
    if gap.unknown:
        summary = f"; {_unmeasured_force_summary(gap.unknown)}"
        renderables.append(Text.assemble(("what is unknown: ", "bold"), gap.unknown.sentence, summary))
    renderables += [Text(note) for note in failed_analysis_sentences(gap)]
    renderables.append(Text("what to do next:", style="bold"))
    steps = Table.grid(padding=(0, 1))
    for step_number, step in enumerate(next_steps(gap), 1):
        steps.add_row(f" {step_number}.", Text(step))
    return Group(*renderables, steps)


def _unmeasured_force_summary(unknown: UnmeasuredForce) -> str:
    """Size, band, times and explained share of an unmeasured force."""
    low_hz, high_hz = unknown.band_hz
    force_unit = "m/s²" if unknown.kind == "sensor" else "N"
    time_words = "" if unknown.when == "always" else f", {WHEN_WORDS[unknown.when]}"
    return (
        f"{number(unknown.rms_n, 3)} {force_unit} rms, mostly from {low_hz:.3g} to {high_hz:.3g} Hz{time_words}; it "
        f"explains {percent(unknown.explained)} of the linear residual's mean square"
    )


def _cause_table(gap: Gap) -> RenderableType:
    """Causes, no cause and something unmeasured, whose probabilities sum to one, each with its numbers in lines."""
    causes = [(_cause_text(cause), cause.probability) for cause in gap.causes[:MAX_CAUSES]]
    *further, (nominal_words, nominal_probability), unmeasured = remaining_probabilities(gap, MAX_CAUSES)
    nominal = (f"{nominal_words}: leaves {unexplained_words(gap.before)}", nominal_probability)
    table = Table.grid(padding=(0, 2))
    table.add_column(justify="right", no_wrap=True)
    for words, cause_probability in (*causes, *further, nominal, unmeasured):
        table.add_row(probability(cause_probability), Text(words))
    return Group(Text("causes by probability (± 95 %):", style="bold"), table)


def _cause_text(cause: Cause) -> str:
    """Name of a cause, what it removes and leaves, and its parameters, a line each, unless it is unlikely."""
    name_line = f"{cause_name(cause)}: removes {removed_share_words(cause)}, leaves {unexplained_words(cause.left)}"
    parameters = cause.parameters if cause.probability > RIVAL_PROBABILITY else {}
    return "\n".join([name_line, *(f"  {name} {interval(value)}" for name, value in parameters.items())])
