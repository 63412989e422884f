"""Strengths far from zero, to which no derivative at the null leads, beside another effect."""

import pytest

from diagnose.dataset import match_initial_zeta
from diagnose.hypotheses.hypothesis import linear_start
from diagnose.hypotheses.large_strengths import at_large_strengths
from diagnose.hypotheses.refinement import refine
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import Regressors
from drftjax.effects.drive import Backlash, SpeedLag
from drftjax.effects.rig import HorizontalViscous
from tests.helpers.rig_datasets import dataset_with

PLAY, DAMPING = 0.22, 60.0
# The wheel starts at 0.5 rad/s: in a step of 2 ms it turns by a thousandth of a radian.
ONE_STEP = 1e-3
# What three short runs tell of a carriage's damping, a per cent or two.
TOLD = 0.03


def test_a_large_play_is_found_beside_a_damper(pool):
    play = {"name": "backlash", "play": PLAY}
    dataset = dataset_with(play, {"name": "horizontal_viscous", "damping": DAMPING})
    linearized = linearize_runs(dataset, match_initial_zeta(dataset, pool), pool)
    effects = Backlash, SpeedLag, HorizontalViscous
    regressors = Regressors.of(dataset, linearized, effects, pool)
    (damper,) = (each for each in regressors.variants if each.effect is HorizontalViscous)
    alone = refine(regressors, linear_start(regressors, [damper]), 3, pool)
    (found,) = at_large_strengths(regressors, alone, pool)
    assert found.names == ("horizontal_viscous", "backlash")
    assert found.score > alone.score
    damping, turned = (
        free.value(coordinate)
        for free, coordinate in zip(found.model.free, found.coordinates, strict=True)
    )
    assert turned == pytest.approx(PLAY, abs=ONE_STEP)
    assert damping == pytest.approx(DAMPING, rel=TOLD)
    # No effect is added to itself.
    assert not at_large_strengths(regressors, found, pool)
