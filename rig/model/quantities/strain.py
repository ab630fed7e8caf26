"""Bending strain: strain gauge, epsilon = -h w''(x) at the distance h from the neutral fibre, tension positive."""

from rig.model.quantities.base import Derivatives, Quantity, Row


def surface_strain(derivatives: Derivatives, fibre_m: float) -> Row:
    return -fibre_m * derivatives[2]


STRAIN = Quantity(
    "strain",
    "m/m",
    {"m/m": 1.0, "mm/m": 1e-3, "um/m": 1e-6, "ustrain": 1e-6, "%": 1e-2},
    order=0,
    operator=surface_strain,
    largest=10.0,
)
