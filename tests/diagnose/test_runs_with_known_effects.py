"""A diagnosis of runs whose set-up holds an effect already."""

import jax.numpy as jnp
import numpy as np

from diagnose.dataset import RigDataset, match_initial_zeta
from diagnose.model.augmented_model import AugmentedModel
from tests.helpers.synthetic_runs import coarse, recorded, setup_of

PROFILE = ([0.0, 0.3, 1.3, 3.0], [0.0, 0.0, 0.5, 0.5])
ZETA = 0.75
# Recorded with 20 um of noise.
LEFT = 30e-6
# And zeta told by them: 20 um of 25 mm a zeta, in a hundred samples and more.
TOLD = 1e-3


def test_what_the_set_up_knows_already_is_no_gap():
    true = setup_of(PROFILE, ZETA)
    true.effects = [
        {"name": "cohesion", "depth": 0.01},
        {"name": "loosening", "loss": 0.2, "decay": 0.5},
        {"name": "measurement_delay", "delay": 0.1},
    ]
    case = RigDataset.of([coarse("run", recorded(true, rate=100.0), model=true)])
    (log_zeta,) = match_initial_zeta(case)
    residual = case.prediction(AugmentedModel(), 0, log_zeta, np.zeros(0)) - case.recording(0)
    path = case.linearized(0, log_zeta)
    assert abs(log_zeta) < TOLD
    assert np.sqrt(np.mean(residual**2)) < LEFT
    assert all(bool(jnp.isfinite(each).all()) for each in (path.motion, path.state_transition))
