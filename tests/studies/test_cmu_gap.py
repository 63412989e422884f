"""Effects on the CMU data's grousered wheel; `docs/results/findings.md` explains the figures."""

import jax.numpy as jnp
import numpy as np
import pytest

from diagnose.model.augmented_model import AugmentedModel
from drftjax.effects.catalogue import effect_class
from tests.studies import cmu_data as data
from tests.studies import cmu_driving as driving
from tests.studies.cmu_gap import Explanation, driven_rows, judged, piled
from tests.studies.cmu_steady import held_sinkage

# 12 wheel angles over a pitch, where `held_sinkage` takes 32 [mm].
ANGLES_MM = 0.05
# Where the descent ends, of sinkages that are made with the same angles [mm].
MADE_MM = 1e-4
# Figures of docs/results/findings.md, to a unit of their last digit [mm].
LAST_DIGIT = 0.01


@pytest.fixture(scope="module")
def rows() -> data.SteadyRows:
    """Rows at slips 0, 0.5 and 0.9, measured nowhere."""
    rim = np.array([0.010, 0.020, 0.100])
    same = np.ones(3)
    nought = np.zeros(3)
    return data.SteadyRows(0.010 * same, rim / data.OUTER_RADIUS, 24.0 * same, nought, nought)


def test_without_effects_the_wheel_runs_at_the_height_that_carries_the_load(rows):
    reading = driving.grousered("24 grousers, tips")
    found = Explanation(AugmentedModel(), reading, rows).sinkage(np.array([np.log(0.7)]))
    held = held_sinkage(reading.simulator, reading.setting(rows), jnp.asarray(0.7))
    assert found == pytest.approx(1e3 * np.asarray(held), abs=ANGLES_MM)


def test_slip_softening_is_found_again_on_sinkages_made_with_it(rows):
    model = AugmentedModel((effect_class("slip_softening"),))
    true = np.array([np.log(0.9), 8.0, np.log(0.05)])
    made = Explanation(model, driving.circle(), rows).sinkage(true) / 1e3
    measured = data.SteadyRows(rows.vx, rows.omega, rows.load, made, rows.forward)
    of = Explanation(model, driving.circle(), measured)
    at = of.fitted(np.ones(3, bool), [np.array([np.log(0.8), 3.0, np.log(0.02)])])
    assert of.sinkage(at) == pytest.approx(1e3 * made, abs=MADE_MM)


def test_slip_softening_predicts_the_grousered_wheels_left_out_slips(shared):
    folder = shared / "measured" / "cmu"
    if not folder.is_dir():
        pytest.skip("there is no folder measured/cmu in ../shared")
    grouser = driven_rows(driving.both_tables(folder)[data.GROUSER])
    none, softer = (judged(names, driving.circle(), grouser) for names in ((), ("slip_softening",)))
    assert driving.rms(none.unseen) == pytest.approx(7.03, abs=LAST_DIGIT)
    assert driving.rms(softer.unseen) == pytest.approx(0.94, abs=LAST_DIGIT)
    assert driving.rms(softer.high) == pytest.approx(1.62, abs=LAST_DIGIT)
    assert driving.rms(none.high) == pytest.approx(11.44, abs=LAST_DIGIT)
    assert piled(softer)[0] == 0.0
