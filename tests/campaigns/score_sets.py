"""One diagnosis that names any number of effects against the truth: what was recalled, what is false, what is covered.

A named set is a tuple of classes; a class holds the look-alikes of which one is meant, mostly a single effect.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import msgspec

from identify.gaps.decision_table import Verdict
from identify.pages.wording import COVERED
from tests.campaigns.score_effects import Named, TrueOne, by_stop, within_power_law
from tests.campaigns.worlds.truth import Case, EffectTruth

WITHIN_M = 0.05
"""A place on a body is right if it is this close."""
LUMPED_WITHIN = 0.25
"""A mass that stands for several weighs what they weigh together within this share, or within three standard errors."""
OVERLAP = 0.5
"""A band is right if what it shares with the true one is this much of what both cover."""
WHERE = ("contact", "body", "beam", "sensor", "side")
NOT_REPORTED = ("reference_force_n", "reference_depth_m", "seed")
EVERYWHERE = "all"


class SetScore(msgspec.Struct, frozen=True, kw_only=True):
    """Of one case: whether each truth is named and each class stands for something true, whether the verdict is right,
    and the errors of the parameters of what is named rightly, in standard errors, as EFFECT.PARAMETER."""

    truths: tuple[TrueOne, ...]
    found: tuple[bool, ...]
    names_right: tuple[bool, ...]
    errors: tuple[tuple[str, float], ...]
    verdict_right: bool

    @property
    def visible(self) -> int:
        """Effects of the library above their limits, ..."""
        return sum(t.library and t.above for t in self.truths)

    @property
    def recalled(self) -> int:
        """... so many of them named, ..."""
        return sum(t.above for t, found in zip(self.truths, self.found, strict=True) if found)

    @property
    def true_effects(self) -> int:
        """... and of all sizes."""
        return sum(t.library for t in self.truths)

    @property
    def named_of_all(self) -> int:
        return sum(self.found)

    @property
    def false_names(self) -> int:
        return sum(not right for right in self.names_right)

    @property
    def true_alone(self) -> bool:
        """Whether something is named, and nothing that is false."""
        return bool(self.names_right) and all(self.names_right)

    @property
    def parameters(self) -> int:
        return len(self.errors)

    @property
    def covered(self) -> int:
        """Parameters whose 95 % interval holds the true value."""
        return sum(abs(error) <= COVERED for _, error in self.errors)


def true_ones(case: Case, above: Sequence[bool]) -> tuple[TrueOne, ...]:
    """What is true of a sealed case; `above` as `true_effect` says of each, of outside effects as `Best`."""
    return tuple(
        TrueOne(
            name=e.name,
            place=dict(e.place),
            whole=e.whole or e.parameters,
            above=is_above,
            library=case.kind != "outside",
            uncounted=e.uncounted,
            stand_ins=e.stand_ins,
            length_m=_length_m(case, e),
        )
        for e, is_above in zip(case.effects, above, strict=True)
    )


def _length_m(case: Case, effect: EffectTruth) -> float:
    names = [str(effect.place[field]) for field in ("body", "beam") if field in effect.place]
    return next((b.length_m for b in case.nominal.bodies if b.name in names), 0.0)


Group = tuple[TrueOne, ...]
"""True effects that one name stands for: one, or masses that are too close to be told apart."""


def score_set(
    truths: Sequence[TrueOne],
    named: Sequence[Sequence[Named]],
    verdict: Verdict,
    contacts: Sequence[str] = (),
) -> SetScore:
    """The score of one answer. `contacts`: all of the rig's, for effects that act at all of them."""
    truths, named = by_stop(truths, named)
    groups = _assigned([t for t in truths if t.library], named)
    answered = list(zip(named, groups, strict=True))
    spread = [t for t in truths if t.library and not _among(t, groups) and _at_every_contact(t, named, contacts)]
    within_laws = tuple(t for t in truths if t.library and any(_within_named_law(t, n, g) for n, g in answered))
    right = (*groups, tuple(spread), within_laws)
    found = tuple(_among(t, right) for t in truths)
    names_right = tuple(bool(g) or _part_of(n, spread) or _stands_in(n, truths) for n, g in answered)
    recalled = sum(t.above for t, is_found in zip(truths, found, strict=True) if is_found)
    return SetScore(
        truths=tuple(truths),
        found=found,
        names_right=names_right,
        errors=tuple(error for n, g in answered for error in _errors(n, g)),
        verdict_right=verdict_right(truths, recalled, len(named), names_right.count(False), verdict),
    )


def not_answered(truths: Sequence[TrueOne]) -> SetScore:
    """The score of a case whose diagnosis was refused: nothing named, and no verdict."""
    nothing = (False,) * len(truths)
    return SetScore(truths=tuple(truths), found=nothing, names_right=(), errors=(), verdict_right=False)


def verdict_right(truths: Sequence[TrueOne], recalled: int, names: int, false_names: int, verdict: Verdict) -> bool:
    """The decision table, of what is true.

    No effect above its limit: consistent, cannot_tell, or small; explained if something true is named and nothing else.
    Above it and of the library: explained, with all of them; partly_explained, with some of several; nothing false.
    Above it and outside: partly_explained or unexplained, or explained by its stand-ins alone.
    """
    visible = [t for t in truths if t.above]
    outside = [t for t in visible if not t.library]
    true_alone = names > 0 and not false_names
    if outside:
        stood_for = true_alone and all(t.stand_ins for t in outside)
        return verdict in (Verdict.PARTLY_EXPLAINED, Verdict.UNEXPLAINED, *[Verdict.EXPLAINED] * stood_for)
    rights = {
        Verdict.CONSISTENT: not visible,
        Verdict.CANNOT_TELL: not visible,
        Verdict.SMALL: not visible and not false_names,
        Verdict.EXPLAINED: true_alone and recalled == len(visible),
        Verdict.PARTLY_EXPLAINED: true_alone and (not visible or 0 < recalled < len(visible)),
        Verdict.UNEXPLAINED: False,
    }
    return rights[verdict]


def _among(true: TrueOne, groups: Iterable[Group]) -> bool:
    return any(true is one for group in groups for one in group)


def _assigned(truths: Sequence[TrueOne], named: Sequence[Sequence[Named]]) -> list[Group]:
    """For every class the true effects that it stands for, each once; first those that stand for one, then for more."""
    found: list[Group] = [()] * len(named)
    for most in (1, 2, 3, 4):
        for k, look_alikes in enumerate(named):
            if found[k]:
                continue
            free = [t for t in truths if not _among(t, found)]
            options = [g for n in look_alikes for g in _groups(n, free, most)]
            if options:
                found[k] = min(options, key=lambda option: option[0])[1]
    return [_grown(look_alikes, group, truths, found) for look_alikes, group in zip(named, found, strict=True)]


def _groups(named: Named, free: Sequence[TrueOne], size: int) -> list[tuple[float, Group]]:
    """Groups of so many true effects that this name may stand for, with how far each is off."""
    same = [t for t in free if t.name == named.name and _fields_right(named, t)]
    if size == 1:
        return [(_distance_m(named, (t,)), (t,)) for t in same if _where_right(named, t)]
    if named.name != "added_mass":
        return []
    return [(_distance_m(named, group), group) for group in combinations(same, size) if _weighs(named, group)]


def _grown(look_alikes: Sequence[Named], group: Group, truths: Sequence[TrueOne], taken: Sequence[Group]) -> Group:
    """A mass that stands for one true mass may stand for those beside it too, if it weighs what they weigh together."""
    if len(group) != 1 or group[0].name != "added_mass":
        return group
    named = _meant(look_alikes, group)
    beside = [t for t in truths if t.name == "added_mass" and not _among(t, taken)]
    options = [group, *((*group, *more) for size in (1, 2, 3) for more in combinations(beside, size))]
    fitting = [g for g in options if _weighs(named, g)]
    return min(fitting, key=lambda g: abs(named.values["mass_kg"].value - _mass_kg(g)), default=group)


def _meant(look_alikes: Sequence[Named], group: Group) -> Named:
    """The one of a class that stands for these true effects."""
    return next(n for n in look_alikes if n.name == group[0].name and _fields_right(n, group[0]))


def _weighs(named: Named, group: Group) -> bool:
    """Whether a mass stands near the centre of several, and weighs what they do."""
    mass = named.values.get("mass_kg")
    if mass is None or len({t.place.get("body") for t in group}) > 1:
        return False
    off_kg = abs(mass.value - _mass_kg(group))
    near_kg = max(3 * mass.standard_error, LUMPED_WITHIN * _mass_kg(group))
    return off_kg <= near_kg and _distance_m(named, group) <= WITHIN_M


def _mass_kg(group: Group) -> float:
    return sum(t.whole["mass_kg"] for t in group)


def _centre(group: Group) -> float:
    """Of masses, or of the one effect there is, as a share of the body's length."""
    if len(group) == 1:
        return group[0].whole["relative_position"]
    return sum(t.whole["mass_kg"] * t.whole["relative_position"] for t in group) / _mass_kg(group)


def _distance_m(named: Named, group: Group) -> float:
    place = named.values.get("relative_position")
    if place is None or any("relative_position" not in t.whole for t in group):
        return 0.0
    return abs(place.value - _centre(group)) * group[0].length_m


def _fields_right(named: Named, true: TrueOne) -> bool:
    """Whether contact, body, beam, sensor and side are those of the truth; of a clamp there is no choice."""
    fields = [f for f in WHERE if f in true.place and true.name != "clamp_compliance"]
    return all(named.place.get(f, EVERYWHERE) == str(true.place[f]) for f in fields)


def _where_right(named: Named, true: TrueOne) -> bool:
    """And whether the place along the body, and the band, are."""
    if _distance_m(named, (true,)) > WITHIN_M:
        return False
    if "low_hz" not in true.whole:
        return True
    ends = [named.values.get(f) for f in ("low_hz", "high_hz")]
    if ends[0] is None or ends[1] is None:
        return False
    low, high = true.whole["low_hz"], true.whole["high_hz"]
    shared = min(high, ends[1].value) - max(low, ends[0].value)
    return shared / (max(high, ends[1].value) - min(low, ends[0].value)) >= OVERLAP


def _at_every_contact(true: TrueOne, named: Sequence[Sequence[Named]], contacts: Sequence[str]) -> bool:
    """Whether an effect at all contacts was named at each of them."""
    if true.place.get("contact") != EVERYWHERE or not contacts:
        return False
    there = {n.place.get("contact") for look_alikes in named for n in look_alikes if n.name == true.name}
    return set(contacts) <= there


def _within_named_law(true: TrueOne, look_alikes: Sequence[Named], group: Group) -> bool:
    return bool(group) and within_power_law(true, group[0], _meant(look_alikes, group))


def _part_of(look_alikes: Sequence[Named], spread: Iterable[TrueOne]) -> bool:
    return any(n.name == t.name for t in spread for n in look_alikes)


def _stands_in(look_alikes: Sequence[Named], truths: Sequence[TrueOne]) -> bool:
    """Whether one of the names is the library's nearest to an effect outside it, on its body or at its contact."""

    def near(named: Named, true: TrueOne) -> bool:
        fields = [f for f in ("contact", "body") if f in true.place and f in named.place]
        return named.name in true.stand_ins and all(named.place[f] in (EVERYWHERE, true.place[f]) for f in fields)

    return any(near(n, t) for t in truths if not t.library for n in look_alikes)


def _errors(look_alikes: Sequence[Named], group: Group) -> list[tuple[str, float]]:
    """Of every parameter with a standard error."""
    if not group:
        return []
    named = _meant(look_alikes, group)
    true: Mapping[str, float] = group[0].whole
    if len(group) > 1:
        true = {"mass_kg": _mass_kg(group), "relative_position": _centre(group)}
    return [
        (f"{named.name}.{field}", (estimate.value - true[field]) / estimate.standard_error)
        for field, estimate in named.values.items()
        if field in true and field not in NOT_REPORTED and estimate.standard_error > 0
    ]
