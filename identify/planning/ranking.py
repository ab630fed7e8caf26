"""Planning: the unchanged test and each change of it simulated, identified, compared and ranked.

Notes for maintainers
1. A change is compared with the unchanged test under the same seeds, on records of at most
   `MAX_TRIED_SAMPLES`: where the motion stays as it is (tolerances, noise, sensors), chance cancels.
2. Where it does not (force, band, place), one record's interval may be short by chance: all changes are tried
   under the force whose intervals are usual among several, and the best ones under the others, too.
3. Medians are taken: a part of one record may tell so little that its interval is several times as long.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from identify.contacts.separation import check_rig_is_modelled
from identify.gaps.decision.prepare import simulator_named
from identify.pages.wording import COVERED
from identify.planning.changes import PlannedChange, changes_of
from identify.planning.detectable import DetectableEffect, detectable_effects
from identify.planning.expectation import (
    MAX_MISS_STANDARD_ERRORS,
    ExpectedContact,
    SimulatedTest,
    Undetermined,
    expected_contacts,
    largest_error_z_and_contact,
    simulated_test,
)
from identify.planning.planned_test import PlannedTest
from identify.planning.results import IntervalFactor, PlannedBase, PlannedForce, PlanReport, TriedChange
from rig.processes import mapped

LONGEST_SIMULATED_S, MAX_TRIED_SAMPLES = 60.0, 2**16
"""Longest simulated record, s, and most samples of one that compares a change. Effort."""
SEEDS = (1, 2, 3)
SIMULATION_COUNT = len(SEEDS)
"""Number of simulated records for the expected intervals, and for the best changes; odd, as medians are taken."""
FINALIST_COUNT = 4
"""Number of changes that get further simulations. Effort."""
MAX_CHANGE_COUNT = 40
"""Default of the largest number of changes, sensors left out included."""
NO_EFFECTS_IN_SPACE = "effects that identify gap would name are predicted for rigs that move in one direction alone"
RANKED_QUANTITIES = ("clearance_m", "stiffness_n_per_m")
"""Quantities whose intervals rank changes: a damping of zero has no share."""

SimulationRun = tuple[PlannedTest, str, int, float]
"""Test, name of the simulator, seed, and longest simulated time, s."""
IntervalShares = Mapping[tuple[str, str], float]
"""Half of the 95 % interval over the value by contact and quantity."""


def ranked_plan(
    test: PlannedTest,
    simulator: str = "modal",
    max_change_count: int = MAX_CHANGE_COUNT,
    workers: int = 1,
    progress: Callable[[float], None] = lambda _: None,
) -> PlanReport:
    """Plan of a test by the named simulator.

    Raises RigError if the rig has no contacts or nothing that the identification knows, or if it cannot be simulated.
    """
    check_rig_is_modelled(test.rig)
    simulator_named(simulator)
    all_changes = list(changes_of(test))
    changes = all_changes[:max_change_count]
    finalist_count = min(FINALIST_COUNT, sum(change.kind != "leave out sensor" for change in changes))
    run_count = SIMULATION_COUNT * (2 if changes else 1) + len(changes) + finalist_count * (SIMULATION_COUNT - 1) + 1

    def run_all(runs: Sequence[SimulationRun], finished_count: int) -> list[SimulatedTest]:
        return mapped(_simulated_run, runs, workers, lambda finished: progress((finished_count + finished) / run_count))

    outcomes = run_all([(test, simulator, seed, LONGEST_SIMULATED_S) for seed in SEEDS], 0)
    tried_changes = _tried_changes(
        test, changes, simulator, lambda runs, finished: run_all(runs, SIMULATION_COUNT + finished)
    )
    effects, effect_notes = _effects_and_notes(test, simulator)
    progress(1.0)
    expectations = expected_contacts(test.rig, outcomes)
    sensor_removals = sorted(
        (r for r in tried_changes if r.kind == "leave out sensor"), key=_sensor_need_key, reverse=True
    )
    return PlanReport(
        rig=test.rig.name,
        duration_s=test.duration_s,
        force=PlannedForce(rms_n=test.force_rms_n, band_hz=test.band_hz) if test.force_rms_n else None,
        base=None
        if test.base_rms_m_per_s2 is None
        else PlannedBase(acceleration_rms_m_per_s2=test.base_rms_m_per_s2, band_hz=test.band_hz),
        contacts=tuple(c for c in expectations if isinstance(c, ExpectedContact)),
        undetermined=tuple(c for c in expectations if isinstance(c, Undetermined)),
        changes=tuple(sorted((r for r in tried_changes if r.kind != "leave out sensor"), key=_rank_key)),
        sensors=tuple(sensor_removals),
        simulations=SIMULATION_COUNT,
        simulated_s=min(test.duration_s, LONGEST_SIMULATED_S),
        effects=effects,
        notes=(*_plan_notes(test, outcomes, len(changes) < len(all_changes)), *effect_notes),
    )


def _effects_and_notes(test: PlannedTest, simulator: str) -> tuple[tuple[DetectableEffect, ...], tuple[str, ...]]:
    """Smallest named effects; or none, and a note, of rigs in space and where this side analysis fails."""
    if test.rig.in_space:
        return (), (NO_EFFECTS_IN_SPACE,)
    try:
        return detectable_effects(test, simulator_named(simulator).simulate, SEEDS[0], LONGEST_SIMULATED_S), ()
    except Exception as error:
        return (), (f"which effects would be named could not be computed: {error}",)


def _tried_changes(
    test: PlannedTest,
    changes: Sequence[PlannedChange],
    simulator: str,
    run_all: Callable[[Sequence[SimulationRun], int], list[SimulatedTest]],
) -> list[TriedChange]:
    """Changes against the unchanged test, in their order. `run_all` takes runs, and how many were done before them."""
    if not changes:
        return []
    unchanged = run_all([_changed_test_run(test, test, simulator, seed) for seed in SEEDS], 0)
    seed_order = sorted(range(SIMULATION_COUNT), key=lambda index: _widest_interval_share(unchanged[index]))
    usual_index = seed_order.pop(SIMULATION_COUNT // 2)
    first_runs = [_changed_test_run(test, change.test, simulator, SEEDS[usual_index]) for change in changes]
    outcome_lists = [
        [_of_the_same_record(change, test, unchanged[usual_index], outcome)]
        for change, outcome in zip(changes, run_all(first_runs, SIMULATION_COUNT), strict=True)
    ]
    reference = [unchanged[usual_index], *(unchanged[index] for index in seed_order)]
    tried_changes = [
        _tried_change(change, reference[:1], outcomes) for change, outcomes in zip(changes, outcome_lists, strict=True)
    ]
    finalists = _finalist_indices(tried_changes)
    further_runs = [
        _changed_test_run(test, changes[k].test, simulator, SEEDS[i]) for k in finalists for i in seed_order
    ]
    further_outcomes = iter(run_all(further_runs, SIMULATION_COUNT + len(changes)))
    for k in finalists:
        outcome_lists[k] += [
            _of_the_same_record(changes[k], test, unchanged[index], next(further_outcomes)) for index in seed_order
        ]
        tried_changes[k] = _tried_change(changes[k], reference, outcome_lists[k])
    return tried_changes


def _of_the_same_record(
    change: PlannedChange, test: PlannedTest, before: SimulatedTest, after: SimulatedTest
) -> SimulatedTest:
    """Outcome of a change. Of a longer record, what it determines alone; the other intervals are those of the shorter
    one for longer, as another record's may be wider by chance."""
    if change.kind != "duration":
        return after
    length_ratio = change.test.duration_s / test.duration_s
    longer = {
        name: {quantity: parts.for_longer_record(length_ratio) for quantity, parts in quantity_parts.items()}
        for name, quantity_parts in before.error_parts.items()
    }
    refused = {name: refusal for name, refusal in after.refused_contacts.items() if name not in longer}
    return SimulatedTest({**after.error_parts, **longer}, refused)


def _changed_test_run(test: PlannedTest, changed_test: PlannedTest, simulator: str, seed: int) -> SimulationRun:
    """Run of a changed test for as long as that of the unchanged one; of one that lasts longer, longer in
    proportion."""
    max_simulated_s = min(test.duration_s, LONGEST_SIMULATED_S, MAX_TRIED_SAMPLES / test.rig.sample_rate_hz)
    return changed_test, simulator, seed, max_simulated_s * changed_test.duration_s / test.duration_s


def _simulated_run(run: SimulationRun) -> SimulatedTest:
    test, simulator, seed, max_simulated_s = run
    return simulated_test(test, simulator_named(simulator).simulate, seed, max_simulated_s)


def _interval_shares(outcome: SimulatedTest) -> IntervalShares:
    return {
        (contact_name, quantity): COVERED * parts.standard_error / abs(parts.simulated_value)
        for contact_name, quantity_parts in outcome.error_parts.items()
        for quantity, parts in quantity_parts.items()
        if quantity in RANKED_QUANTITIES and parts.simulated_value
    }


def _tried_change(
    change: PlannedChange, unchanged: Sequence[SimulatedTest], changed: Sequence[SimulatedTest]
) -> TriedChange:
    """Change against the unchanged test under the same seeds: medians over these."""
    pairs = [
        (_interval_shares(before), _interval_shares(after)) for before, after in zip(unchanged, changed, strict=True)
    ]
    names_before, names_after = (_determined_names(outcomes) for outcomes in (unchanged, changed))
    common_keys = set.intersection(*(set(before) & set(after) for before, after in pairs))
    log_factors = {
        key: float(np.median([np.log(after[key] / before[key]) for before, after in pairs])) for key in common_keys
    }
    widest_shares = np.array(
        [[_widest_interval_share(outcome) for outcome in outcomes] for outcomes in (unchanged, changed)]
    )
    largest = max(log_factors, key=lambda key: (abs(log_factors[key]), key), default=None)
    return TriedChange(
        kind=change.kind,
        words=change.words,
        widest_share=float(np.median(widest_shares[1])),
        widest_factor=float(np.median(widest_shares[1] / widest_shares[0])),
        largest=None
        if largest is None
        else IntervalFactor(contact=largest[0], quantity=largest[1], factor=float(np.exp(log_factors[largest]))),
        gained=tuple(sorted(names_after - names_before)),
        lost=tuple(sorted(names_before - names_after)),
        simulations=len(changed),
        largest_growth=float(np.exp(max(log_factors.values(), default=0.0))),
    )


def _determined_names(outcomes: Sequence[SimulatedTest]) -> set[str]:
    """Contacts that at least half of the records determine."""
    names = {name for outcome in outcomes for name in outcome.error_parts}
    return {name for name in names if sum(name in outcome.error_parts for outcome in outcomes) >= len(outcomes) / 2}


def _widest_interval_share(outcome: SimulatedTest) -> float:
    """Widest share; 1 if a contact is not determined."""
    return max([*_interval_shares(outcome).values(), *(1.0 for _ in outcome.refused_contacts)], default=1.0)


def _rank_key(change: TriedChange) -> tuple[int, float]:
    return len(change.lost) - len(change.gained), change.widest_factor


def _sensor_need_key(change: TriedChange) -> tuple[int, float]:
    """Need of a sensor that is left out."""
    return len(change.lost) - len(change.gained), change.largest_growth


def _finalist_indices(tried_changes: Sequence[TriedChange]) -> list[int]:
    """Indices of the best changes."""
    candidates = [index for index, change in enumerate(tried_changes) if change.kind != "leave out sensor"]
    return sorted(candidates, key=lambda index: _rank_key(tried_changes[index]))[:FINALIST_COUNT]


def _plan_notes(test: PlannedTest, outcomes: Sequence[SimulatedTest], is_truncated: bool) -> Iterator[str]:
    """Sentences on what the plan could not take into account."""
    if not any(sensor.noise_density or sensor.bits for sensor in test.rig.sensors):
        yield (
            "no sensor of rig.json states a noise_density or bits: the intervals are those of sensors without noise; "
            "state them"
        )
    if test.rig.tolerances is not None and not test.rig.tolerances.contacts_known:
        yield (
            "rig.json does not know its contacts: the plan is for the clearances and stiffnesses from which it starts; "
            "state those that you expect"
        )
    if test.duration_s > LONGEST_SIMULATED_S:
        yield (
            f"{LONGEST_SIMULATED_S:g} s were simulated; for {test.duration_s:g} s scatter and slow motion are taken to "
            "average, and tolerances are not"
        )
    miss, name = largest_error_z_and_contact(outcomes)
    if miss > MAX_MISS_STANDARD_ERRORS:
        yield (
            f"an estimate of {name} from a simulated record missed what was simulated by {miss:.1f} standard errors: "
            "do not rely on its expected interval"
        )
    if is_truncated:
        yield "not every change was tried; raise --changes for more"
