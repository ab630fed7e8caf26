"""Colours of the viewer and of the drawing of a rig: one meaning each, told apart with any colour vision.

The hues are those of Okabe and Ito (Color Universal Design, 2008), for the dark theme of the viewer and for white
paper. Several things of one meaning in a plot are shades of its colour. Greys mean nothing: they are frames, rest
positions and what carries the rig.
"""

from dataclasses import dataclass

import numpy as np

Colour = tuple[int, int, int]


@dataclass(frozen=True)
class ColourMeaning:
    """Meaning of a colour, and the colour on a dark screen and, where it is drawn there, on white paper."""

    words: str
    on_dark: Colour
    on_white: Colour | None = None


MEANINGS = {
    "machine": ColourMeaning("measured, or true in a simulation", (240, 240, 240), (34, 34, 34)),
    "believed": ColourMeaning("believed: rig.json", (230, 159, 0), (190, 120, 0)),
    "found": ColourMeaning("found: identified or corrected", (86, 180, 233)),
    "closed": ColourMeaning("contact closed", (213, 94, 0)),
    "force": ColourMeaning("force", (204, 121, 167), (170, 68, 125)),
    "gap": ColourMeaning("where and when the gap acts", (240, 228, 66)),
    "sensor": ColourMeaning("sensor channels", (0, 158, 115), (0, 120, 88)),
}
"""Colours by name of their meaning, in the order of the key."""
MACHINE, BELIEVED, FOUND, CLOSED, FORCE, GAP, SENSOR = (meaning.on_dark for meaning in MEANINGS.values())
INK, BELIEVED_INK, FORCE_INK, SENSOR_INK = (
    f"#{bytes(meaning.on_white).hex()}" for meaning in MEANINGS.values() if meaning.on_white is not None
)
"""Colours on white paper as in SVG, of the meanings that are drawn there."""
STEEL, FAINT, GRID = (140, 145, 155), (85, 90, 100), (50, 54, 62)
"""Greys on a dark screen: frames, letters and supports; rest positions; grids."""
SOURCES: dict[str, Colour] = {"true": MACHINE, "identified": FOUND, "believed": BELIEVED}
"""Colours of contact laws by their source."""
LIGHTEST_WHITE_SHARE, DARKEST_BRIGHTNESS = 0.6, 0.7
"""Share of white in the lightest shade of a colour, and brightness of its darkest one."""


def shades(colour: Colour, shade_count: int) -> tuple[Colour, ...]:
    """Shades of a colour from dark to light; the colour itself if there is one."""
    if shade_count < 2:
        return (colour,) * shade_count
    pure_colour = np.array(colour, dtype=float)
    darkest, lightest = DARKEST_BRIGHTNESS * pure_colour, pure_colour + LIGHTEST_WHITE_SHARE * (255 - pure_colour)
    shade_colours = darkest + np.linspace(0, 1, shade_count)[:, None] * (lightest - darkest)
    return tuple((int(red), int(green), int(blue)) for red, green, blue in shade_colours.round())
