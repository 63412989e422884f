"""Which sets of effects are simulated first."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from diagnose.hypotheses.set_candidates import SetCandidate, _by_what_each_does_alone
from diagnose.linear.linear_fit import DEFAULT_LINEAR_FIT, log_score

BLOCKS, COUNT, RUNS = (("z", "slow"),), np.array([600.0]), 9


def single(name: str, z: float, zeta_variance: float) -> Any:
    """An effect alone: the height it leaves [m] and the variance of log zeta over the runs."""
    fit = SimpleNamespace(mean_square=np.array([z**2]), zeta_variance=zeta_variance)
    score = log_score(BLOCKS, COUNT, fit.mean_square, zeta_variance, RUNS)
    return SimpleNamespace(names=(name,), fit=fit, score=score)


def test_effects_that_explain_different_things_lead_one_ranking_and_good_ones_the_other():
    """As on a bench where the wheel creeps and sand softens with slip: only zetas tell the last."""
    drag, friction = single("drag", 1.0e-4, 0.13), single("friction", 1.1e-4, 0.13)
    softening = single("softening", 3.5e-4, 0.001)
    singles = [drag, friction, softening]
    assert friction.score > softening.score

    def candidate(other: Any) -> SetCandidate:
        names = frozenset((*drag.names, *other.names))
        return SetCandidate(names, False, 0.0, drag, lambda: drag)

    matrices = SimpleNamespace(blocks=BLOCKS, sample_count=COUNT[None])
    runs = SimpleNamespace(
        gram_matrices=matrices, log_zeta=np.zeros(RUNS), settings=DEFAULT_LINEAR_FIT
    )
    regressors: Any = runs
    refined = [[[candidate(softening), candidate(friction)]]]
    by_score, by_part = _by_what_each_does_alone(regressors, refined, singles)
    assert by_score[0].names == {"drag", "friction"}
    assert by_part[0].names == {"drag", "softening"}
