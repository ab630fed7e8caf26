"""The quality of a joint fit: what is said of it, and what its intervals become."""

from dataclasses import replace

import numpy as np
import pytest

from identify.contacts.acceptance import fit_findings, nifo_contradiction_findings, with_errors_widened_by_pulls
from identify.contacts.joint_fit import JointEstimate
from identify.linear.modal import ModalEquation
from identify.linear.nuisance import Nuisance, NuisanceKind
from identify.paper.nifo import Nifo

PARAMETERS = (
    Nuisance(NuisanceKind.FREQUENCY, "beam"),
    Nuisance(NuisanceKind.FREQUENCY, "beam", 3),
    Nuisance(NuisanceKind.GAIN, "a"),
)


def joint(pulls=(0.0, 0.0, 0.0), damping=1.0, halves=(0.0, 0.0), unexplained=0.01) -> JointEstimate:
    return JointEstimate(
        values=np.array([1e-3, 1e-3, 1e5, damping]),
        covariances={source: np.diag([5e-13, 5e-13, 5e3, 0.005]) for source in ("scatter", "tolerances")},
        sides_known=True,
        touched=(True, True),
        drift_m=np.zeros(4),
        drift_m_per_s=np.zeros(4),
        pulls=np.array(pulls),
        unexplained_share=unexplained,
        split_half_z=halves,
    )


@pytest.mark.parametrize(
    ("pull", "mass_pull", "factor"),
    [(1.0, 0.0, 1.0), (2.0, 1.0, 2.0), (-3.0, 2.0, 3.0), (0.0, 0.75, 1.25), (2.0, 2.4, 2.6)],
)
def test_errors_grow_with_the_pull_of_a_whole_body(pull, mass_pull, factor):
    widened = with_errors_widened_by_pulls(
        joint((pull, 4.0, 4.0, 0.0)), (*PARAMETERS, Nuisance(NuisanceKind.FREQUENCY, "base")), mass_pull
    )
    np.testing.assert_allclose(widened.errors, factor * joint().errors)


@pytest.mark.parametrize(("pull", "mass_pull", "factor"), [(0.0, 0.0, 1.0), (0.75, 0.0, 1.25), (-2.4, 0.75, 2.6)])
def test_of_a_rig_of_one_body_any_pull_counts(pull, mass_pull, factor):
    widened = with_errors_widened_by_pulls(joint((pull, 4.0, 4.0)), PARAMETERS, mass_pull)
    np.testing.assert_allclose(widened.errors, factor * joint().errors)


@pytest.mark.parametrize(("held", "factor"), [(True, 3.0), (False, 1.0)])
def test_a_high_pass_that_is_pulled_counts_where_a_spring_holds_the_bodies(held, factor):
    parameters = (
        Nuisance(NuisanceKind.FREQUENCY, "beam"),
        Nuisance(NuisanceKind.FREQUENCY, "base"),
        Nuisance(NuisanceKind.HIGH_PASS, "a"),
    )
    widened = with_errors_widened_by_pulls(replace(joint((0.0, 0.0, -3.0)), sides_known=held), parameters, 0.0)
    np.testing.assert_allclose(widened.errors, factor * joint().errors)


@pytest.mark.parametrize(
    ("fit", "cause", "of"),
    [
        (joint((5.0, 0.0, 0.0)), "frequency", "beam"),
        (joint((0.0, -6.0, 0.0)), "frequency", "beam 3"),
        (joint((0.0, 0.0, 5.0)), "gain", "a"),
        (joint(damping=-0.6), "fit", "stop"),
        (joint(halves=(0.0, -3.9)), "fit", "stop"),
        (joint(unexplained=0.5), "fit", "stop"),
    ],
)
def test_a_fit_that_cannot_be_is_named(fit, cause, of):
    (findings,) = fit_findings({"stop": fit}, PARAMETERS)
    assert (findings.cause, findings.of) == (cause, of)


def test_a_fit_within_its_tolerances_has_no_finding():
    assert list(fit_findings({"stop": joint((2.0, 3.0, -4.0))}, PARAMETERS)) == []


@pytest.mark.parametrize(
    ("mean", "spread", "visibility", "named"),
    [
        (1.02e5, 0.02, 1.0, False),  # agrees with the joint fit's 1e5 N/m
        (0.8e5, 0.02, 1.0, True),
        (0.8e5, 0.2, 1.0, False),  # is not sure
        (0.8e5, 0.02, 0.1, False),  # hardly sees the contact
    ],
)
def test_a_modal_equation_that_is_sure_of_another_stiffness_is_named(mean, spread, visibility, named):
    still = np.zeros(4)
    equation = ModalEquation("beam", 2, 30.0, 0.01, 1.0, np.ones(1), (visibility,), still, still, still)
    over_frequency = mean * (1 + spread * np.array([[1.0, -1.0] * 8]))
    lines = np.arange(16.0)
    nifo = Nifo(equation, (0,), lines, lines + 0j, over_frequency + 0j, np.array([50.0]), 10, 1.0)
    findings = list(nifo_contradiction_findings(["stop"], {"stop": joint()}, [nifo]))
    assert [f.of for f in findings] == ["stop"] * named
    assert list(nifo_contradiction_findings(["stop"], {}, [nifo])) == []
