"""Diagnoses made by hand: explained, by a pair, in part, an unknown force, a null, and one mass without contacts."""

from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import asdict, replace

from identify.gaps.decision.sentence import sentence
from identify.gaps.results import (
    AGAIN,
    Attribution,
    Band,
    Between,
    Cause,
    Compared,
    Curve,
    Diagnosis,
    Figure,
    Gap,
    Left,
    Matters,
    NextExperiment,
    ResidualMap,
    Share,
)
from rig.model.unmeasured_force import MeanForce, UnmeasuredForce, Value
from rig.recording import read
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle, Sdof

SENSORS = tuple(f"{body}_{i}" for body in ("cradle", "barrel") for i in range(1, 7))
STATIONS = {"cradle": (0.2, 0.4, 0.45, 0.6, 0.8, 1.0), "barrel": (0.0, 0.2, 0.4, 0.55, 0.8, 1.0)}


def even(names):
    """Shares that grow along the names."""
    total = sum(range(1, len(names) + 1))
    return {name: (i + 1) / total for i, name in enumerate(names)}


def surface(scale):
    eta, rate = np.linspace(-8e-3, 8e-3, 13), np.linspace(-1.5, 1.5, 13)
    middle = (eta[1:] + eta[:-1])[:, None] / 16e-3, (rate[1:] + rate[:-1])[None, :] / 3.0
    size = np.where(np.abs(middle[0]) > 0.5, np.exp(-scale * middle[1] ** 2), 0.0)
    return ResidualMap(*tuples(eta, rate), tuples(*(size / size.sum())))


def attribution():
    bands_hz = tuple(pairwise((0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0, 100.0)))
    times_s = tuple((6.02 * i, 6.02 * (i + 1)) for i in range(10))
    states = ("open", "contact_1 closed", "contact_2 closed", "contact_1 and contact_2 closed")
    sensors = even(SENSORS)
    return Attribution(
        channels=sensors,
        modal_equations=even([f"{body} {i}" for body in STATIONS for i in range(1, 7)]),
        positions_m={
            body: {at: sensors[f"{body}_{i}"] for i, at in enumerate(places, 1)} for body, places in STATIONS.items()
        },
        band_hz=tuple(Share(*ends, share) for ends, share in even(bands_hz).items()),
        contact_state=even(states),
        time_s=tuple(Share(*ends, share) for ends, share in even(times_s).items()),
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
        Curve("power spectral density, barrel_6", label, "(m/s^2)^2/Hz", *tuples(hz, *mass), logarithmic=True),
        Curve("FRF (H1), barrel_6 over force", label, "(m/s^2)/N", *tuples(hz, *np.sqrt(mass)), logarithmic=True),
        Curve(
            "histogram of the relative displacement of contact_1",
            "relative displacement, mm",
            "share of the time per mm",
            *tuples(mm, *play),
        ),
    )


def tuples(*rows):
    return tuple(tuple(np.asarray(row).tolist()) for row in rows)


def left(share, *contacts, p_value):
    return Left(share=share, contact_shares={f"contact_{i}": s for i, s in enumerate(contacts, 1)}, p_value=p_value)


def cause(effects, probability, explained, interval, left, parameters, **places):
    return Cause(
        effects=effects,
        probability=probability,
        parameters={name: Value(*value) for name, value in parameters.items()},
        places={name.replace("__", "."): place for name, place in places.items()},
        explained=explained,
        interval_95=interval,
        left=left,
        log_prior=-5.0,
        minus_two_log=900.0,
    )


BEFORE, SMALL, REST = (
    left(0.067, 0.109, 0.021, p_value=1e-9),
    left(4e-4, 4e-3, 0.0, p_value=0.31),
    left(0.0123, 0.041, 0.0, p_value=2e-7),
)
MASS = cause(
    ("added_mass",),
    0.934,
    0.977,
    (0.961, 0.988),
    SMALL,
    {
        "added_mass.mass_kg": (0.1414, 0.00105, "kg"),
        "added_mass.relative_position": (0.9899, 0.0021, "1", True),
    },
    added_mass__body="barrel",
)
CLAMP = cause(
    ("clamp_compliance",), 0.051, 0.12, (0.08, 0.17), BEFORE, {"clamp_compliance.compliance": (0.0173, 0.0009, "1")}
)
PAIR = cause(
    ("coulomb_friction", "sensor_delay"),
    0.81,
    0.94,
    (0.91, 0.96),
    SMALL,
    {"coulomb_friction.friction_n": (0.764, 0.031, "N"), "sensor_delay.delay_s": (1.83e-4, 4e-6, "s")},
    coulomb_friction__contact="contact_2",
    sensor_delay__sensor="barrel_4",
)
CUBIC = cause(
    ("hardening_spring",),
    0.012,
    -0.02,
    (-0.05, 0.01),
    BEFORE,
    {"hardening_spring.stiffness_n_per_m3": (2.96e10, 4.1e8, "N/m^3")},
)
FIGURES = (
    Figure("acceleration, rms of all sensors", "m/s^2", 18.42, 16.03, 18.37, 0.74),
    Figure("time that contact_1 is closed", "%", 31.24, 28.81, 31.02, 2.5),
    Figure("impacts of contact_1", "1/s", 24.61, 27.33, 24.9, 2.9),
)


def softening():
    """A force that saturates with the displacement at its place, and what it was seen at."""
    w, v = np.linspace(-40e-3, 40e-3, 25), np.linspace(-1.2, 1.2, 25)
    middle_w, middle_v = (w[1:] + w[:-1]) / 2, (v[1:] + v[:-1]) / 2
    visited = (middle_w[:, None] / 40e-3) ** 2 + (middle_v[None, :] / 1.2) ** 2 < 1
    force = np.where(visited, 11.0 * np.tanh(middle_w / 2.6e-3)[:, None], 0.0)
    hz = np.arange(1.0, 171.0, 2.0)
    return UnmeasuredForce(
        sentence="a softening spring on the barrel near 0.89 m, 4240 N/m w0 tanh(w / w0), w0 = 2.59 mm",
        kind="force",
        body="barrel",
        position_m=0.8914,
        position_error_m=1.4e-4,
        sensor=None,
        frequency_hz=None,
        band_hz=(2.01, 19.98),
        rms_n=10.53,
        when="always",
        before_excitation=0.04,
        by_time=(10.5, 11.3, 11.3, 11.2, 10.1, 9.5, 10.9, 10.5),
        against="displacement",
        law_name="softening spring",
        law="4240 N/m w0 tanh(w / w0), w0 = 2.59 mm",
        law_parameters={"coefficient": Value(4240.0, 30.0, "N/m"), "w0": Value(2.59e-3, 2e-5, "m")},
        explained=0.992,
        over_motion=MeanForce(*tuples(w, v), tuples(*force)),
        spectrum_hz=tuple(hz.tolist()),
        spectrum=tuple((37.0 / (1 + (hz / 5) ** 4)).tolist()),
    )


def tone():
    hz = np.arange(1.0, 171.0, 2.0)
    return UnmeasuredForce(
        sentence="a force at 50.0 Hz, 1.4 N, on the cradle near 0.80 m",
        kind="force",
        body="cradle",
        position_m=0.8,
        position_error_m=0.004,
        sensor=None,
        frequency_hz=50.02,
        band_hz=(49.0, 51.0),
        rms_n=0.99,
        amplitude_n=1.4,
        when="always",
        by_time=(1.0,) * 8,
        against="none",
        law_name="tone",
        law="1.2 N cos(2 pi f t) + 0.72 N sin(2 pi f t), f = 50.02 Hz",
        explained=0.81,
        spectrum_hz=tuple(hz.tolist()),
        spectrum=tuple(np.where(np.abs(hz - 50) < 2, 0.25, 0.0).tolist()),
    )


def bands(before, after):
    low = np.arange(0.0, 170.0, 2.0)
    usual = 2e-4 * (1 + 10 * np.exp(-low / 3))
    peak = 1 + 5 * np.exp(-(((low - 50) / 6) ** 2))
    return tuple(
        Band(low_hz=hz, high_hz=hz + 2, before=before * p, after=after * p, usual=u)
        for hz, p, u in zip(low.tolist(), peak.tolist(), usual.tolist(), strict=True)
    )


def gap(verdict, criterion, causes, nothing, unknown, before=BEFORE, after=SMALL, **more):
    diagnosis = Diagnosis(
        verdict=verdict,
        criterion=criterion,
        before=before,
        after=after,
        matters=Matters(),
        causes=causes,
        probability_nothing=nothing,
        nothing_minus_two_log=1500.0,
        unknown_gain=None,
        probability_unknown=max(1 - nothing - sum(c.probability for c in causes), 0.0),
        unknown=unknown,
        bands=bands(before.share, after.share),
        equivalent=more.pop("equivalent", ()),
        separate_by=more.pop("separate_by", ()),
        attribution=more.pop("attribution", attribution()),
        figures=FIGURES,
        curves=curves(),
        **more,
    )
    return Gap(**asdict(diagnosis), sentence=sentence(diagnosis))


ONE_MASS = Attribution(
    channels={"mass_displacement": 1.0},
    modal_equations={"mass": 1.0},
    positions_m={"mass": {0.0: 1.0}},
    band_hz=(Share(0.0, 2.0, 0.4), Share(2.0, 5.0, 0.6)),
    contact_state={"open": 1.0},
    time_s=(Share(0.0, 10.0, 0.5), Share(10.0, 20.0, 0.5)),
    surface={"mass": surface(3.0)},
    parts={"linear": 1.0},
)


def compared(parameter, place, values, p_value, trend):
    return Compared(
        parameter=parameter,
        place=place,
        values=tuple(Value(v, 0.002, "1") for v in values),
        p_value=p_value,
        trend=trend,
    )


BETWEEN = Between(
    records=("1, 12 N", "2, 18 N", "3, 24 N, validates"),
    cause=(compared("sensor_gain.factor", "barrel_4", (1.02, 1.021, 1.019), 0.61, "none"),),
    cause_p_value=0.61,
    differing=(compared("contact_clearance.factor", "contact_2", (1.006, 1.006, 1.087), 3e-9, "grows"),),
    looked_at=70,
)

GAPS = {
    "explained": gap(
        "explained",
        "what is left is 0.16 times what matters",
        (MASS, CLAMP),
        0.005,
        None,
        equivalent=(("added_mass", "clamp_compliance"),),
        separate_by=("added_mass: weigh the part", "clamp_compliance: measure close to the clamp"),
        channel_faults={"cradle_3": "dead"},
        next_experiments=(
            NextExperiment("hang a known 395 g on the cradle at 1 m", 7.3),
            NextExperiment("record with 2.5 times the force", 2.1),
            NextExperiment(AGAIN, 0.4),
            NextExperiment("record with 0.3 times the force", -0.1),
        ),
        next_between=("added_mass", "clamp_compliance"),
    ),
    "pair": gap(
        "explained",
        "tolerances and noise leave as much in 31 % of all cases",
        (PAIR, CLAMP, CUBIC),
        0.1,
        None,
        between=BETWEEN,
    ),
    "partly_explained": gap(
        "partly_explained",
        "what is left is 2.8 times what matters",
        (replace(MASS, explained=0.87, interval_95=(0.85, 0.88), left=REST), CUBIC),
        0.003,
        tone(),
        after=REST,
        separate_by=("added_mass: weigh the part",),
    ),
    "unknown": gap(
        "unknown",
        "no effect of the library is likelier than something unknown",
        (replace(CUBIC, probability=1e-12),),
        1e-50,
        softening(),
        after=BEFORE,
    ),
    "null": gap(
        "no_gap",
        "what the believed rig leaves is 0.5 times what matters",
        (replace(CLAMP, probability=0.03, explained=0.0, interval_95=(-0.1, 0.1), left=SMALL),),
        0.97,
        None,
        before=SMALL,
        after=SMALL,
    ),
    "one_mass": gap(
        "explained",
        "what is left is 0.16 times what matters",
        (replace(MASS, places={"added_mass.body": "mass"}, left=left(4e-4, p_value=0.31)),),
        0.066,
        None,
        before=left(0.067, p_value=1e-9),
        after=left(4e-4, p_value=0.31),
        attribution=ONE_MASS,
    ),
}
RIGS = {name: Sdof().rig() if name == "one_mass" else BarrelCradle().rig() for name in GAPS}


@pytest.fixture(scope="session", params=list(GAPS))
def diagnosis(request):
    return GAPS[request.param]


@pytest.fixture(scope="session")
def rig_of():
    """The rig that a diagnosis is of."""
    return lambda gap: RIGS["one_mass" if gap.attribution is ONE_MASS else "null"]


@pytest.fixture(scope="session")
def gaps():
    return GAPS


@pytest.fixture(scope="session")
def recorded_machine(tmp_path_factory):
    """A function that records a reference rig with some effects, of which rig.json knows nothing."""

    def made(settings, *effects):
        path = tmp_path_factory.mktemp("machine") / "r.mcap"
        actual = settings.rig()
        for effect in effects:
            actual = effect.applied_to(actual)
        record(
            settings.rig(),
            settings.force(),
            plant=modal.simulate,
            duration_s=settings.duration_s,
            step_s=settings.step_s,
            path=path,
            actual=actual,
            progress=lambda _: None,
        )
        return read(path)

    return made
