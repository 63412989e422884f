r"""Fit of effects to differences, with each run's own zeta.

With $x = (\theta, \zeta_1 \ldots \zeta_R, 1)$ the sum of squares of block b is $x^T G_b x$
(`diagnose.change.differences.gram`), and $s_b$ that by $N_b$, its degrees of freedom. The log score
is

$$-\tfrac12 \sum_b w_b N_b \ln(s_b + e_b + \sigma_b^2) + \ln p(V_\zeta),$$

with $w_b$ the independent statements in a value, $e_b$ the part of the response that may be wrong
and $\sigma_b^2$ the mean square below which nothing is asked of a model. The last term is the
evidence of the log zetas by the scatter of the bed (`diagnose.linear.bed`). $\zeta_i$ counts from a
value that the condition's runs share, so the contrasts are the runs less the conditions. That value
has a Gaussian prior, about the zetas with which the runs were matched that have no effect: the
differences say next to nothing of it. The fit maximises the score, with Gaussian priors on
$\theta$, by iteratively reweighted least squares.

How far a change moves x for a millimetre of z is a matter of the sand's law, which is not the
model's. So all that a model changes, by $\theta$ or by zeta, is in each channel c but z times a
factor $1 + \phi_c$, the same in all runs, with a Gaussian prior on $\phi_c$ that belongs to the
score.

What an effect changes and what another zeta makes up for take a run nowhere together. So $e_b$ is a
share of the response to both: of an effect that zeta all but makes up for, such as the shadow of
grousers, a share of its own response would drown the little that tells it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.change.differences.gram import DifferenceGram
from diagnose.change.differences.settings import DEFAULT_DIFFERENCE_FIT, DifferenceFitSettings


@dataclass(frozen=True, eq=False)
class CoefficientPrior:
    """Gaussian prior and bounds of the coefficients, from where they are.

    Attributes:
        width: Width of each, shape (columns,).
        offset: Value of each over its prior's centre, shape (columns,).
        least, most: Bounds of each change, shape (columns,).
    """

    width: np.ndarray
    offset: np.ndarray
    least: np.ndarray
    most: np.ndarray

    @classmethod
    def free(cls, width: np.ndarray) -> "CoefficientPrior":
        """About where they are, without bounds."""
        return cls(width, 0 * width, 0 * width - np.inf, 0 * width + np.inf)


@dataclass(frozen=True, eq=False)
class DifferenceFit:
    r"""Coefficients, log zetas, and what they leave.

    Attributes:
        score: Log score.
        coefficients: Changes of the coefficients, shape (columns,).
        zeta_change: Change of each run's log zeta [-], shape (runs,).
        mean_square: $s_b$, shape (blocks,), in the blocks' units squared.
        response_error: $e_b$, likewise.
        zeta_score: The part of the score that zeta's scatter and the factors have.
        scatter: Scatter of log zeta between runs, as the fit finds it with the bed's own [-].
        zeta_variance: Mean square of log zeta's contrasts between runs [-].
        law_factors: $\phi_c$ in each block [-], shape (blocks,).
        power: Mean square of all that the model changes, without these, shape (blocks,).
    """

    score: float
    coefficients: np.ndarray
    zeta_change: np.ndarray
    mean_square: np.ndarray
    response_error: np.ndarray
    zeta_score: float
    scatter: float
    zeta_variance: float
    law_factors: np.ndarray
    power: np.ndarray


def fit_differences(
    matrices: DifferenceGram,
    columns: Sequence[int],
    deviation: np.ndarray,
    centring: np.ndarray,
    prior: CoefficientPrior,
    error_share: float,
    settings: DifferenceFitSettings = DEFAULT_DIFFERENCE_FIT,
    changed: int | None = None,
    inflation: float = 1.0,
) -> DifferenceFit:
    """Maximise the log score over some columns' coefficients and each run's log zeta.

    Args:
        matrices: Gram matrices.
        columns: Numbers of the columns that act.
        deviation: Log zeta of each run over what is known of its condition's, before the fit [-],
            shape (runs,).
        centring: Takes the mean over each run's condition off, shape (runs, runs).
        prior: Of the coefficients.
        error_share: Share of the response to columns and zetas that may be wrong [-]; none where no
            column acts.
        settings: Numbers of the fit.
        changed: Number of the column that holds what the model has changed so far; where there is
            none, that is the response to `deviation`.
        inflation: Factor on every block's model error [-].
    """
    runs, width = len(deviation), len(columns)
    known = () if changed is None else (changed,)
    gram = matrices.of_columns([*columns, *known], runs)
    held = np.r_[np.zeros(width), np.ones(len(known)), np.zeros(runs)]
    if changed is None:
        held[width:] = centring @ deviation
    law = _Law(matrices, gram, held, settings)
    solved = np.delete(np.arange(len(held) + 1), [*range(width, width + len(known))])
    worth = matrices.worth(settings)
    floor = inflation**2 * matrices.floor(settings)
    mean_square = matrices.mean_square(gram, np.r_[0 * held, 1.0])
    response_error = np.zeros(len(mean_square))
    own, factors, change = deviation, np.zeros(len(mean_square)), np.zeros(len(held))
    for _ in range(settings.iterations):
        weight = worth / np.maximum(matrices.count, 1) / (mean_square + response_error + floor)
        normal = np.einsum("b,bij->ij", weight, gram)[np.ix_(solved, solved)]
        change[solved[:-1]] = _solve(normal, _hold(own, centring, settings), deviation, prior)
        own = deviation + change[-runs:]
        factors = law.factors(weight, change)
        gram = law.with_factors(factors)
        mean_square = matrices.mean_square(gram, np.r_[change, 1.0])
        response = np.r_[change, 0.0] if width else np.zeros(len(held) + 1)
        response_error = error_share**2 * matrices.mean_square(gram, response)
    return _scored(
        matrices, change[:width], change[-runs:], own, centring, mean_square, response_error,
        factors, law.power(change), settings,
    )  # fmt: skip


def score_differences(
    matrices: DifferenceGram,
    deviation: np.ndarray,
    centring: np.ndarray,
    settings: DifferenceFitSettings = DEFAULT_DIFFERENCE_FIT,
) -> DifferenceFit:
    """Score of residuals as they are: a fit that changes the factors of the law alone.

    Args:
        matrices: Gram matrices, of one column: what the model has changed so far.
        deviation, centring: As for `fit_differences`.
        settings: Numbers of the score.
    """
    nothing, still = np.zeros(len(matrices.blocks)), np.zeros(1 + len(deviation))
    gram = matrices.of_columns((0,), len(deviation))
    law = _Law(matrices, gram, np.r_[1.0, np.zeros(len(deviation))], settings)
    worth, factors = matrices.worth(settings) / np.maximum(matrices.count, 1), nothing
    for _ in range(settings.iterations):
        left = matrices.mean_square(gram, np.r_[still, 1.0])
        factors = law.factors(worth / (left + matrices.floor(settings)), still)
        gram = law.with_factors(factors)
    mean_square = matrices.mean_square(gram, np.r_[still, 1.0])
    return _scored(
        matrices, np.zeros(0), still[1:], deviation, centring, mean_square, nothing, factors,
        law.power(still), settings,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Law:
    """Gram matrices of a model's changes, each channel's but those of z with a factor of its own.

    Attributes:
        matrices: Of the runs.
        gram: Of (columns..., log zeta of each run, residual), shape (blocks, n, n).
        held: What the residual has of the columns and log zetas already, shape (n - 1,).
        settings: For the prior on the factors.
    """

    matrices: DifferenceGram
    gram: np.ndarray
    held: np.ndarray
    settings: DifferenceFitSettings

    def factors(self, weight: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Likeliest factors, less one [-], shape (blocks,); zero for z, which the others follow.

        Args:
            weight: Of each block's sum of squares.
            change: Of the columns and log zetas, shape (n - 1,).
        """
        whole = np.r_[self.held + change, 0.0]
        response = self.gram @ whole
        square, product = response @ whole, response @ np.r_[change, 1.0]
        found = np.zeros(len(self.matrices.blocks))
        for channel in self.matrices.by_law:
            at = np.array([each == channel for each, _ in self.matrices.blocks])
            known = weight[at] @ square[at] + self.settings.law_factor_prior**-2
            found[at] = -(weight[at] @ product[at]) / known
        return found

    def power(self, change: np.ndarray) -> np.ndarray:
        """Mean square of all that the model changes, without the factors, shape (blocks,)."""
        return self.matrices.mean_square(self.gram, np.r_[self.held + change, 0.0])

    def with_factors(self, factors: np.ndarray) -> np.ndarray:
        """Gram matrices with these factors, by block, less one [-], shape (blocks,)."""
        size = self.gram.shape[-1]
        turn = np.zeros((len(factors), size, size)) + np.eye(size)
        every = np.arange(size - 1)
        turn[:, every, every] += factors[:, None]
        turn[:, :-1, -1] = factors[:, None] * self.held
        return np.swapaxes(turn, 1, 2) @ self.gram @ turn


def _scored(
    matrices: DifferenceGram,
    coefficients: np.ndarray,
    zeta_change: np.ndarray,
    own: np.ndarray,
    centring: np.ndarray,
    mean_square: np.ndarray,
    response_error: np.ndarray,
    factors: np.ndarray,
    power: np.ndarray,
    settings: DifferenceFitSettings,
) -> DifferenceFit:
    """A fit with its score."""
    worth = matrices.worth(settings)
    floor = matrices.floor(settings)
    contrasts = contrasts_of(centring)
    variance = float(own @ centring @ own) / max(contrasts, 1)
    level = float(own @ (own - centring @ own)) / settings.level_width**2
    by_channel = dict(zip((channel for channel, _ in matrices.blocks), factors, strict=True))
    of_factors = sum((each / settings.law_factor_prior) ** 2 for each in by_channel.values())
    zeta_score = settings.bed.evidence(variance, contrasts) - 0.5 * (float(of_factors) + level)
    evidence = -0.5 * float((worth * np.log(mean_square + response_error + floor)).sum())
    return DifferenceFit(
        evidence + zeta_score,
        coefficients,
        zeta_change,
        mean_square,
        response_error,
        zeta_score,
        float(settings.bed.hold(variance, contrasts) ** -0.5),
        variance,
        factors,
        power,
    )


def contrasts_of(centring: np.ndarray) -> int:
    """Independent differences of log zeta: runs less conditions."""
    return round(float(np.trace(centring)))


def _hold(own: np.ndarray, centring: np.ndarray, settings: DifferenceFitSettings) -> np.ndarray:
    """Precision of log zetas: about their condition's, and of that about what is known."""
    contrasts = contrasts_of(centring)
    hold = settings.bed.hold(float(own @ centring @ own) / max(contrasts, 1), contrasts)
    return hold * centring + _level_hold(centring, settings)


def _level_hold(centring: np.ndarray, settings: DifferenceFitSettings) -> np.ndarray:
    return (np.eye(len(centring)) - centring) / settings.level_width**2


def information(
    matrices: DifferenceGram,
    fit: DifferenceFit,
    centring: np.ndarray,
    prior: CoefficientPrior,
    worth: np.ndarray,
    settings: DifferenceFitSettings = DEFAULT_DIFFERENCE_FIT,
) -> np.ndarray:
    """Precision of (coefficients, log zetas), all columns acting, shape (n, n).

    Args:
        matrices: Gram matrices about the fit.
        fit: What is left there.
        centring: As for `fit_differences`.
        prior: Of the coefficients.
        worth: Independent statements in one value of each block [-], shape (blocks,).
        settings: For the model errors.
    """
    weight = worth / (fit.mean_square + matrices.floor(settings))
    found = np.einsum("b,bij->ij", weight, matrices.gram[:, :-1, :-1])
    width = len(prior.width)
    found[np.arange(width), np.arange(width)] += 1 / prior.width**2
    found[width:, width:] += centring / fit.scatter**2 + _level_hold(centring, settings)
    return found


def _solve(
    normal: np.ndarray, hold: np.ndarray, deviation: np.ndarray, prior: CoefficientPrior
) -> np.ndarray:
    """Changes of coefficients and log zetas for these weights, within bounds.

    Args:
        normal: Weighted Gram matrix.
        hold: Precision of the log zetas.
        deviation: As for `fit_differences`.
        prior: Of the coefficients.
    """
    width = len(prior.width)
    matrix, right = normal[:-1, :-1].copy(), -normal[:-1, -1].copy()
    matrix[np.arange(width), np.arange(width)] += 1 / prior.width**2
    matrix[width:, width:] += hold
    right -= np.r_[prior.offset / prior.width**2, hold @ deviation]
    size = np.sqrt(np.diag(matrix))
    # A slight ridge keeps columns apart that all but coincide.
    scaled = matrix / np.outer(size, size) + 1e-10 * np.eye(len(right))
    found = np.linalg.solve(scaled, right / size) / size
    held, least, most = np.zeros(len(right), bool), prior.least, prior.most
    # Coefficients past a bound stay at it, and the others are solved for again, by which others
    # may come past theirs.
    while (past := (found[:width] < least) | (found[:width] > most)).any():
        held[:width] |= past
        found[:width] = np.clip(found[:width], least, most)
        rest = (right - matrix[:, held] @ found[held])[~held]
        inner = scaled[np.ix_(~held, ~held)]
        found[~held] = np.linalg.solve(inner, rest / size[~held]) / size[~held]
    return found
