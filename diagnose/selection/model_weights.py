r"""Weights of sets of effects, none and unknown: approximate posterior probabilities.

A hypothesis h with k free numbers is scored by the mean squares $s_b$ that it leaves in the blocks
b of the residuals, each with a variance of its own, and by the variance V of log zeta over the
runs. With $N_b$ samples in a block the evidence is

$$E(s, V) = -\tfrac12 \sum_b w_b N_b \ln(s_b + a_b) + \ln p(V),$$

with $w$ the independent statements in a sample, $p(V)$ the evidence of the bed's scatter
(`diagnose.linear.bed`), and $a_b$ the mean square that is not held against a model: its own error
$(c\,\sigma_b)^2$, what repeats differ by beyond noise or finer plates change in x and z, and a
share $\epsilon^2$ of what the reference model leaves beyond all these (likewise of V beyond the
bed's scatter). The log weight is

$$\ln W_h = u\,\max_C \Big(E(s^{C}_h, V^{C}_h) - \sum_{c \in C} d_c\Big)
  + (1 - u)\,E(s^{\mathrm{fitted}}_h, V_h) - \kappa k_h + \ln \pi_h,$$

on runs that h was not fitted to and on those it was. The fit alone would reward what bends to every
run. Prediction alone would condemn a right effect where the one condition that shows it best is
left out, as the others know little of its numbers. So a condition counts by its prediction, or, in
the set C, by the numbers of all runs, at the log probability $d_c$ that it costs the others to take
these (`diagnose.hypotheses.refinement.without_conditions`): little where they hardly know better,
and much where they do. Either way each run has a zeta of its own.

`unknown` is a mechanism outside the catalogue, beside any hypothesis: it is taken to leave a share
$\rho$ (in amplitude) of what the hypothesis leaves beyond noise and $a_b$, with three free numbers.
Alone, it asks of listed effects that they explain nearly all of a gap to be believed. What holds a
free carriage (`diagnose.model.carriage_hold`) it leaves as it is, as no sand and no wheel acts on
that. Beside some effects it is a remainder. It has a part of the set's weight, by what it gains,
and adds nothing to it: an effect that takes a part of what something unknown does is no more
credible for that.

The numbers in `WeightSettings` were chosen on 120 sets of our own generator (`drft blind make
--seed 7301`, sets 051 to 171), where they gave the truth most weight: chosen on either half, they
served the other half better than those before. The prior of `none` was chosen later, on 138 sets
more (seeds 9110 and 9112, up to 078), by how often what has a weight is right. They are no part of
any single dataset, and older than the bed's evidence, than sets of more than two effects and than
$d_c$, for which they have not been chosen again. A level is one number of a run, and counts half as
in the fits, as all else does. Of `formula_error_share` the sets say little between 0.005 and 0.1; a
share that pardons a second effect is too large.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.hypotheses.refinement import HeldOutCondition
from diagnose.linear.bed import zeta_variance
from diagnose.linear.linear_fit import (
    DEFAULT_LINEAR_FIT,
    Block,
    LinearFitSettings,
    worth_by_block,
)
from diagnose.model.carriage_hold import holds_carriage

NONE, UNKNOWN = "none", "unknown"


@dataclass(frozen=True)
class WeightSettings:
    r"""Numbers by which hypotheses are weighed; see the head of this module for their choice.

    Attributes:
        slow_worth: $w_b$, independent statements in a bin of a slow part [-].
        fast_worth: $w_b$, independent statements in a sample of a fast part [-].
        level_worth: $w_b$, independent statements in a level [-].
        model_error_factor: $c$, factor on `LinearFitSettings.model_error` [-].
        formula_error_share: $\epsilon$, share of the reference model's residual (in amplitude) that
            a right effect may leave, because no rig follows a formula exactly [-].
        held_out_share: $u$, share of the evidence that prediction of held-out runs has; the fit has
            the rest [-].
        parameter_cost: $\kappa$, log weight that each free number costs [-].
        unknown_residual_share: $\rho$, share of the reference model's residual (in amplitude) that
            `unknown` leaves [-].
        unknown_parameters: Free numbers that `unknown` is charged for.
        log_prior_none: $\ln \pi$ of the reference model, over a single effect's [-].
        log_prior_unknown: $\ln \pi$ of `unknown`, over a single effect's [-].
        log_prior_further: $\ln \pi$ of each effect beyond the first [-].
        max_remainder_odds: Logarithm of the odds of a remainder beside a set of effects, at most
            [-]: nothing is certain, and the remainder is then so to 95 %.
    """

    slow_worth: float = 0.05
    fast_worth: float = 0.005
    level_worth: float = 0.5
    model_error_factor: float = 1.2
    formula_error_share: float = 0.01
    held_out_share: float = 0.5
    parameter_cost: float = 1.5
    unknown_residual_share: float = 0.15
    unknown_parameters: int = 3
    log_prior_none: float = 0.5
    log_prior_unknown: float = 1.0
    log_prior_further: float = -4.0
    max_remainder_odds: float = 3.0

    def worth(self, blocks: Sequence[Block]) -> np.ndarray:
        """Independent statements in one sample of these blocks [-], shape (blocks,)."""
        return worth_by_block(blocks, self.slow_worth, self.fast_worth, self.level_worth)

    def log_prior(self, effect_count: int) -> float:
        """Logarithm of the prior of a hypothesis of so many effects, over a single effect's [-]."""
        further = self.log_prior_further * (effect_count - 1)
        return further if effect_count else self.log_prior_none


DEFAULT_WEIGHTS = WeightSettings()


@dataclass(frozen=True, eq=False)
class LeftByRun:
    """Residuals of some runs with a hypothesis, by their size.

    Attributes:
        power: What each run adds to the mean square of each block, shape (runs, blocks), in the
            block's unit squared.
        log_zeta: Of each run, over one reference for all [-], shape (runs,).
    """

    power: np.ndarray
    log_zeta: np.ndarray

    @property
    def mean_square(self) -> np.ndarray:
        """Of each block, shape (blocks,)."""
        return self.power.sum(axis=0)

    @property
    def zeta_variance(self) -> float:
        """Variance of log zeta over the runs [-]."""
        return zeta_variance(self.log_zeta)

    def with_runs_of(self, other: "LeftByRun", runs: Sequence[int]) -> "LeftByRun":
        """The same with some runs as another has them."""
        power, log_zeta = self.power.copy(), self.log_zeta.copy()
        power[list(runs)] = other.power[list(runs)]
        log_zeta[list(runs)] = other.log_zeta[list(runs)]
        return LeftByRun(power, log_zeta)


@dataclass(frozen=True, eq=False)
class ScoredHypothesis:
    """The numbers of a hypothesis that its weight depends on.

    Attributes:
        names: Its effects; none for the reference model.
        parameter_count: Number of its free numbers.
        fitted: What it leaves of the runs that it was fitted to.
        held_out: The same with each run's numbers from the other conditions, and its zeta its own;
            as fitted where left out.
        by_all: With the numbers of all runs, each zeta its own as well; as fitted where left out.
        conditions: Those that were held out.
    """

    names: tuple[str, ...]
    parameter_count: int
    fitted: LeftByRun
    held_out: LeftByRun | None = None
    by_all: LeftByRun | None = None
    conditions: Sequence[HeldOutCondition] = ()

    def held_out_evidence(self, evidence: Callable[[LeftByRun], float]) -> float:
        """Log evidence of the runs held out, each condition as it counts for most.

        From the prediction of all conditions on, that one is taken by the numbers of all runs, at
        its cost, which gains most, until none gains.

        Args:
            evidence: Log evidence of what is left of all runs.
        """
        here, by_all = self.held_out or self.fitted, self.by_all or self.fitted
        conditions, paid = list(self.conditions), 0.0
        while conditions:
            others = [here.with_runs_of(by_all, each.runs) for each in conditions]
            gains = [
                evidence(other) - each.cost for other, each in zip(others, conditions, strict=True)
            ]
            best = int(np.argmax(gains))
            if not gains[best] > evidence(here):
                break
            here, paid = others[best], paid + conditions.pop(best).cost
        return evidence(here) - paid


def log_weights(
    scored: Sequence[ScoredHypothesis],
    blocks: Sequence[Block],
    sample_count: np.ndarray,
    noise_power: np.ndarray,
    settings: WeightSettings = DEFAULT_WEIGHTS,
    repeat_power: np.ndarray | float = 0.0,
    linear_fit: LinearFitSettings = DEFAULT_LINEAR_FIT,
) -> tuple[np.ndarray, np.ndarray]:
    """Log weights, up to a common constant, of each hypothesis alone and beside `unknown`.

    The reference model and `unknown` stand for themselves; the weight of a set of effects is
    divided between the set alone and the set with a remainder.

    Args:
        scored: Hypotheses, the reference model first.
        blocks: (channel, kind) of each block.
        sample_count: Values in each block, shape (blocks,).
        noise_power: Mean square of the instruments' white noise in each block, shape (blocks,).
        settings: Numbers of the weights.
        repeat_power: Mean square of what repeats differ by in each block, or finer plates with
            noise. What of it is beyond noise and a model's own error is neither held against a
            model nor for `unknown` to explain.
        linear_fit: For a model's own error and the scatter of zeta.

    Returns:
        Both of shape (hypotheses,).
    """
    floor = (settings.model_error_factor * linear_fit.model_errors(blocks)) ** 2
    by_chance = np.maximum(repeat_power - noise_power - floor, 0)
    bed, free = linear_fit.bed, settings.formula_error_share**2

    def beyond(power: np.ndarray) -> np.ndarray:
        return np.maximum(power - noise_power - floor - by_chance, 0)

    def beyond_scatter(variance: float) -> float:
        return max(variance - bed.scatter**2, 0.0)

    reference = scored[0].fitted
    allowed = floor + by_chance + free * beyond(reference.mean_square)
    pardoned = free * beyond_scatter(reference.zeta_variance)
    worth = sample_count * settings.worth(blocks)
    taken = 1 - settings.unknown_residual_share**2
    open_to_unknown = np.array([not each for each in holds_carriage(blocks)], float)

    def both(each: ScoredHypothesis, explained: float = 0.0) -> float:
        def evidence(runs: LeftByRun) -> float:
            power, variance = runs.mean_square, runs.zeta_variance
            left = power - explained * open_to_unknown * beyond(power)
            scatter = variance - explained * beyond_scatter(variance)
            of_samples = -0.5 * float((worth * np.log(left + allowed)).sum())
            return of_samples + bed.evidence(scatter, len(runs.log_zeta) - 1, pardoned)

        u, cost = settings.held_out_share, settings.parameter_cost * each.parameter_count
        return u * each.held_out_evidence(evidence) + (1 - u) * evidence(each.fitted) - cost

    count = [len(each.names) for each in scored]
    alone = [both(each) + settings.log_prior(k) for each, k in zip(scored, count, strict=True)]
    own = settings.log_prior_unknown - settings.parameter_cost * settings.unknown_parameters
    unknown = both(scored[0], taken) + own
    odds = [
        min(both(each, taken) + own + settings.log_prior(k) - of, settings.max_remainder_odds)
        for each, k, of in zip(scored[1:], count[1:], alone[1:], strict=True)
    ]
    beside = [unknown, *(of - np.logaddexp(0, -g) for g, of in zip(odds, alone[1:], strict=True))]
    alone[1:] = [of - np.logaddexp(0, g) for g, of in zip(odds, alone[1:], strict=True)]
    return np.array(alone), np.array(beside)


def weights(
    scored: Sequence[ScoredHypothesis],
    blocks: Sequence[Block],
    sample_count: np.ndarray,
    noise_power: np.ndarray,
    settings: WeightSettings = DEFAULT_WEIGHTS,
    repeat_power: np.ndarray | float = 0.0,
    linear_fit: LinearFitSettings = DEFAULT_LINEAR_FIT,
) -> dict[tuple[str, ...], float]:
    """Weights that sum to one, by the names of the effects.

    ("none",) and ("unknown",) stand without an effect; a set with a remainder ends in "unknown".

    Arguments as for `log_weights`.
    """
    alone, beside = log_weights(
        scored, blocks, sample_count, noise_power, settings, repeat_power, linear_fit
    )
    logs = np.r_[alone, beside]
    share = np.exp(logs - logs.max())
    share /= share.sum()
    names = [each.names or (NONE,) for each in scored]
    names += [(*each.names, UNKNOWN) for each in scored]
    return dict(zip(names, share.tolist(), strict=True))


def percent(weight: float) -> str:
    """A weight in words, between "under 1%" and "over 99%": nothing is certain, nor ruled out."""
    if weight > 0.99:
        return "over 99%"
    return "under 1%" if weight < 0.01 else f"{weight:.0%}"
