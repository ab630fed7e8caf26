from identify.signals.refit import refit_until_settled


def heron(root_of_two):
    return (root_of_two + 2 / root_of_two) / 2


def to_six_digits(before, after):
    return abs(after - before) < 1e-6 * after


def counted(refit):
    calls = []

    def counting(estimate):
        calls.append(estimate)
        return refit(estimate)

    return counting, calls


def test_stops_at_the_first_refit_that_changes_little():
    refit, calls = counted(heron)
    root = refit_until_settled(1.0, refit, to_six_digits, max_rounds=30)
    assert abs(root - 2**0.5) < 1e-12  # quadratic: the square of the tolerance
    assert len(calls) == 5  # 1.5, 1.4167, 1.414216, 1.41421356237469, and once more to see that it stands


def test_makes_no_more_refits_than_allowed():
    assert abs(refit_until_settled(1.0, heron, to_six_digits, max_rounds=2) - 17 / 12) < 1e-15
    assert refit_until_settled(1.0, heron, to_six_digits, max_rounds=0) == 1.0


def test_makes_a_least_number_of_refits_even_if_settled():
    refit, calls = counted(lambda estimate: estimate)
    refit_until_settled(1.0, refit, to_six_digits, max_rounds=9, min_rounds=4)
    assert len(calls) == 4


def test_makes_a_fixed_number_without_a_criterion():
    refit, calls = counted(lambda estimate: estimate)
    refit_until_settled(1.0, refit, max_rounds=3)
    assert len(calls) == 3
