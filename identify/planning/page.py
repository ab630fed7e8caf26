"""Plan of a test as sentences, rows of tables, and the page plan.html."""

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

from identify.gaps.decision.causes import MILLI_UNITS
from identify.gaps.wording import spoken_effect
from identify.pages import page
from identify.pages.drawing import drawing_html
from identify.pages.wording import COVERED, interval, joined, number, percent
from identify.planning.detectable import DetectableEffect
from identify.planning.expectation import QUANTITIES, ExpectedQuantity
from identify.planning.results import ADDS_NOTHING_FACTOR, HELPS_FACTOR, PlanReport, TriedChange
from rig.effects import effects as effect_types
from rig.effects.base import parameters_of
from rig.model.description import Rig
from rig.model.quantities import printed_unit

PRINTED_QUANTITIES = {
    "clearance_m": ("clearance", "mm", 1e3),
    "stiffness_n_per_m": ("stiffness", "N/m", 1.0),
    "damping_n_s_per_m": ("damping", "N s/m", 1.0),
    "friction_coefficient": ("friction coefficient", "1", 1.0),
    "center_y_m": ("centre in y", "mm", 1e3),
    "center_z_m": ("centre in z", "mm", 1e3),
}
LIMIT_TEXTS = {
    "scatter": "the scatter of one record: a longer record shortens it",
    "slow motion": "the slow motion that accelerometers miss: displacement sensors shorten it",
    "tolerances": "the tolerances of rig.json: calibration shortens it, a longer record does not",
    "law": "what the contact's law leaves",
}
ADVISED_COUNT = 3
"""Number of changes in the sentence."""
CONTACT_HEAD = ("contact", "clearance, mm", "stiffness, N/m", "damping, N s/m")
CHANGE_HEAD = ("change", "widest interval", "than without it", "changes most")
KIND_HEAD = ("effect", "smallest that is named")
EFFECT_HEAD = ("effect", "at", "smallest that is named", "looks like")
SENSOR_HEAD = ("without", "widest interval", "than with it", "changes most")


def sentence(plan: PlanReport) -> str:
    """Sentence on what the test determines, and on the best change."""
    names = [contact.name for contact in plan.contacts]
    widest = widest_share(plan)
    clauses = []
    if names:
        clauses.append(f"{joined(names)} can be determined, clearance and stiffness to ± {percent(widest)} or better")
    clauses += [f"{contact.name} cannot be determined by this test ({contact.reason})" for contact in plan.undetermined]
    if plan.advice:
        clauses.append(f"what helps most: {change_sentence(plan.advice[0])}")
    elif plan.changes:
        clauses.append("of the changes that were tried, none narrows the widest interval by a tenth")
    return "; ".join(clauses) + "."


def change_sentence(change: TriedChange) -> str:
    """Change, and what it does to the widest interval or to contacts that are not determined."""
    if change.gained:
        return f"{change.words}, which determines {joined(change.gained)}, too"
    return f"{change.words}, which narrows the widest interval by {100 * (1 - change.widest_factor):.0f} %"


def widest_share(plan: PlanReport) -> float:
    """Widest expected 95 % interval of a clearance or stiffness over its value."""
    quantities = [q for c in plan.contacts for q in (c.clearance_m, c.stiffness_n_per_m) if q.value]
    return max((COVERED * q.standard_error / q.value for q in quantities), default=1.0)


def contact_rows(plan: PlanReport) -> Iterator[tuple[str, ...]]:
    """Row of each contact: its name and expected 95 % intervals."""
    for contact in plan.contacts:
        yield contact.name, *(_interval_text(contact.quantities[name], name, without_unit=True) for name in QUANTITIES)


def annular_contact_sentences(plan: PlanReport) -> Iterator[str]:
    """Sentence on friction and centre of each annular contact, without a full stop."""
    for contact in plan.contacts:
        names = [name for name in contact.quantities if name not in QUANTITIES]
        words = [f"{PRINTED_QUANTITIES[name][0]} {_interval_text(contact.quantities[name], name)}" for name in names]
        if names and contact.center_y_m is None:
            words.append("its centre cannot be determined")
        if words:
            yield f"{contact.name}: {'; '.join(words)}"


def _interval_text(quantity: ExpectedQuantity, quantity_name: str, *, without_unit: bool = False) -> str:
    """Expected interval; empty of the clearance of a spring, which is no estimate."""
    if not quantity.standard_error:
        return ""
    _, unit, unit_factor = PRINTED_QUANTITIES[quantity_name]
    return interval(unit_factor * quantity.value, unit_factor * quantity.standard_error, "1" if without_unit else unit)


def change_rows(changes: Sequence[TriedChange]) -> Iterator[tuple[str, ...]]:
    """Row of each change: what, the widest interval, its factor, and the interval that changes most."""
    for change in changes:
        interval_notes = [f"determines {name}" for name in change.gained] + [f"loses {name}" for name in change.lost]
        if (largest := change.largest) and abs(largest.factor - 1) > 0.01:
            quantity_name, _, _ = PRINTED_QUANTITIES[largest.quantity]
            interval_notes.append(f"{quantity_name} of {largest.contact}: {_width_change_text(largest.factor)}")
        share_text = f"± {number(100 * change.widest_share, 2)} %"
        yield change.words, share_text, _width_change_text(change.widest_factor), "; ".join(interval_notes)


def _width_change_text(factor: float) -> str:
    """Change of an interval's width by a factor: "14 % narrower", "5 % wider", "3.1 times as wide"."""
    if factor >= 2:
        return f"{number(factor, 2)} times as wide"
    share = f"{100 * abs(factor - 1):.0f} %"
    return "the same" if share == "0 %" else f"{share} {'narrower' if factor < 1 else 'wider'}"


def effect_rows(effects: Sequence[DetectableEffect]) -> Iterator[tuple[str, ...]]:
    """Row of each effect and place: the smallest size that is named, and what looks like it."""
    for effect in effects:
        alike = (name.partition(":") for name in effect.alike)
        alike_words = ", ".join(f"{spoken_effect(kind)} ({place or 'all'})" for kind, _, place in alike)
        yield spoken_effect(effect.effect), effect.place, _size_range_text([effect]), alike_words


def effect_kind_rows(effects: Sequence[DetectableEffect]) -> Iterator[tuple[str, ...]]:
    """Row of each kind of effect: the range over all its places."""
    for kind in dict.fromkeys(effect.effect for effect in effects):
        kind_effects = [effect for effect in effects if effect.effect == kind]
        yield spoken_effect(kind), _size_range_text(kind_effects)


def _size_range_text(effects: Sequence[DetectableEffect]) -> str:
    """Smallest named sizes from the best to the worst place."""
    sizes = [size for effect in effects for size in (effect.least, effect.greatest) if size is not None]
    if not sizes:
        return "none of its range"
    unit_factor, unit = _factor_and_unit(effects[0], max(sizes))
    least, greatest = (number(unit_factor * size, 2) for size in (min(sizes), max(sizes)))
    if any(effect.greatest is None for effect in effects):
        return f"{least}{unit}, at some places none"
    return f"{least}{unit}" if max(sizes) < 1.1 * min(sizes) else f"{least} to {greatest}{unit}"


def _factor_and_unit(effect: DetectableEffect, size: float) -> tuple[float, str]:
    """Factor and unit in which the sizes of an effect are printed: of a ratio to rig.json per cent."""
    strength = next(p for p in parameters_of(effect_types()[effect.effect]) if p.neutral is not None)
    if strength.name == "factor":
        return 100.0, " %"
    if effect.unit == "1/min":
        return 100.0, " % a minute"
    if effect.unit in MILLI_UNITS and size < 1:
        return 1e3, f" {MILLI_UNITS[effect.unit]}"
    return 1.0, "" if effect.unit == "1" else f" {printed_unit(effect.unit)}"


def idle_sensor_sentence(plan: PlanReport) -> str:
    """Sentence on the sensors that add nothing; empty if there are none or none was left out."""
    if not plan.idle_sensors:
        return ""
    return (
        f"Any one of these sensors can be left out, and no interval of a clearance or stiffness grows by more than "
        f"{100 * (ADDS_NOTHING_FACTOR - 1):.0f} %: {', '.join(plan.idle_sensors)}; plan again before leaving out two."
    )


def test_sentence(plan: PlanReport) -> str:
    """Sentence on the test that is planned."""
    if plan.base is not None:
        (low_hz, high_hz), level_text = plan.base.band_hz, number(plan.base.acceleration_rms_m_per_s2, 3)
        excitation_words = f"a base that shakes with {level_text} m/s² rms"
    else:
        assert plan.force is not None
        low_hz, high_hz = plan.force.band_hz
        levels = " and ".join(number(rms_n, 3) for rms_n in dict.fromkeys(plan.force.rms_n))
        count = len(plan.force.rms_n)
        excitation_words = f"{'a Gaussian force' if count == 1 else f'{count} Gaussian forces, each'} of {levels} N rms"
    return f"{plan.duration_s:g} s of {excitation_words} from {low_hz:.3g} to {high_hz:.3g} Hz"


def _interval_limit_rows(plan: PlanReport) -> Iterator[tuple[str, ...]]:
    for contact in plan.contacts:
        for quantity_name, quantity in contact.quantities.items():
            yield (
                f"{PRINTED_QUANTITIES[quantity_name][0]} of {contact.name}",
                _interval_text(quantity, quantity_name),
                f"{number(quantity.spread_factor, 3)}",
                LIMIT_TEXTS[quantity.limited_by],
            )


def write_page(plan: PlanReport, rig: Rig, path: Path, sources: Sequence[Path] = ()) -> None:
    """Write plan.html."""
    lines: dict[str, Sequence[str]] = {
        contact.name: [
            interval_text
            for interval_text in (
                _interval_text(contact.clearance_m, "clearance_m"),
                _interval_text(contact.stiffness_n_per_m, "stiffness_n_per_m"),
            )
            if interval_text
        ]
        for contact in plan.contacts
    }
    lines |= {contact.name: ("cannot be determined",) for contact in plan.undetermined}
    caption = "<figcaption>The rig, to scale along the bodies, and the expected 95 % intervals.</figcaption>"
    advised_sentences = (change_sentence(change) for change in plan.advice[:ADVISED_COUNT])
    sentences = [f"{text[:1].upper()}{text[1:]}." for text in advised_sentences]
    sentences += [f"{contact.name}: {contact.remedy}." for contact in plan.undetermined]
    advice_html = page.list_html(sentences) if sentences else no_advice_html()
    verdict = f"{'not ' * bool(plan.undetermined)}all contacts can be determined"
    page.write(
        path,
        title=f"{plan.rig}: plan of a test",
        answer=page.Answer("yellow" if plan.undetermined else "green", verdict, [sentence(plan)]),
        top_blocks=[f"<figure>{drawing_html(rig, lines)}{caption}</figure>", f"<h2>What would help</h2>{advice_html}"],
        sections=_sections(plan),
        folded_sections=_folded_sections(plan),
        foot_text="Made by identify plan; the numbers are in plan.json.",
        sources=sources,
    )


def no_advice_html() -> str:
    return f"<p>No change that was tried narrows the widest interval by {100 * (1 - HELPS_FACTOR):.0f} %.</p>"


def _sections(plan: PlanReport) -> list[tuple[str, str]]:
    note = (
        f"<p>± 95 %. Planned: {test_sentence(plan)}. The rig was simulated as described, {plan.simulations} times in "
        f"other draws for {plan.simulated_s:g} s, and each record identified as identify contact does.</p>"
    )
    rings_html = (
        page.list_html(f"{text}." for text in annular_contact_sentences(plan))
        if any(annular_contact_sentences(plan))
        else ""
    )
    sections = [("Expected intervals", note + page.table(CONTACT_HEAD, contact_rows(plan)) + rings_html)]
    if plan.undetermined:
        undetermined_rows = ((c.name, c.reason, c.remedy) for c in plan.undetermined)
        sections.append(
            ("What cannot be determined", page.table(("contact", "why", "what would help"), undetermined_rows))
        )
    if plan.effects:
        intro_html = (
            "<p>Of two such records, the size that identify gap names in 95 % of all cases, beside all tolerances: "
            "a difference from what rig.json says, from the best to the worst place.</p>"
        )
        sections.append(
            ("Which effects would be named", intro_html + page.table(KIND_HEAD, effect_kind_rows(plan.effects)))
        )
    if plan.notes:
        sections.append(("To note", page.list_html(f"{note[:1].upper()}{note[1:]}." for note in plan.notes)))
    if plan.changes:
        intro_html = (
            "<p>Each change was simulated and identified under the same draws. Widest interval: the widest of all "
            "clearances and stiffnesses, as a share of the value; a contact that is not determined counts as "
            f"100 %. A change helps if it narrows that by {100 * (1 - HELPS_FACTOR):.0f} %; less may be chance where "
            "force, band or place change.</p>"
        )
        table_html = page.table(CHANGE_HEAD, change_rows(plan.advice)) if plan.advice else no_advice_html()
        sections.append(("What would help, ranked", intro_html + table_html))
    if plan.sensors:
        idle_html = f"<p>{escape(idle_sensor_sentence(plan))}</p>" if plan.idle_sensors else ""
        sections.append(("Each sensor left out", idle_html + page.table(SENSOR_HEAD, change_rows(plan.sensors))))
    return sections


def _folded_sections(plan: PlanReport) -> list[tuple[str, str]]:
    intro = "<p>Each effect at each of its places, and what the record cannot distinguish from it.</p>"
    table_html = page.table(EFFECT_HEAD, effect_rows(plan.effects))
    effect_sections = [("Which effects would be named, place by place", intro + table_html)] if plan.effects else []
    idle = [change for change in plan.changes if not change.helps]
    idle_html = (
        "<p>Tried, too, on one record each. Of another record the interval may be wider by chance alone.</p>"
        + page.table(CHANGE_HEAD, change_rows(idle))
    )
    idle_sections = [("What would not help", idle_html)] if idle else []
    return [*idle_sections, *effect_sections, *_interval_limit_sections(plan)]


def _interval_limit_sections(plan: PlanReport) -> list[tuple[str, str]]:
    if not plan.contacts:
        return []
    intro_html = (
        "<p>Factor: by which the interval of one record may be longer or shorter, one standard deviation over the "
        "simulated records.</p>"
    )
    return [
        (
            "What limits each interval",
            intro_html + page.table(("value", "expected", "factor", "limited by"), _interval_limit_rows(plan)),
        )
    ]
