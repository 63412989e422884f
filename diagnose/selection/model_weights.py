"""Weights over effects, pairs of them, none and unknown.

A hypothesis is judged by what it leaves on runs it was not fitted to and on those it was, block by
block, each block with a variance of its own: half its worth times the logarithm of what is left, on
top of a model's own error. Prediction alone would condemn a right effect where the one run that
shows it best is the one left out, as what the others know of its numbers is then far from certain;
the fit alone would reward what bends to every run. `unknown` stands for a model that nobody has
written: it is taken to leave a small share of what the reference model leaves, so that a listed
effect must explain nearly all of a gap to be believed. The numbers in `WeightSettings` were chosen
on 120 sets of our own generator (`drft blind make --seed 7301`, sets 051 to 171), where they gave the
truth most weight: chosen on either half, they served the other half better than those before.
`none` was chosen later, on 138 sets more (seeds 9110 and 9112, up to 078), by how often what has a
weight is right. They are no part of any single case. Of `form` the sets say little between 0.005
and 0.1; a share that pardons a second effect is too large.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.linear.linear_fit import FLOOR, ZETA_SCATTER

NONE, UNKNOWN = "none", "unknown"


@dataclass(frozen=True)
class WeightSettings:
    """What evidence is worth.

    Attributes:
        slow, fast: Worth of a bin of the slow part, and of a sample of the fast part.
        zeta: Worth of a run's log zeta.
        floor: What a model's own error is taken for, over `FLOOR`.
        form: Share of the reference model's residual (in amplitude) that a right effect may leave
            because no rig follows a formula exactly.
        unseen: Share of the evidence that prediction of runs left out has; the fit has the rest.
        number: Cost of each free number.
        reached: Share of the reference model's residual (in amplitude) that `unknown` leaves.
        none, unknown, pair: Logarithms of what is believed before any run, over a single effect.
    """

    slow_worth: float = 0.05
    fast_worth: float = 0.005
    zeta_worth: float = 0.6
    model_error_factor: float = 1.2
    formula_error_share: float = 0.01
    held_out_share: float = 0.5
    parameter_cost: float = 1.5
    unknown_residual_share: float = 0.15
    log_prior_none: float = 0.5
    log_prior_unknown: float = 1.0
    log_prior_pair: float = -4.0


SCALE = WeightSettings()


@dataclass(frozen=True)
class ScoredHypothesis:
    """A hypothesis as far as its weight goes.

    Attributes:
        names: Its effects; none for the reference model.
        left: Mean square left in each block on runs it was not fitted to.
        fitted: The same on the runs it was fitted to.
        scatter: Mean square of log zeta about its mean.
        numbers: How many numbers it has free.
    """

    names: tuple[str, ...]
    held_out_power: np.ndarray
    fitted_power: np.ndarray
    zeta_variance: float
    parameter_count: int


def log_weights(
    judged: Sequence[ScoredHypothesis],
    blocks: Sequence[tuple[str, str]],
    number: np.ndarray,
    noise: np.ndarray,
    runs: int,
    scale: WeightSettings = SCALE,
    chance: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, float]:
    """Logarithms of the weights, not yet summing to one: of each hypothesis, and of unknown.

    Args:
        judged: Hypotheses, the reference model first.
        blocks: Blocks of `left`.
        number: Values in each block.
        noise: Mean square of the instruments' white noise in each block.
        runs: Number of runs.
        scale: What evidence is worth.
        chance: Mean square of what repeats differ by in each block. What of it is beyond noise and
            a model's own error is neither held against a model nor for `unknown` to explain.
    """
    floor = (scale.model_error_factor * np.array([FLOOR[block] for block in blocks])) ** 2
    by_chance = np.maximum(chance - noise - floor, 0)
    beyond = np.maximum(judged[0].held_out_power - noise - floor - by_chance, 0)
    allowed = floor + by_chance + scale.formula_error_share**2 * beyond
    worth = number * np.array([getattr(scale, f"{kind}_worth") for _, kind in blocks])
    zeta = scale.zeta_worth * max(runs - 1, 0)

    def evidence(left: np.ndarray, scatter: float) -> float:
        explained = -0.5 * float((worth * np.log(left + allowed)).sum())
        return explained - 0.5 * zeta * float(np.log(scatter + ZETA_SCATTER**2))

    found = []
    for each in judged:
        before = {0: scale.log_prior_none, 1: 0.0}.get(len(each.names), scale.log_prior_pair)
        predicted, fitted = (
            evidence(left, each.zeta_variance) for left in (each.held_out_power, each.fitted_power)
        )
        told = scale.held_out_share * predicted + (1 - scale.held_out_share) * fitted
        found.append(told - scale.parameter_cost * each.parameter_count + before)
    left = judged[0].held_out_power - (1 - scale.unknown_residual_share**2) * beyond
    unwritten = evidence(left, judged[0].zeta_variance)
    return np.array(found), unwritten + scale.log_prior_unknown - scale.parameter_cost * 3


def weights(
    judged: Sequence[ScoredHypothesis],
    blocks: Sequence[tuple[str, str]],
    number: np.ndarray,
    noise: np.ndarray,
    runs: int,
    scale: WeightSettings = SCALE,
    chance: np.ndarray | float = 0.0,
) -> dict[tuple[str, ...], float]:
    """Weights that sum to one, by the names of the effects; ("none",) and ("unknown",) too."""
    known, unwritten = log_weights(judged, blocks, number, noise, runs, scale, chance)
    logs = np.r_[known, unwritten]
    share = np.exp(logs - logs.max())
    share /= share.sum()
    names = [each.names or (NONE,) for each in judged] + [(UNKNOWN,)]
    return dict(zip(names, share.tolist(), strict=True))


def percent(weight: float) -> str:
    """A weight in words: nothing is certain, nor ruled out."""
    if weight > 0.99:
        return "over 99%"
    return "under 1%" if weight < 0.01 else f"{weight:.0%}"
