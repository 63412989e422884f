r"""Weights of explanations of a change, and the verdict that they lead to.

The log weight of an explanation h with $k_h$ numbers is

$$\ln W_h = -\tfrac12 \sum_b w_b N_b \ln(s_{hb} + a_b) + Z_h - \kappa k_h + \ln \pi_h,$$

with the mean square $s_{hb}$ that it leaves of the differences (with what its response may be wrong
by), the score $Z_h$ of its log zetas (`diagnose.change.differences.fit`), and $a_b$ that is not
held against it: a model's own error, what repeats on one side differ by, and a share $\epsilon^2$
of what no change leaves beyond noise, as no sand follows the law that the responses are simulated
with; and the same share of what the runs' zetas do where nothing changed, for the same reason.
`unknown` is taken to leave a share $\rho$ (in amplitude) of the difference: of what no change
leaves beyond noise, and of what its zetas make up for by scattering more than the bed.
"""

import math
from dataclasses import dataclass

import numpy as np

from diagnose.change.differences.fit import DifferenceFit, contrasts_of
from diagnose.change.hypothesis import ZETA, ChangeHypothesis, ChangeProblem
from diagnose.change.screening import ChangeScreening
from diagnose.selection.model_weights import NONE, UNKNOWN
from diagnose.selection.verdict import named_together


@dataclass(frozen=True)
class ChangeWeightSettings:
    r"""Numbers by which explanations are weighed, and named.

    Attributes:
        law_error_share: $\epsilon$, share of the difference (in amplitude) that a right effect may
            leave, as its response is that of another sand's law [-].
        unknown_residual_share: $\rho$, share of the difference (in amplitude) that `unknown` leaves
            [-]: an effect must explain nine tenths of its square to be believed.
        parameter_cost: $\kappa$, log weight that each number costs [-].
        unknown_parameters: Numbers that `unknown` is charged for.
        log_prior_zeta: $\ln \pi$ of a change of zeta over that of no change [-]: sand changes
            with weather and preparation, about one time in four.
        log_prior_effects: That of all effects together, in equal shares: as likely as no change.
        log_prior_unknown: That of `unknown`.
        alarm_ratio: A change is named where it outweighs no change by this factor [-]. It holds
            false alarms down to one in twenty.
        group_weight: Names are given together until this share of the changes' weight is named [-].
        min_named_weight: One of less weight than this is not named beside another [-].
    """

    law_error_share: float = 0.07
    unknown_residual_share: float = 0.3
    parameter_cost: float = 1.5
    unknown_parameters: int = 3
    log_prior_zeta: float = -1.2
    log_prior_effects: float = 0.0
    log_prior_unknown: float = -1.6
    alarm_ratio: float = 5.0
    group_weight: float = 0.95
    min_named_weight: float = 0.05


DEFAULT_CHANGE_WEIGHTS = ChangeWeightSettings()


@dataclass(frozen=True, eq=False)
class WeighedChange:
    """Weights of all explanations, and the verdict.

    Attributes:
        weights: By name, heaviest first; they sum to one.
        verdict: The name that stands.
        group: Names that cannot be told from it, that one first.
        chosen: The explanation behind it; of `unknown`, the likeliest that is known.
    """

    weights: dict[str, float]
    verdict: str
    group: tuple[str, ...]
    chosen: ChangeHypothesis


def weigh_change(
    problem: ChangeProblem,
    found: ChangeScreening,
    settings: ChangeWeightSettings = DEFAULT_CHANGE_WEIGHTS,
) -> WeighedChange:
    """Weigh all explanations, and choose the verdict.

    Args:
        problem: The runs.
        found: Explanations, screened.
        settings: Numbers of the weights.
    """
    logs = _log_weights(problem, found, settings)
    shares = np.exp(logs - logs.max())
    shares /= shares.sum()
    names = [*(each.name for each in found.all), UNKNOWN]
    weights: dict[str, float] = {}
    for name, share in zip(names, shares.tolist(), strict=True):
        weights[name] = weights.get(name, 0.0) + share
    weights = dict(sorted(weights.items(), key=lambda each: -each[1]))
    verdict, group = _decide(weights, settings)
    known = [each for each in found.all if each.name == verdict]
    if not known:
        known = [each for each in found.all if each.name != NONE]
    shares_of = dict(zip(map(id, found.all), shares, strict=False))
    return WeighedChange(weights, verdict, group, max(known, key=lambda each: shares_of[id(each)]))


def _log_weights(
    problem: ChangeProblem, found: ChangeScreening, settings: ChangeWeightSettings
) -> np.ndarray:
    """Log weight of every explanation, and of unknown last."""
    fits = problem.settings
    floor = fits.model_errors(found.blocks) ** 2 + problem.differences.chance
    none = found.none.fit
    beyond = np.maximum(none.mean_square - problem.regressors.noise_power - floor, 0)
    allowed = floor + settings.law_error_share**2 * (beyond + none.power)

    def evidence(power: np.ndarray) -> float:
        return -0.5 * float((found.worth * np.log(power + allowed)).sum())

    per_effect = settings.log_prior_effects - math.log(max(len(found.effects), 1))
    prior = {NONE: 0.0, ZETA: settings.log_prior_zeta}
    logs = [
        evidence(each.fit.mean_square + each.fit.response_error)
        + each.fit.zeta_score
        - settings.parameter_cost * len(each.coordinates)
        + prior.get(each.name, per_effect)
        for each in found.all
    ]
    cost = settings.parameter_cost * settings.unknown_parameters
    left, zeta_score = _left_by_unknown(problem, none, beyond, settings)
    unknown = evidence(left) + zeta_score - cost + settings.log_prior_unknown
    return np.array([*logs, unknown])


def _left_by_unknown(
    problem: ChangeProblem,
    none: DifferenceFit,
    beyond: np.ndarray,
    settings: ChangeWeightSettings,
) -> tuple[np.ndarray, float]:
    """Mean squares that `unknown` leaves, shape (blocks,), and the score of its log zetas.

    Zetas that part by more than the bed's scatter are a part of what it is to explain.

    Args:
        problem: The runs.
        none: No change.
        beyond: What that leaves beyond noise, shape (blocks,).
        settings: For the share that is left.
    """
    bed, contrasts = problem.settings.bed, contrasts_of(problem.differences.centring)
    usual = min(none.zeta_variance, bed.scatter**2)
    strayed = 1.0 - usual / none.zeta_variance if none.zeta_variance > 0 else 0.0
    difference = beyond + strayed * none.power
    left = none.mean_square - beyond + settings.unknown_residual_share**2 * difference
    gained = bed.evidence(usual, contrasts) - bed.evidence(none.zeta_variance, contrasts)
    return left, none.zeta_score + gained


def _decide(
    weights: dict[str, float], settings: ChangeWeightSettings
) -> tuple[str, tuple[str, ...]]:
    """The verdict, and the names that cannot be told from it."""
    none, unknown = weights.get(NONE, 0.0), weights.get(UNKNOWN, 0.0)
    changes = [(name, w) for name, w in weights.items() if name not in (NONE, UNKNOWN)]
    total = sum(weight for _, weight in changes)
    if total + unknown < settings.alarm_ratio * none:
        return NONE, (NONE,)
    if unknown > total or not changes:
        return UNKNOWN, (UNKNOWN,)
    enough, least = settings.group_weight * total, settings.min_named_weight * total
    return changes[0][0], tuple(named_together(changes, enough, least))
