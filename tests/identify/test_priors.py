"""What is believed before the runs: a prior is outweighed by what they tell, and by no more."""

import numpy as np
import pytest

from drftjax.common.errors import InputError
from identify.fit_constant import fit
from identify.parameters.parameter import own, shared
from identify.uncertainty.priors import PRIOR_SETTINGS
from tests.helpers.synthetic_runs import SLOW, coarse, recorded, setup_of

LAMBDA, ZETA = "terrain.inertial_coefficient", "terrain.zeta"
TRUE_LAMBDA = setup_of().terrain.inertial_coefficient
# At the paper's speed the runs tell next to nothing of lambda, some sixteen times less than these
# priors: they move it by a sixteenth of their own error's share, of which there may be three.
UNTOLD, PULLED = 0.05, 3 / 16
# Two equal sources together err by 1 / sqrt(2) of one, and meet half way, as far as the simulation
# is straight over the errors.
ALIKE = 0.1
# Two solvers stop within this part of an error of one another.
SAME = 0.1
# A standard deviation of so many draws is known to 1 / sqrt(2 n) of itself; three times that.
DRAWS = 400
SCATTER = 3 / np.sqrt(2 * DRAWS)


@pytest.fixture(scope="module")
def runs():
    return [coarse(f"run_{k}", recorded(setup_of(SLOW, z), k)) for k, z in enumerate((0.74, 0.76))]


@pytest.mark.parametrize("mean", [0.5 * TRUE_LAMBDA, 3 * TRUE_LAMBDA])
def test_what_runs_do_not_tell_stays_as_believed(runs, mean):
    error = 0.2 * mean
    result = fit(runs, [own("zeta"), shared("lambda", prior=(mean, error))])
    value = result.shared[LAMBDA]
    assert abs(value.value - mean) < PULLED * error
    assert value.error == pytest.approx(error, rel=UNTOLD)
    assert value.error <= error
    assert [run.status for run in result.runs] == ["converged"] * 2


def test_no_prior_makes_an_error_wider_than_itself_or_than_without_it(runs):
    plain = [run.values[ZETA].error for run in fit(runs, [own("zeta")]).runs]
    for width in (1e-4, 1e-3, 1e-2, 1e-1):
        known = fit(runs, [own("zeta", prior=(0.75, width))])
        for run, alone in zip(known.runs, plain, strict=True):
            assert run.values[ZETA].error <= min(width, alone * (1 + ALIKE))


def test_a_belief_as_good_as_the_runs_meets_them_half_way(runs):
    alone = fit(runs[:1], [own("zeta", prior=(0.75, 10.0))]).runs[0].values[ZETA]
    mean = alone.value + 2 * alone.error
    both = fit(runs[:1], [own("zeta", prior=(mean, alone.error))]).runs[0].values[ZETA]
    assert both.error == pytest.approx(alone.error / np.sqrt(2), rel=ALIKE)
    assert (both.value - alone.value) / alone.error == pytest.approx(1.0, abs=ALIKE)


def test_a_belief_that_runs_contradict_is_told_with_how_far_they_are_apart(runs):
    alone = fit(runs[:1], [own("zeta", prior=(0.75, 10.0))])
    zeta = alone.runs[0].values[ZETA]
    assert not any("contradict" in each for each in alone.findings)
    for far in (2.0, 10.0):
        prior = (zeta.value + far * np.sqrt(2) * zeta.error, zeta.error)
        told = [e for e in fit(runs[:1], [own("zeta", prior=prior)]).findings if "contradict" in e]
        assert len(told) == (far > PRIOR_SETTINGS.conflict)
        for each in told:
            assert each.startswith("zeta of run_0: its prior and the runs contradict each other")
            apart = float(each.split(" by ")[1].split()[0])
            assert apart == pytest.approx(far, rel=ALIKE)


def test_a_belief_that_says_nothing_changes_nothing(runs):
    plain = fit(runs, [own("zeta")])
    vague = fit(runs, [own("zeta", prior=(0.7, 10.0))])
    for run, other in zip(plain.runs, vague.runs, strict=True):
        assert (
            abs(run.values[ZETA].value - other.values[ZETA].value) < SAME * run.values[ZETA].error
        )
        assert other.values[ZETA].error == pytest.approx(run.values[ZETA].error, rel=SAME)


def test_draws_hold_what_was_believed(runs):
    mean = 2 * TRUE_LAMBDA
    result = fit(runs, [own("zeta"), shared("lambda", prior=(mean, 0.2 * mean))])
    drawn = result.bootstrap(DRAWS)
    errors = np.array([value.error for value in result.values.values()])
    np.testing.assert_allclose(drawn.bootstraps[0].error, errors, rtol=SCATTER)
    with pytest.raises(InputError, match="would outweigh the priors; leave refit out"):
        result.bootstrap(DRAWS, refit=True)


def test_profile_of_what_only_a_belief_tells_is_the_belief(runs):
    mean, error = 2 * TRUE_LAMBDA, 0.1 * TRUE_LAMBDA
    result = fit(runs, [own("zeta"), shared("lambda", prior=(mean, error))])
    (profile,) = result.profile("lambda").profiles
    value = result.shared[LAMBDA]
    wanted = value.value + 1.645 * value.error * np.array([-1.0, 1.0])
    np.testing.assert_allclose([profile.low, profile.high], wanted, rtol=0, atol=ALIKE * error)
    assert abs(value.value - mean) < PULLED * error


@pytest.mark.parametrize("error", [0.0, -1.0, np.nan])
def test_a_belief_without_an_error_is_refused(error):
    with pytest.raises(InputError, match="its error must be positive"):
        own("zeta", prior=(0.75, error))
