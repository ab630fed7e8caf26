"""Effects as a diagnosis names them and as they are true, and which of them are one law in other numbers."""

from collections.abc import Sequence

import msgspec

STOPS = ("contact_stiffness", "one_stop")
OTHER_SIDE = {"lower": "upper", "upper": "lower"}


class Estimate(msgspec.Struct, frozen=True):
    """A value with its standard error; none above zero if it was not fitted."""

    value: float
    standard_error: float


class Named(msgspec.Struct, frozen=True, kw_only=True):
    """An effect as a diagnosis names it; `place` by field (contact, body, beam, sensor, side), "all" of all."""

    name: str
    place: dict[str, str] = {}
    values: dict[str, Estimate] = {}


class TrueOne(msgspec.Struct, frozen=True, kw_only=True):
    """A true effect: how the machine differs there, and whether that is above its limit. length_m is of its body."""

    name: str
    place: dict[str, str | float] = {}
    whole: dict[str, float] = {}
    above: bool
    library: bool = True
    uncounted: bool = False
    stand_ins: tuple[str, ...] = ()
    length_m: float = 0.0


def by_stop(truths: Sequence[TrueOne], named: Sequence[Sequence[Named]]) -> tuple[list[TrueOne], list[Sequence[Named]]]:
    """Truths and named classes in which a stiffness of both stops and one of a single stop beside it are those of the
    two stops: the same law in other numbers. Only contacts where that is true are changed; relative errors of named
    factors are added as independent ones."""
    new_truths, classes = list(truths), list(named)
    for contact in {t.place.get("contact") for t in truths if t.name in STOPS}:
        true_indices = _stops_at(contact, truths)
        if len(true_indices) < len(STOPS):
            continue
        both, one = (truths[index] for index in true_indices)
        other = {**both.place, "side": OTHER_SIDE[str(one.place["side"])]}
        product = {"factor": both.whole["factor"] * one.whole["factor"]}
        new_truths[true_indices[0]] = msgspec.structs.replace(both, name=one.name, place=other)
        new_truths[true_indices[1]] = msgspec.structs.replace(one, whole=product)
        named_indices = _stops_at(contact, [look_alikes[0] for look_alikes in classes])
        if len(named_indices) < len(STOPS):
            continue
        named_both, named_one = (classes[index][0] for index in named_indices)
        factors = [n.values["factor"] for n in (named_both, named_one)]
        value = factors[0].value * factors[1].value
        error = value * sum((f.standard_error / f.value) ** 2 for f in factors) ** 0.5
        place = {**named_both.place, "side": OTHER_SIDE[named_one.place["side"]]}
        classes[named_indices[0]] = (msgspec.structs.replace(named_both, name=named_one.name, place=place),)
        classes[named_indices[1]] = (msgspec.structs.replace(named_one, values={"factor": Estimate(value, error)}),)
    return new_truths, classes


def _stops_at(contact: object, effects: Sequence[TrueOne | Named]) -> list[int]:
    """Indices of the stiffness of both stops of a contact and of that of one, if each is there once."""
    names = {k: e.name for k, e in enumerate(effects) if e.name in STOPS and e.place.get("contact") == contact}
    return sorted(names, key=names.__getitem__) if sorted(names.values()) == sorted(STOPS) else []


def within_power_law(true: TrueOne, law: TrueOne, named: Named) -> bool:
    """Whether a stiffness is part of the power law `law` that was named at its contact.

    A law F = R (k d / R)^n of f times the stiffness is one of the same stiffness and of the reference force
    R f^(n / (1 - n)): the two are one law, and only that force tells them apart.
    """
    reference = named.values.get("reference_force_n")
    if reference is None or law.name != "hertz_stop" or true.name != "contact_stiffness":
        return False
    if true.place.get("contact") != law.place.get("contact"):
        return False
    exponent = law.whole["exponent"]
    true_n = law.whole["reference_force_n"] * true.whole["factor"] ** (exponent / (1 - exponent))
    return abs(reference.value - true_n) <= 3 * reference.standard_error
