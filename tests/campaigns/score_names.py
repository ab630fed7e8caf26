"""What a diagnosis names, as scores read it: effects with their places and values, each with its look-alikes."""

from collections import Counter

from identify.gaps.decision_table import Verdict
from identify.gaps.results import Cause, Gap
from tests.campaigns.score_effects import Estimate, Named

NAMING = (Verdict.SMALL, Verdict.EXPLAINED, Verdict.PARTLY_EXPLAINED)
"""The verdicts that name effects."""
NamedClass = tuple[Named, ...]
"""An effect and those that the records do not tell it from."""


def named_classes(gap: Gap) -> tuple[NamedClass, ...]:
    """The named effects of the first cause, none unless the verdict names some."""
    if gap.verdict not in NAMING or not gap.causes:
        return ()
    first = gap.causes[0]
    classes = classes_of(first, gap)
    return tuple(one for one, strength in zip(classes, first.strengths, strict=True) if strength.is_named)


def classes_of(cause: Cause, gap: Gap) -> tuple[NamedClass, ...]:
    """Every effect of a cause with its look-alikes, as the causes have them that hold them in its place."""
    own = Counter(strength.effect for strength in cause.strengths)
    return tuple(
        (one, *(found for name in strength.instead if (found := _stand_in(name, own, gap)) is not None))
        for one, strength in zip(effects_of(cause), cause.strengths, strict=True)
    )


def effects_of(cause: Cause) -> tuple[Named, ...]:
    """In their order."""
    return tuple(_named(cause, k) for k in range(len(cause.effects)))


def likeliest_set(gap: Gap) -> Cause | None:
    return max(gap.causes, key=lambda cause: cause.probability, default=None)


def _stand_in(name: str, own: Counter[str], gap: Gap) -> Named | None:
    """An effect by its candidate's name, from the first cause that has it more often."""
    for cause in gap.causes:
        at = [k for k, strength in enumerate(cause.strengths) if strength.effect == name]
        if len(at) > own[name]:
            return _named(cause, at[-1])
    return None


def _named(cause: Cause, k: int) -> Named:
    label = f"{cause.labels[k]}."
    values = {n.removeprefix(label): v for n, v in cause.parameters.items() if n.startswith(label)}
    return Named(
        name=cause.effects[k],
        place={n.removeprefix(label): place for n, place in cause.places.items() if n.startswith(label)},
        values={field: Estimate(v.value, v.standard_error) for field, v in values.items()},
    )
