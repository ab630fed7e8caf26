"""Hand-made answers and hand-made findings."""

import numpy as np

from identify.gaps.decision_table import Evidence, Strength
from identify.gaps.results import Attribution, Cause, Criteria, Gap, Matters, UnexplainedShares, unique_effect_labels
from rig.model.unmeasured_force import UnmeasuredForce, Value
from tests.campaigns.blind_diagnosis import Found, Refused
from tests.campaigns.scoreboard import ScoredCase
from tests.campaigns.true_effect import Best, TrueEffect
from tests.campaigns.worlds.believed import believed_rig, nominal_machine
from tests.campaigns.worlds.truth import Case, EffectTruth, Expected

MACHINE = nominal_machine(believed_rig("own", np.random.default_rng(1)))
NOTHING = Attribution(
    channels={}, modal_equations={}, positions_m={}, band_hz=(), contact_state={}, time_s=(), surface={}
)
EVIDENCE = Evidence(p_value=0.001, quantities=(), strengths=(), p_value_after=0.5, quantities_after=(), removed=0.9)
CRITERIA = Criteria(True, False, (), False)
ABOVE, BELOW = TrueEffect(made=5.0, gain=50.0, needed=32.0), TrueEffect(made=0.5, gain=8.0, needed=32.0)


def effect(name, place=None, strength=1.0, **parameters):
    fields = ("uncounted", "stand_ins")
    more = {field: parameters.pop(field) for field in fields if field in parameters}
    return EffectTruth(name=name, parameters=parameters, place=place or {}, strength=strength, **more)


def case(kind, *effects, name=None, expected=None, sha256=None):
    machines = dict.fromkeys(("nominal", "drawn", "true"), MACHINE)
    return Case(
        case=name or " and ".join((kind, *(e.name for e in effects))),
        world="own",
        kind=kind,
        effects=effects,
        expected=expected,
        hung=False,
        records=(),
        draw=0,
        refused=(),
        sha256=sha256 or {},
        **machines,
    )


def expected(where, law, **fields):
    return Expected(where=where, law=law, **fields)


def left(share):
    """What is left, of what matters by default: share / 0.005."""
    return UnexplainedShares(share=share, contact_shares={"contact_1": 0.0}, p_value=0.5)


def cause(
    *effects, probability=0.9, included=0.99, instead=(), log_prior=-6.0, minus_two_log=0.0, leaves=0.005, **fields
):
    """Parameters and places as EFFECT__FIELD; `instead` are the look-alikes of the first effect."""
    parameters = {k.replace("__", "."): v for k, v in fields.items() if isinstance(v, Value)}
    places = {k.replace("__", "."): v for k, v in fields.items() if isinstance(v, str)}
    strengths = []
    for label, kind in zip(unique_effect_labels(effects), effects, strict=True):
        value = next((v for k, v in parameters.items() if k.startswith(f"{label}.")), Value(1.0, 0.01, "1"))
        half = 1.96 * value.standard_error
        name = ":".join([kind, *(place for k, place in places.items() if k.startswith(f"{label}."))])
        look_alikes = () if strengths else tuple(instead)
        strengths.append(Strength(name, included, (value.value - half, value.value + half), -1e9, look_alikes))
    return Cause(
        effects=effects,
        words=effects,
        strengths=tuple(strengths),
        probability=probability,
        parameters=parameters,
        places=places,
        explained=0.8,
        interval_95=(0.0, 1.0),
        left=left(leaves),
        log_prior=log_prior,
        minus_two_log=minus_two_log,
    )


def gap(
    verdict,
    *causes,
    nothing=0.1,
    unknown=0.0,
    force=None,
    nothing_minus_two_log=100.0,
    unknown_gain=None,
    evidence=EVIDENCE,
    criteria=CRITERIA,
    rollout=None,
):
    return Gap(
        verdict=verdict,
        sentence="",
        before=left(0.05),
        after=left(0.005),
        matters=Matters(),
        causes=causes,
        probability_nothing=nothing,
        probability_unknown=unknown,
        nothing_minus_two_log=nothing_minus_two_log,
        unknown_gain=unknown_gain,
        unknown=force,
        bands=(),
        criteria=criteria,
        evidence=evidence,
        rollout=rollout,
        not_seen=(),
        separate_by=(),
        attribution=NOTHING,
    )


def force(kind, body=None, position_m=None, sensor=None, contact=None, law="", against="none", frequency_hz=None):
    return UnmeasuredForce(
        sentence="a force",
        kind=kind,
        body=body,
        position_m=position_m,
        position_error_m=None if position_m is None else 0.01,
        sensor=sensor,
        contact=contact,
        frequency_hz=frequency_hz,
        band_hz=(1.0, 200.0),
        rms_n=1.0,
        when="always",
        against=against,
        law=law,
        explained=0.9,
    )


def found(of, name="case", sha256=None, cpu_s=10.0, null_references_cpu_s=None):
    return Found(
        case=name,
        sha256=sha256 or {},
        gap=of,
        cpu_s=cpu_s,
        null_references_cpu_s=null_references_cpu_s or {"fit": 0.0, "validation": 0.0},
        memory_mib=500.0,
        tolerances=None,
    )


def compared(truth, of, *limits, before=10.0, usual=0.5, refusal="", **costs):
    """limits: what each true effect achieves, above its limit if nothing is said; `of`: None if it was refused."""
    if truth.kind != "outside" and not refusal:
        limits = limits or (ABOVE,) * len(truth.effects)
    answer = found(of, truth.case, **costs) if of else Refused(case=truth.case, sha256={}, sentence="no", **costs)
    return ScoredCase(truth, answer, Best(before, limits, refusal), usual)
