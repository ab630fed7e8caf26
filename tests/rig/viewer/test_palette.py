"""Colours of the viewer: each has one meaning and differs from the others for every kind of colour vision."""

from itertools import combinations

import numpy as np
import pytest

from rig.viewer.palette import MEANINGS, SENSOR, shades

VISION = {
    "trichromat": np.eye(3),
    "protanope": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranope": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanope": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
"""Linear RGB as seen (Machado, Oliveira and Fernandes, IEEE TVCG 15, 2009, severity 1)."""
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
JUST_NOTICEABLE = 2.3
"""CIELAB distance of two colours that are just told apart side by side (Mahy et al., 1994)."""
DARK, WHITE = (13, 16, 17), (255, 255, 255)
"""Background of the viewer's dark theme, and paper."""


def linear(colour):
    share = np.array(colour) / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def lab(colour, vision):
    xyz = TO_XYZ @ np.clip(np.array(vision) @ linear(colour), 0, 1) / TO_XYZ.sum(axis=1)
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def contrast(one, other):
    """Contrast ratio by WCAG 2.1."""
    bright, dim = sorted((float(TO_XYZ[1] @ linear(c)) + 0.05 for c in (one, other)), reverse=True)
    return bright / dim


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("background", ["on_dark", "on_white"])
def test_any_two_colours_differ_much_for_every_colour_vision(vision, background):
    colours = {name: lab(c, VISION[vision]) for name, m in MEANINGS.items() if (c := getattr(m, background))}
    for one, other in combinations(colours, 2):
        distance = np.linalg.norm(colours[one] - colours[other])
        assert distance > 6 * JUST_NOTICEABLE, (one, other, distance)


def test_every_colour_can_be_read_on_its_background():
    for name, meaning in MEANINGS.items():
        assert contrast(meaning.on_dark, DARK) > 4.5, name
        assert meaning.on_white is None or contrast(meaning.on_white, WHITE) > 3.0, name


def test_shades_grow_lighter_and_keep_their_hue():
    lightness = [lab(c, np.eye(3))[0] for c in shades(SENSOR, 6)]
    assert np.diff(lightness).min() > 2 * JUST_NOTICEABLE
    hues = [np.arctan2(*lab(c, np.eye(3))[:0:-1]) for c in shades(SENSOR, 6)]
    assert np.ptp(hues) < 0.2
    assert shades(SENSOR, 1) == (SENSOR,)
