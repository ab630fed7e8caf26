"""Effects in words with value and place: "an added mass of 0.150 kg on the barrel at 1.00 m"."""

import numpy as np
from jaxtyping import Float

from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import Hypothesis
from identify.pages.wording import number
from rig.model.description import Rig
from rig.model.parameters import Parameter
from rig.model.quantities import printed_unit

TIMES = 2.0
"""A ratio further from one than this factor is told as a multiple, a nearer one as larger or smaller by per cent."""
DIGITS = 3
UNTOLD = "unknown strength"


def phrase(part: Candidate, values: Float[np.ndarray, " parameters"], rig: Rig, told: bool = True) -> str:
    """Phrase for an effect with its values in a rig; without its strength where that is not determined."""
    said = {
        p.name: _value(p, float(value)) if told or p.neutral is None else UNTOLD
        for p, value in zip(part.parameters, values, strict=True)
    }
    for field, place in part.place.items():
        said[field] = _placed(field, place, rig)
    for field in part.typical.__struct_fields__:
        said.setdefault(field, str(getattr(part.typical, field)))
    said["at"] = ""
    if "relative_position" in part.parameters.names:
        share = float(values[part.parameters.names.index("relative_position")])
        body = part.place.get("body") or rig.forces[0].body
        said["at"] = f" at {share * rig.body(body).length_m:.2f} m"
    return part.kind.words.format_map(said)


def _value(parameter: Parameter, value: float) -> str:
    if parameter.neutral == 1.0 and parameter.name == "factor":
        if not 1 / TIMES <= value <= TIMES:
            return f"{number(value, DIGITS)} times as large"
        return f"{number(100 * abs(value - 1), DIGITS)} % {'larger' if value > 1 else 'smaller'}"
    if parameter.unit == "1/min":
        return f"{number(100 * value, DIGITS)} % a minute"
    if parameter.unit in MILLI and 0 < abs(value) < 1:
        return f"{number(1e3 * value, DIGITS)} m{parameter.unit}"
    return number(value, DIGITS) + ("" if parameter.unit == "1" else f" {printed_unit(parameter.unit)}")


MILLI = ("m", "s")
"""Units of which thousandths are told."""


def _placed(field: str, place: str | None, rig: Rig) -> str:
    if field == "contact":
        return place or "all contacts"
    if field == "side":
        return str(place)
    if field == "sensor":
        return f"sensor {place or rig.sensors[-1].name}"
    return f"the {place}" if place else "all bodies"


def words_of(hypothesis: Hypothesis, rig: Rig) -> tuple[str, ...]:
    """Its effects with values and places."""
    return tuple(phrase(part, values, rig) for part, values in zip(hypothesis.parts, hypothesis.split(), strict=True))
