"""Weights of explanations of a change, from fits made by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.change.differences.fit import DifferenceFit
from diagnose.change.differences.settings import DEFAULT_DIFFERENCE_FIT
from diagnose.change.screening import ChangeScreening
from diagnose.change.weights import weigh_change

BLOCKS = (("x", "slow"), ("z", "slow"))
# Two commands, each run once before and once now.
CENTRING = np.kron(np.eye(2), [[0.5, -0.5], [-0.5, 0.5]])
ZETA_PARTS = 0.1  # by which zetas part between before and now [-]; the bed scatters by 0.012
MOVED = np.array([2e-2, 2e-3])  # RMS that this moves x and z by [m]


def fit(left: list[float], variance: float = 0.0) -> DifferenceFit:
    """A fit that leaves this much of x and z [m], with so much scatter of its zetas."""
    bed = DEFAULT_DIFFERENCE_FIT.bed
    score = bed.evidence(variance, round(np.trace(CENTRING)))
    none, numbers = np.zeros(2), np.zeros(0)
    power = MOVED**2 if variance else none
    return DifferenceFit(
        0.0, numbers, none, np.array(left) ** 2, none, score, 0.0, variance, none, power
    )


def explained(name: str, found: DifferenceFit) -> SimpleNamespace:
    return SimpleNamespace(name=name, fit=found, coordinates=np.zeros(1 if name != "none" else 0))


def verdict(none: DifferenceFit, zeta: DifferenceFit, effect: DifferenceFit) -> str:
    differences = SimpleNamespace(centring=CENTRING, chance=np.zeros(2))
    problem = SimpleNamespace(
        settings=DEFAULT_DIFFERENCE_FIT,
        differences=differences,
        regressors=SimpleNamespace(noise_power=np.zeros(2)),
    )
    found = ChangeScreening(
        explained("none", none),
        explained("zeta", zeta),
        (explained("drawbar", effect),),
        BLOCKS,
        np.full(2, 15.0),
    )
    return weigh_change(problem, found).verdict


@pytest.mark.parametrize("left", [[4e-4, 1.5e-4], [6e-4, 3e-4]])
def test_zetas_that_part_are_no_change_that_is_unknown(left):
    # No change leaves as little as a change of zeta, by zetas that part with it. What is left then
    # is not all that there is to explain.
    none, zeta = fit(left, ZETA_PARTS**2), fit(left)
    assert verdict(none, zeta, fit([2e-2, 2e-3])) == "zeta"


def test_what_no_effect_explains_is_unknown():
    none = fit([2e-2, 2e-3])
    assert verdict(none, none, fit([1e-2, 1e-3])) == "unknown"


def test_what_an_effect_explains_is_not():
    none = fit([2e-2, 2e-3])
    assert verdict(none, none, fit([2e-3, 2e-4])) == "drawbar"


def test_nothing_stands_for_no_gap():
    nothing = fit([1e-5, 1e-5])
    assert verdict(nothing, nothing, nothing) == "none"
