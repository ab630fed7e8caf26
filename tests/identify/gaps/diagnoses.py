"""Diagnoses made by hand: one for each verdict, a pair, two masses of one body, and one mass without contacts."""

from itertools import pairwise

import numpy as np
from msgspec.structs import asdict, replace

from identify.gaps.decision.sentence import sentence
from identify.gaps.decision_table import Bounded, Evidence, Strength
from identify.gaps.results import (
    SAME_EXPERIMENT,
    Attribution,
    Band,
    Cause,
    Criteria,
    Diagnosis,
    Gap,
    Matters,
    NextExperiment,
    ParameterByRecord,
    RecordDifferences,
    ResidualMap,
    Share,
    UnexplainedShares,
    unique_effect_labels,
)
from identify.gaps.rollout.results import PredictionErrors, PredictionExample, Rollout
from rig.model.unmeasured_force import MeanForce, UnmeasuredForce, Value
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


def tuples(*rows):
    return tuple(tuple(np.asarray(row).tolist()) for row in rows)


def left(share, *contacts, p_value):
    contact_shares = {f"contact_{i}": s for i, s in enumerate(contacts, 1)}
    return UnexplainedShares(share=share, contact_shares=contact_shares, p_value=p_value)


def cause(effects, words, probability, explained, interval, left, parameters, instead=(), **places):
    """Of every effect the first of its parameters is the strength, neutral at 0; all are as probable as the cause."""
    values = {name: Value(*value) for name, value in parameters.items()}
    strengths = []
    for kind, label in zip(effects, unique_effect_labels(effects), strict=True):
        first = next(v for name, v in values.items() if name.startswith(f"{label}."))
        half = 1.96 * first.standard_error
        place = next((p for name, p in places.items() if name.startswith(label)), "all")
        interval_of_strength = (first.value - half, first.value + half)
        strengths.append(Strength(f"{kind}:{place}", probability, interval_of_strength, 0.0, instead))
    return Cause(
        effects=effects,
        words=words,
        strengths=tuple(strengths),
        probability=probability,
        parameters=values,
        places={name.replace("__", "."): place for name, place in places.items()},
        explained=explained,
        interval_95=interval,
        left=left,
        log_prior=-5.0,
        minus_two_log=900.0,
    )


BEFORE = left(0.067, 0.109, 0.021, p_value=1e-9)
SMALL = left(4e-4, 4e-3, 0.0, p_value=0.31)
REST = left(0.0123, 0.041, 0.0, p_value=2e-7)
MASS = cause(
    ("added_mass",),
    ("an added mass of 0.1414 ± 0.0021 kg on the barrel at 0.9899 ± 0.0041 m",),
    0.964,
    0.977,
    (0.961, 0.988),
    SMALL,
    {"added_mass.mass_kg": (0.1414, 0.00105, "kg", True), "added_mass.relative_position": (0.9899, 0.0021, "1")},
    instead=("clamp_compliance:all",),
    added_mass__body="barrel",
)
CLAMP = cause(
    ("clamp_compliance",),
    ("a clamp of the cradle that gives way (compliance 0.0173 ± 0.0018)",),
    0.031,
    0.12,
    (0.08, 0.17),
    BEFORE,
    {"clamp_compliance.compliance": (0.0173, 0.0009, "1")},
)
PAIR = cause(
    ("coulomb_friction", "sensor_delay"),
    (
        "a dry friction of 0.764 ± 0.061 N in contact_2",
        "a signal of sensor barrel_4 that comes 0.1830 ± 0.0078 ms too late",
    ),
    0.96,
    0.94,
    (0.91, 0.96),
    SMALL,
    {"coulomb_friction.friction_n": (0.764, 0.031, "N"), "sensor_delay.delay_s": (1.83e-4, 4e-6, "s")},
    coulomb_friction__contact="contact_2",
    sensor_delay__sensor="barrel_4",
)
CABLES = cause(
    ("added_mass", "added_mass"),
    (
        "an added mass of 0.01200 ± 0.00020 kg on the barrel at 0.9110 ± 0.0039 m",
        "an added mass of 0.00930 ± 0.00020 kg on the barrel at 0.4880 ± 0.0039 m",
    ),
    0.97,
    0.98,
    (0.97, 0.99),
    SMALL,
    {
        "added_mass.mass_kg": (0.012, 1e-4, "kg"),
        "added_mass.relative_position": (0.911, 0.002, "1"),
        "added_mass_2.mass_kg": (0.0093, 1e-4, "kg"),
        "added_mass_2.relative_position": (0.488, 0.002, "1"),
    },
    added_mass__body="barrel",
    added_mass_2__body="barrel",
)
CUBIC = cause(
    ("hardening_spring",),
    ("a cubic spring of (2.960 ± 0.080)e10 N/m³ between the barrel at 1.00 m and the ground",),
    0.012,
    -0.02,
    (-0.05, 0.01),
    BEFORE,
    {"hardening_spring.stiffness_n_per_m3": (2.96e10, 4.1e8, "N/m^3")},
)


def softening():
    """A force that saturates with the displacement at its place, and what it was seen at."""
    w, v = np.linspace(-40e-3, 40e-3, 25), np.linspace(-1.2, 1.2, 25)
    middle_w, middle_v = (w[1:] + w[:-1]) / 2, (v[1:] + v[:-1]) / 2
    visited = (middle_w[:, None] / 40e-3) ** 2 + (middle_v[None, :] / 1.2) ** 2 < 1
    force = np.where(visited, 11.0 * np.tanh(middle_w / 2.6e-3)[:, None], 0.0)
    hz = np.arange(1.0, 171.0, 2.0)
    return UnmeasuredForce(
        sentence="a softening spring on the barrel near 0.89140 ± 0.00027 m, k w0 tanh(w / w0), k = 4240 ± 59 N/m, "
        "w0 = 2.590 ± 0.039 mm",
        kind="force",
        body="barrel",
        position_m=0.8914,
        position_error_m=1.4e-4,
        band_hz=(2.01, 19.98),
        rms_n=10.53,
        before_excitation=0.04,
        by_time=(10.5, 11.3, 11.3, 11.2, 10.1, 9.5, 10.9, 10.5),
        against="displacement",
        law_name="softening spring",
        law="k w0 tanh(w / w0), k = 4240 ± 59 N/m, w0 = 2.590 ± 0.039 mm",
        law_parameters={"coefficient": Value(4240.0, 30.0, "N/m"), "w0": Value(2.59e-3, 2e-5, "m")},
        explained=0.992,
        over_motion=MeanForce(*tuples(w, v), tuples(*force)),
        spectrum_hz=tuple(hz.tolist()),
        spectrum=tuple((37.0 / (1 + (hz / 5) ** 4)).tolist()),
    )


def tone():
    hz = np.arange(1.0, 171.0, 2.0)
    return UnmeasuredForce(
        sentence="a force at 50.02 Hz, 1.40 N, on the cradle near 0.8000 ± 0.0078 m",
        kind="force",
        body="cradle",
        position_m=0.8,
        position_error_m=0.004,
        frequency_hz=50.02,
        band_hz=(49.0, 51.0),
        rms_n=0.99,
        amplitude_n=1.4,
        by_time=(1.0,) * 8,
        law_name="tone",
        law="A cos(2 pi f t) + B sin(2 pi f t), A = 1.20 N, B = 0.720 N, f = 50.02 Hz",
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


def quantities(left, upper=1.2, hidden=""):
    """Shares with upper bounds above by a factor; noise hides one of the contacts."""
    rows = [("motion", left.share, 5e-3), *((f"force of {n}", s, 3e-2) for n, s in left.contact_shares.items())]
    return tuple(
        Bounded(name, "1", value, None, limit, "noise hides it", "excite the rig more strongly")
        if name == hidden
        else Bounded(name, "1", value, upper * value + 1e-4, limit)
        for name, value, limit in rows
    )


def gap(causes, nothing, unknown, before=BEFORE, after=SMALL, hidden="", **more):
    """The verdict follows from what is left before and after."""
    strengths = causes[0].strengths if causes else ()
    evidence = Evidence(
        p_value=more.pop("p_value", before.p_value),
        quantities=quantities(before, hidden=hidden),
        strengths=strengths,
        p_value_after=after.p_value,
        quantities_after=quantities(after),
        removed=causes[0].explained if causes else 0.0,
        vetoed=more.pop("vetoed", False),
    )
    diagnosis = Diagnosis(
        verdict=evidence.verdict,
        criteria=Criteria(evidence.differs, evidence.bounded, evidence.named, evidence.enough),
        evidence=evidence,
        not_seen=evidence.not_seen,
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
        **{"separate_by": (), "attribution": attribution(), **more},
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
    values = tuple(Value(v, 0.002, "1") for v in values)
    return ParameterByRecord(parameter=parameter, place=place, values=values, p_value=p_value, trend=trend)


BETWEEN = RecordDifferences(
    records=("1, 12 N", "2, 18 N", "3, 24 N, validates"),
    cause=(compared("sensor_gain.factor", "barrel_4", (1.02, 1.021, 1.019), 0.61, "none"),),
    cause_p_value=0.61,
    differing=(compared("contact_clearance.factor", "contact_2", (1.006, 1.006, 1.087), 3e-9, "grows"),),
    looked_at=70,
)

TIME_S = np.arange(180) / 1000
PREDICTED = Rollout(
    code="not_vetoed",
    example=PredictionExample(
        sensor="barrel_6",
        unit="m/s",
        time_s=tuples(12.4 + TIME_S)[0],
        measured=tuples(np.sin(2 * np.pi * 18 * TIME_S))[0],
        nominal=tuples(np.sin(2 * np.pi * (18 + 20 * TIME_S) * TIME_S))[0],
        corrected=tuples(np.sin(2 * np.pi * (18 + TIME_S) * TIME_S))[0],
    ),
    horizon_s=0.18,
    windows=160,
    whole=PredictionErrors(nominal=0.36, corrected=0.08, null_median=0.07, null_95=0.14, shrunk=0.99),
    shrunk_95=(0.97, 1.0),
    within=0.33,
    log_ratio=-1.4,
    log_ratio_error=0.1,
    expected_log_ratio=-1.3,
)
CERTAIN = left(3e-3, 1.5e-2, 0.0, p_value=1e-4)


def unsure(one, probability):
    """A cause that is hardly likely, and closes nothing."""
    strengths = tuple(replace(s, inclusion_probability=probability) for s in one.strengths)
    one = replace(one, explained=0.0, interval_95=(-0.1, 0.1), left=SMALL)
    return replace(one, probability=probability, strengths=strengths)


GAPS = {
    "explained": gap(
        (MASS, CLAMP),
        0.005,
        None,
        separate_by=("added_mass: weigh the part", "clamp_compliance: measure close to the clamp"),
        channel_faults={"cradle_3": "dead"},
        next_experiments=(
            NextExperiment("hang a known 395 g on the cradle at 1 m", 7.3),
            NextExperiment("record with 2.5 times the force", 2.1),
            NextExperiment(SAME_EXPERIMENT, 0.4),
            NextExperiment("record with 0.3 times the force", -0.1),
        ),
        next_between=("added_mass", "clamp_compliance"),
        rollout=PREDICTED,
    ),
    "pair": gap((PAIR, CUBIC), 0.001, None, between=BETWEEN),
    "cables": gap((CABLES, CUBIC), 0.003, None),
    "partly_explained": gap(
        (replace(MASS, explained=0.87, interval_95=(0.85, 0.88), left=REST), CUBIC),
        0.003,
        tone(),
        after=REST,
        separate_by=("added_mass: weigh the part",),
    ),
    "vetoed": gap(
        (replace(MASS, explained=0.3, interval_95=(0.25, 0.35), left=SMALL), CUBIC),
        0.003,
        None,
        vetoed=True,
        rollout=replace(PREDICTED, code="worse", log_ratio=0.4),
    ),
    "unexplained": gap((unsure(CUBIC, 1e-12),), 1e-50, softening(), after=BEFORE),
    "small": gap((MASS, CUBIC), 0.01, None, before=CERTAIN),
    "consistent": gap((unsure(CLAMP, 0.03),), 0.97, None, before=SMALL, after=SMALL),
    "cannot_tell": gap((unsure(CLAMP, 0.03),), 0.97, None, before=SMALL, after=SMALL, hidden="force of contact_1"),
    "one_mass": gap(
        (replace(MASS, places={"added_mass.body": "mass"}, left=left(4e-4, p_value=0.31)),),
        0.036,
        None,
        before=left(0.067, p_value=1e-9),
        after=left(4e-4, p_value=0.31),
        attribution=ONE_MASS,
    ),
}
RIGS = {name: Sdof().rig() if name == "one_mass" else BarrelCradle().rig() for name in GAPS}
