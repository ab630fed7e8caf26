"""Section of gap.html on the decision: the row of the table, what matters, names, the prediction."""

from html import escape

from identify.gaps.decision_table import DIFFERS, NAMED, USUAL, Bounded
from identify.gaps.results import Gap
from identify.gaps.rollout.results import Rollout
from identify.gaps.wording import VERDICTS, capital, chance, probability
from identify.pages import page
from identify.pages.wording import number, percent

TOLD = {
    "not_vetoed": "nothing speaks against it",
    "worse": "the corrected rig predicts worse: no explanation",
    "no_improvement": "the prediction would improve if this were all, and does not: no explanation",
    "no_horizon": "null simulations cannot be predicted either",
    "too_short": "the record has too few seconds",
    "not_simulated": "the simulator cannot start from measured states",
}
"""What the prediction says, by its code."""


def decided(gap: Gap) -> str:
    """The four questions with their answers, and the numbers that they follow from."""
    evidence, criteria = gap.evidence, gap.criteria
    rows = [
        ("Is there a difference?", _yes(criteria.differs), f"{chance(evidence.p_value)}: yes below {DIFFERS:g}"),
        ("Is all that matters bounded?", _yes(criteria.bounded), "yes if every upper bound lies below its limit"),
        (
            "Is an effect named?",
            _yes(bool(criteria.named)),
            f"yes from a probability of {percent(NAMED)} on, if the interval excludes no effect",
        ),
        (
            "Is that enough?",
            _yes(criteria.enough) if criteria.named else "",
            f"{chance(evidence.p_value_after)} of what is left: yes from {USUAL:g} on, or if that is bounded",
        ),
    ]
    text = f"<p>Four questions decide; their answers give: {escape(VERDICTS[gap.verdict])}.</p>" + page.table(
        ("", "", ""), rows
    )
    text += "<h3>What matters</h3>" + page.table(
        ("quantity", "found", "at most (97.5 %)", "limit", ""), [_row(one) for one in evidence.quantities]
    )
    if gap.causes:
        first = gap.causes[0]
        strengths = zip(first.words, first.strengths, strict=True)
        names = [(w, probability(s.inclusion_probability), "named" if s.is_named else "") for w, s in strengths]
        text += "<h3>Effects</h3>" + page.table(("effect", "probability", ""), names)
    return text + (_prediction(gap.rollout) if gap.rollout else "")


def _yes(answer: bool) -> str:
    return "yes" if answer else "no"


def _row(one: Bounded) -> tuple[str, ...]:
    if one.value is None or one.upper is None:
        return one.name, "", "", "", f"not seen: {one.why}"
    mark = "" if one.holds else "not seen" if one.not_seen else "beyond"
    if one.unit == "1":
        return one.name, percent(one.value), percent(one.upper), percent(one.threshold), mark
    return (one.name, *(f"{number(x, 3)} {one.unit}" for x in (one.value, one.upper, one.threshold)), mark)


def _prediction(rollout: Rollout) -> str:
    text = f"<h3>Prediction from measured states</h3><p>{escape(capital(TOLD[rollout.code]))}.</p>"
    whole = rollout.whole
    if whole is None:
        return text
    floor = (
        "rig.json is at the floor of what can be predicted"
        if whole.at_floor
        else f"the corrected rig closes {percent(whole.shrunk or 0.0)} of what null simulations do not have"
    )
    rows = [
        ("rig.json", percent(whole.nominal)),
        ("rig.json within its tolerances", percent(rollout.within or 0.0)),
        ("corrected rig", percent(whole.corrected)),
        ("null simulations, median and 95 %", f"{percent(whole.null_median)}, {percent(whole.null_95)}"),
    ]
    return text + (
        f"<p>Median error over {rollout.windows} windows of {rollout.horizon_s:.3g} s, as a share of the motion: "
        f"{floor}.</p>" + page.table(("predicted by", "error"), rows)
    )
