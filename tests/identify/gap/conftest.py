"""Diagnoses made by hand: an effect, a pair, a null, and a gap that no effect explains."""

import numpy as np
import pytest

from identify.gap.results import Cause, Closure, Curve, Gap, Likeness, Share, Surface, Value, Where

SENSORS = tuple(f"{body}_{i}" for body in ("cradle", "barrel") for i in range(1, 7))
STATIONS = {"cradle": ("0.2", "0.4", "0.45", "0.6", "0.8", "1"), "barrel": ("0", "0.2", "0.4", "0.55", "0.8", "1")}


def even(names):
    """Shares that grow along the names."""
    total = sum(range(1, len(names) + 1))
    return {name: (i + 1) / total for i, name in enumerate(names)}


def surface(scale):
    eta, rate = np.linspace(-8e-3, 8e-3, 13), np.linspace(-1.5, 1.5, 13)
    middle = (eta[1:] + eta[:-1])[:, None] / 16e-3, (rate[1:] + rate[:-1])[None, :] / 3.0
    size = np.where(np.abs(middle[0]) > 0.5, np.exp(-scale * middle[1] ** 2), 0.0)
    return Surface(tuple(eta), tuple(rate), tuple(map(tuple, size / size.sum())))


def where():
    bands = ("0 to 2 Hz", "2 to 5 Hz", "5 to 10 Hz", "10 to 20 Hz", "20 to 40 Hz", "40 to 60 Hz", "60 to 100 Hz")
    times = tuple(f"{6.02 * i:.3g} to {6.02 * (i + 1):.3g}" for i in range(10))
    states = ("open", "contact_1 closed", "contact_2 closed", "contact_1 and contact_2 closed")
    sensors = even(SENSORS)
    return Where(
        channels=sensors,
        modal_equations=even([f"{body} {i}" for body in STATIONS for i in range(1, 7)]),
        positions_m={
            body: {at: sensors[f"{body}_{i}"] for i, at in enumerate(places, 1)} for body, places in STATIONS.items()
        },
        band_hz=tuple(Share(*item) for item in even(bands).items()),
        contact_state=even(states),
        time_s=tuple(Share(*item) for item in even(times).items()),
        surface={"contact_1": surface(3.0), "contact_2": surface(8.0)},
        parts=even(("linear", "contact_1", "contact_2")),
    )


def curves():
    hz = np.linspace(0.5, 200.0, 400)
    mass = [1 / ((1 - (hz / f) ** 2) ** 2 + (0.02 * hz / f) ** 2) for f in (53.2, 55.9, 53.3)]
    mm = np.linspace(-8.0, 8.0, 80)
    play = [np.exp(-((np.abs(mm) / d) ** 8)) / (2 * d) for d in (5.0, 4.6, 5.02)]
    label = "frequency, Hz"
    return (
        Curve("power spectral density, barrel_6", label, "(m/s^2)^2/Hz", *tuples(hz, mass), logarithmic=True),
        Curve("FRF (H1), barrel_6 over force", label, "(m/s^2)/N", *tuples(hz, np.sqrt(mass)), logarithmic=True),
        Curve(
            "occurrence of the relative displacement of contact_1",
            "relative displacement, mm",
            "share of the time per mm",
            *tuples(mm, play),
        ),
    )


def tuples(x, three):
    return tuple(map(tuple, (x, *three)))


MASS = Cause(
    ("added_mass",),
    0.934,
    {"added_mass.mass_kg": Value(0.1414, 0.00105, "kg"), "added_mass.relative_position": Value(0.9899, 0.0021, "1")},
    {"added_mass.body": "barrel"},
    0.97,
)
CLAMP = Cause(("clamp_compliance",), 0.051, {"clamp_compliance.compliance": Value(0.0173, 0.0009, "1")}, {}, 3.21)
PAIR = Cause(
    ("coulomb_friction", "sensor_delay"),
    0.81,
    {"coulomb_friction.friction_n": Value(0.764, 0.031, "N"), "sensor_delay.delay_s": Value(1.83e-4, 4e-6, "s")},
    {"coulomb_friction.contact": "contact_2", "sensor_delay.sensor": "barrel_4"},
    1.12,
)
CUBIC = Cause(
    ("hardening_spring",), 0.012, {"hardening_spring.stiffness_n_per_m3": Value(2.96e10, 4.1e8, "N/m^3")}, {}, 31.7
)
LIKENESS = (
    Likeness("acceleration, rms of all sensors", "m/s^2", 18.42, 16.03, 18.37),
    Likeness("time that contact_1 is closed", "%", 31.24, 28.81, 31.02),
    Likeness("impacts of contact_1", "1/s", 24.61, 27.33, 24.9),
)


def gap(verdict, sentence, size, causes, closure, **more):
    return Gap(
        verdict=verdict,
        sentence=sentence,
        size=size,
        causes=causes,
        equivalent=more.pop("equivalent", ()),
        separate_by=more.pop("separate_by", ()),
        where=where(),
        closure=closure,
        likeness=LIKENESS,
        curves=curves(),
        **more,
    )


GAPS = {
    "effect": gap(
        "effect",
        "The gap is an added mass of 141 g at the end of the barrel; it explains 97 % of it.",
        48.3,
        (MASS, CLAMP),
        Closure(48.3, 0.98, 2.07, 0.977, (0.961, 0.988)),
        equivalent=(("clamp_compliance", "youngs_modulus"),),
        separate_by=("hang a known mass on the barrel and record again",),
        channel_faults={"cradle_3": "dead: constant from 3.2 s"},
    ),
    "pair": gap(
        "effect",
        "Two effects together: friction at contact_2 and a delay of barrel_4.",
        6.4,
        (PAIR, CLAMP, CUBIC),
        Closure(6.4, 0.95, 1.1, 0.972, (0.91, 1.03)),
    ),
    "null": gap(
        "no_gap", "There is no gap: what is left is what nulls leave.", 0.93, (), Closure(0.94, 0.92, 0.94, None, None)
    ),
    "none_of_these": gap(
        "none_of_these",
        "There is a gap, and no effect of the library explains it.",
        152.0,
        (CUBIC,),
        Closure(152.0, 1.01, 31.7, 0.797, (0.74, 0.83)),
    ),
}


@pytest.fixture(scope="session", params=list(GAPS))
def diagnosis(request):
    return GAPS[request.param]


@pytest.fixture(scope="session")
def gaps():
    return GAPS
