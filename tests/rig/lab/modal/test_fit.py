"""Modes fitted to FRFs of random structures: each is found, and no other."""

import numpy as np
import pytest

from rig.errors import RigError
from rig.lab.modal.fit import fit_modes

HZ = np.arange(1, 2001) / 2
PLACES = 8


def structure(seed):
    """Frequencies, at least 2 % apart, dampings of 0.1 to 3 %, and shapes; three modes above the band."""
    rng = np.random.default_rng(seed)
    inside = np.sort(rng.uniform(20, 950, rng.integers(3, 10)))
    inside = inside[np.append(True, np.diff(inside) / inside[1:] > 0.02)]
    natural_hz = np.append(inside, rng.uniform(1100, 2000, 3))
    shapes = rng.standard_normal((PLACES, natural_hz.size))
    shapes[0] = np.abs(shapes[0]) + 0.3
    return natural_hz, 10 ** rng.uniform(-3, -1.5, natural_hz.size), shapes, rng


def accelerance(natural_hz, ratios, shapes, noise, rng):
    omega, natural = 2 * np.pi * HZ, 2 * np.pi * natural_hz[:, None]
    terms = -(omega**2) / (natural**2 - omega**2 + 2j * ratios[:, None] * natural * omega)
    clean = (shapes * shapes[0]) @ terms
    size = noise * np.sqrt(np.mean(np.abs(clean) ** 2, axis=1, keepdims=True) / 2)
    return clean + size * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape))


@pytest.mark.parametrize("seed", range(8))
def test_every_mode_of_a_random_structure_is_found_and_no_other(seed):
    natural_hz, ratios, shapes, rng = structure(seed)
    fit = fit_modes(HZ, accelerance(natural_hz, ratios, shapes, 3e-3, rng), 0)
    inside = natural_hz < HZ[-1]
    np.testing.assert_allclose(fit.frequencies_hz, natural_hz[inside], rtol=2e-3)
    np.testing.assert_allclose(fit.damping_ratios, ratios[inside], rtol=0.1)
    residues = (shapes * shapes[:1])[:, inside]
    np.testing.assert_allclose(fit.residues, residues, atol=0.05 * np.abs(residues).max())


def test_noise_has_no_modes():
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((PLACES, HZ.size)) + 1j * rng.standard_normal((PLACES, HZ.size))
    with pytest.raises(RigError, match="no mode"):
        fit_modes(HZ, noise, 0)
    with pytest.raises(RigError, match="10 lines above 0 Hz are too few"):
        fit_modes(HZ[:10], noise[:, :10], 0)
