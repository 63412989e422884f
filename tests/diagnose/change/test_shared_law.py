"""The base of a comparison, where the reference model is far from the runs."""

import numpy as np
import pytest

from diagnose.api import gather_inputs
from diagnose.change.shared_law import follow_shared_law
from diagnose.dataset import RigDataset, match_initial_zeta
from diagnose.model.augmented_model import REFERENCE
from diagnose.run_pool import RunPool
from drftjax.runlog.record import RunLog
from drftjax.setups.setup import WheelSetUp
from tests.helpers.synthetic_runs import recorded, setup_of

# A small wheel that all but stays where it is behind its heap; seconds and rad/s.
PROFILES = (
    ([0.0, 0.3, 1.3, 4.0], [0.0, 0.0, 1.2, 1.2]),
    ([0.0, 0.3, 1.3, 3.0], [0.0, 0.0, 2.0, 2.0]),
)
EXCESS, RESISTANCE = 0.3, 9.0
# Share of x's RMS that the base may miss: rounds end at a small step of its numbers, not at none,
# and the readings have 0.05 % of noise. The reference model misses more than all of it.
LEFT = 0.01
# The exponent, and the heap's force as a share: the exponent of depth and zeta part the sinkage's
# course between them, and the heap's lift is free, too.
NUMBERS = 0.05


@pytest.fixture(scope="module")
def runs() -> dict[str, RunLog]:
    found = {}
    for number, profile in enumerate(PROFILES):
        setup = setup_of(profile, 1.2)
        # With the plates with which its run log is simulated again.
        setup.wheel = WheelSetUp(
            radius=0.062, width=0.0676, grouser_height=0.003, grouser_thickness=0.003
        )
        setup.rig.mass_x = setup.rig.mass_z = 3.1
        setup.effects = [
            {"name": "depth_power", "excess": EXCESS},
            {"name": "heap", "resistance": RESISTANCE},
        ]
        found[f"run_{number}"] = recorded(setup, seed=number, rate=50.0)
    return found


def missed(dataset: RigDataset, pool: RunPool) -> float:
    """RMS of x's residual over that of x, of the worst run."""
    log_zeta, x = match_initial_zeta(dataset, pool), dataset.channels.index("x")
    found = []
    for run in dataset.run_numbers:
        read = dataset.recording(run)[x]
        left = dataset.prediction(REFERENCE, run, log_zeta[run], np.zeros(0))[x] - read
        found.append(np.sqrt(np.mean(left**2) / np.mean(read**2)))
    return max(found)


def test_a_base_far_from_the_runs_is_fitted_until_it_follows_them(runs):
    prepared = gather_inputs(runs).runs
    dataset = RigDataset.of(prepared)
    with RunPool() as pool:
        assert missed(dataset, pool) > 1.0
        base, (depth, heap) = follow_shared_law(dataset, range(len(prepared)), pool)
        assert missed(base, pool) < LEFT
    assert float(depth.excess) == pytest.approx(EXCESS, abs=NUMBERS)
    assert float(heap.resistance) == pytest.approx(RESISTANCE, rel=NUMBERS)
