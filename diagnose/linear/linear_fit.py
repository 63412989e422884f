r"""Fits of effects on linear responses, from Gram matrices, and the score of what they leave.

Residuals are divided into blocks b, a channel's slow and fast part and the level of x and z
(`diagnose.linear.residual_blocks`), each with a variance of its own. A linear fit changes the
residual of run r by its own log zeta $\zeta_r$ and by the coefficients $\theta$ that all runs
share; with $x_r = (\zeta_r, \theta, 1)$ the sum of squares that it leaves is $x_r^T G_{rb} x_r$,
with the Gram matrix $G_{rb} = X_{rb}^T X_{rb}$ of the columns $X_{rb}$ = (response to own log zeta,
responses to coefficients, residual). Once these matrices are known every fit costs a few numbers.

With $N_b$ samples in block b the mean square left is $s_b = \sum_r x_r^T G_{rb} x_r / N_b$, and the
log score (profile log-likelihood, up to a constant)

$$-\tfrac12 \sum_b w_b N_b \ln(s_b + e_b + \sigma_b^2)
  + \ln p(V_\zeta),$$

where $\sigma_b$ is a model's own error, $e_b$ the part of the response that its linearity may be
wrong by, $w$ the independent statements in a sample, and $p(V_\zeta)$ the evidence of the variance
of log zeta over the runs (`diagnose.linear.bed`). The fit maximises it, with a Gaussian prior on
$\theta$, by iteratively reweighted least squares: each iteration weighs block b by
$w_b / (s_b + e_b + \sigma_b^2)$ of the one before.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from diagnose.linear.bed import DEFAULT_BED, AbstractBed
from diagnose.linear.residual_blocks import PLACE_ERROR, kinds_of
from diagnose.model.carriage_hold import holds_carriage

Block = tuple[str, str]


def worth_by_block(blocks: Sequence[Block], slow: float, fast: float, level: float) -> np.ndarray:
    """Independent statements in one value of each block [-], shape (blocks,).

    Args:
        blocks: (channel, kind) of each block.
        slow, fast, level: Statements in a bin of a slow part, in a sample of a fast part and in a
            level [-]. What holds a free carriage (`diagnose.model.carriage_hold`) is averaged over
            a bin, so that each says one thing: no formula of the sand is wrong there in the next
            bin, too.
    """
    plain = {"slow": slow, "fast": fast, "level": level}
    held = {"slow": 1.0, "fast": 0.0}
    holds = holds_carriage(blocks)
    return np.array(
        [(held if hold else plain)[kind] for (_, kind), hold in zip(blocks, holds, strict=True)]
    )


def _default_model_error() -> Mapping[Block, float]:
    return MappingProxyType(
        {
            ("z", "slow"): 20e-6,
            ("z", "fast"): 10e-6,
            ("z", "level"): 6e-6,
            ("x", "slow"): 20e-6,
            ("x", "fast"): 20e-6,
            ("x", "level"): PLACE_ERROR,
            ("fx", "slow"): 0.3,
            ("fx", "fast"): 0.5,
            ("fz", "slow"): 0.3,
            ("fz", "fast"): 0.5,
            ("torque", "slow"): 0.03,
            ("torque", "fast"): 0.05,
        }
    )


@dataclass(frozen=True)
class LinearFitSettings:
    """Numbers by which residuals are weighed and effects fitted on linear responses.

    Attributes:
        model_error: A model's own error in each block, by (channel, kind), that no fit is asked to
            fall below [m, N, N m].
        slow_worth: Independent statements in one bin of a slow part [-].
        fast_worth: Independent statements in one sample of a fast part [-].
        level_worth: Independent statements in one level [-].
        bed: Scatter of zeta between the runs.
        strength_prior: Width of the prior on a strength [typical sizes].
        shape_prior: Least width of the prior on a shape's logarithm [-]; half the range of the
            shape's grid where that is wider.
        linear_error: Share of an effect's response that may be wrong for being linear [-].
        corrected_error: The same where a simulation has corrected the responses [-].
        max_log_step: Longest step of a logarithm (of zeta, of a shape) for which a linear response
            is trusted [-].
        iterations: Reweightings of a fit.
    """

    model_error: Mapping[Block, float] = field(default_factory=_default_model_error)
    slow_worth: float = 0.1
    fast_worth: float = 0.01
    level_worth: float = 1.0
    bed: AbstractBed = DEFAULT_BED
    strength_prior: float = 5.0
    shape_prior: float = 1.0
    linear_error: float = 0.1
    corrected_error: float = 0.05
    max_log_step: float = 0.5
    iterations: int = 8

    def model_errors(self, blocks: Sequence[Block]) -> np.ndarray:
        """A model's own error in these blocks [m, N, N m], shape (blocks,)."""
        return np.array([self.model_error[block] for block in blocks])

    def worth(self, blocks: Sequence[Block]) -> np.ndarray:
        """Independent statements in one sample of these blocks [-], shape (blocks,)."""
        return worth_by_block(blocks, self.slow_worth, self.fast_worth, self.level_worth)


DEFAULT_LINEAR_FIT = LinearFitSettings()

# For a comparison: what both sides share, their level too, is not asked there.
WITHOUT_LEVELS = LinearFitSettings(level_worth=0.0)


@dataclass(frozen=True)
class GramMatrices:
    """Products of columns with each other, by run and block.

    Attributes:
        blocks: (channel, kind) of each block.
        gram: Gram matrices of (own log zeta, columns..., residual), shape (runs, blocks, 2 +
            columns, 2 + columns), in the blocks' units squared.
        sample_count: Samples in each, shape (runs, blocks).
        log_zeta: Log zeta of each run over one reference for all [-], where its columns begin,
            shape (runs,).
    """

    blocks: tuple[Block, ...]
    gram: np.ndarray
    sample_count: np.ndarray
    log_zeta: np.ndarray

    def of_runs(self, runs: np.ndarray) -> "GramMatrices":
        """Those of some runs, by number."""
        return GramMatrices(
            self.blocks, self.gram[runs], self.sample_count[runs], self.log_zeta[runs]
        )

    def weighed(self, settings: "LinearFitSettings") -> np.ndarray:
        """Sum over the blocks, each in its model errors and by its worth.

        Args:
            settings: Worth and model error of each block.

        Returns:
            Shape (runs, 2 + columns, 2 + columns).
        """
        weight = settings.worth(self.blocks) / settings.model_errors(self.blocks) ** 2
        return np.einsum("b,rbij->rij", weight, self.gram)


@dataclass(frozen=True)
class LinearFit:
    """Result of a fit on linear responses, or of a simulation in its place.

    Attributes:
        score: Log score.
        coefficients: Of the columns used, in units of their coordinates, shape (columns,).
        log_zeta_change: Change of each run's log zeta [-], shape (runs,).
        mean_square: Mean square of what is left in each block, shape (blocks,), in its unit
            squared.
        zeta_variance: Variance of log zeta over the runs [-].
    """

    score: float
    coefficients: np.ndarray
    log_zeta_change: np.ndarray
    mean_square: np.ndarray
    zeta_variance: float


def fit_linear(
    matrices: GramMatrices,
    columns: Sequence[int],
    prior: np.ndarray | None = None,
    offset: np.ndarray | None = None,
    lower: np.ndarray | None = None,
    linear_error: float | None = None,
    inflation: float = 1.0,
    settings: LinearFitSettings = DEFAULT_LINEAR_FIT,
) -> LinearFit:
    """Maximise the log score over the coefficients of some columns and each run's log zeta.

    Args:
        matrices: Gram matrices of the runs.
        columns: Numbers of the columns that act.
        prior: Width of the Gaussian prior on each coefficient, shape (columns,); none where left
            out.
        offset: Value that each coefficient counts from, over the centre of its prior; zero where
            left out.
        lower: Lower bound of each coefficient; none where left out.
        linear_error: Share of the columns' response that may be wrong for being linear [-]; that of
            the settings where left out.
        inflation: Factor on every block's model error [-], so that the blocks that are missed by
            most lead.
        settings: Weights and numbers of the fit.
    """
    share = settings.linear_error if linear_error is None else linear_error
    taken = np.asarray(columns, int)[None]

    def row(given: np.ndarray | None, otherwise: float) -> np.ndarray:
        return np.broadcast_to(otherwise if given is None else given, taken.shape)

    bounds = row(prior, np.inf), row(offset, 0.0), row(lower, -np.inf)
    request = FitRequest(taken, *bounds, np.array([share]), np.array([inflation]))
    return fit_each(matrices, request, settings)[0]


@dataclass(frozen=True, eq=False)
class FitRequest:
    """Linear fits of as many columns each, to be made side by side.

    Attributes:
        columns: Numbers of the columns that act, shape (fits, columns).
        prior: Width of the Gaussian prior on each coefficient; infinite for none; same shape.
        offset: Value that each coefficient counts from, over the centre of its prior; same shape.
        lower: Lower bound of each coefficient; same shape.
        linear_error: Share of the columns' response that may be wrong for being linear [-], shape
            (fits,).
        inflation: Factor on every block's model error [-], shape (fits,).
    """

    columns: np.ndarray
    prior: np.ndarray
    offset: np.ndarray
    lower: np.ndarray
    linear_error: np.ndarray
    inflation: np.ndarray


def fit_each(
    matrices: GramMatrices,
    request: FitRequest,
    settings: LinearFitSettings = DEFAULT_LINEAR_FIT,
) -> list[LinearFit]:
    """Make linear fits side by side; see `fit_linear`.

    Args:
        matrices: Gram matrices of the runs.
        request: The fits.
        settings: Weights and numbers of the fits.
    """
    problem = _problem(matrices, request, settings)
    fits, runs = len(request.columns), len(problem.log_zeta)
    mean_square = problem.gram[..., -1, -1].sum(axis=1) / problem.divisor
    still = np.zeros((fits, runs))
    variance = problem.variance(still)
    response_error = np.zeros_like(mean_square)
    coefficients, change = np.zeros(request.columns.shape), still
    for _ in range(settings.iterations):
        weight = problem.worth / (
            problem.divisor * (mean_square + problem.model_error**2 + response_error)
        )
        coefficients, change = problem.solve(weight, variance)
        mean_square = problem.mean_square(change, coefficients, residual=1.0)
        response = problem.mean_square(still, coefficients, residual=0.0)
        response_error = request.linear_error[:, None] ** 2 * response
        variance = problem.variance(change)
    count = matrices.sample_count.sum(axis=0)
    found = []
    for fit in range(fits):
        left, factor = mean_square[fit] + response_error[fit], float(request.inflation[fit])
        spread = float(variance[fit])
        score = log_score(matrices.blocks, count, left, spread, runs, factor, settings)
        # Responses beyond the range of numbers say nothing, and must not upset an order.
        score = score if np.isfinite(score) else -np.inf
        found.append(LinearFit(score, coefficients[fit], change[fit], mean_square[fit], spread))
    return found


@dataclass(frozen=True, eq=False)
class _Problem:
    """Constants of linear fits that are made side by side.

    Attributes:
        gram: Of (own log zeta, columns..., residual), shape (fits, runs, blocks, n, n).
        divisor: Samples in each block, one at least.
        worth: Independent statements in each block.
        model_error: In each block, shape (fits, blocks).
        log_zeta: Log zeta of each run before the fit.
        precision: Of the prior on each coefficient, shape (fits, columns).
        offset: Value that each coefficient counts from, same shape.
        lower: Lower bound of each coefficient, same shape.
        settings: Of the fits.
    """

    gram: np.ndarray
    divisor: np.ndarray
    worth: np.ndarray
    model_error: np.ndarray
    log_zeta: np.ndarray
    precision: np.ndarray
    offset: np.ndarray
    lower: np.ndarray
    settings: LinearFitSettings

    @property
    def centring(self) -> np.ndarray:
        """Matrix that subtracts the mean over the runs."""
        runs = len(self.log_zeta)
        return np.eye(runs) - 1.0 / runs

    def variance(self, change: np.ndarray) -> np.ndarray:
        """Variance of log zeta over the runs after a change of shape (fits, runs)."""
        moved = self.log_zeta + change
        squares = ((moved @ self.centring) * moved).sum(axis=1)
        return squares / max(len(self.log_zeta) - 1, 1)

    def mean_square(
        self, change: np.ndarray, coefficients: np.ndarray, residual: float
    ) -> np.ndarray:
        """Mean square in each block of the responses and so many times the residual."""
        fits, runs = change.shape
        for_each_run = np.broadcast_to(coefficients[:, None], (fits, runs, coefficients.shape[1]))
        last = np.full((fits, runs, 1), residual)
        factors = np.concatenate([change[..., None], for_each_run, last], axis=2)
        products = (self.gram @ factors[:, :, None, :, None])[..., 0]
        total = np.einsum("fri,frbi->fb", factors, products)
        return np.maximum(total / self.divisor, 0)

    def solve(self, weight: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients and changes of log zeta for these weights of blocks."""
        normal, right = self._normal_equations(weight, variance)
        size = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-300))
        # A slight ridge keeps columns apart that all but coincide.
        scaled = normal / (size[:, :, None] * size[:, None, :]) + 1e-10 * np.eye(right.shape[1])
        solution = np.linalg.solve(scaled, (right / size)[..., None])[..., 0] / size
        p = self.precision.shape[1]
        stay = np.zeros(self.precision.shape, bool)
        # Coefficients below their bound stay at it, and the others are solved for again, by which
        # others may come below theirs.
        while (low := solution[:, :p] < self.lower).any():
            stay, again = stay | low, low.any(axis=1)
            held = np.pad(stay[again], [(0, 0), (0, right.shape[1] - p)])
            bound = np.zeros(held.shape)
            bound[:, :p] = np.where(stay, self.lower, 0.0)[again]
            left = right[again] - (normal[again] @ bound[..., None])[..., 0]
            inner = np.where(held[:, :, None] | held[:, None, :], 0.0, scaled[again])
            inner += held[:, :, None] * np.eye(right.shape[1])
            free = np.where(held, 0.0, left / size[again])
            solved = np.linalg.solve(inner, free[..., None])[..., 0] / size[again]
            solution[again] = np.where(held, bound, solved)
        return solution[:, :p], solution[:, p:]

    def _normal_equations(
        self, weight: np.ndarray, variance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Matrix and right side over (coefficients, changes of log zeta)."""
        (fits, p), runs = self.precision.shape, len(self.log_zeta)
        summed = np.einsum("fb,frbij->frij", weight, self.gram)
        normal, right = np.zeros((fits, p + runs, p + runs)), np.zeros((fits, p + runs))
        prior = self.precision[:, :, None] * np.eye(p)
        normal[:, :p, :p] = summed[:, :, 1:-1, 1:-1].sum(axis=1) + prior
        right[:, :p] = -summed[:, :, 1:-1, -1].sum(axis=1) - self.precision * self.offset
        own = np.arange(p, p + runs)
        normal[:, own, own] = summed[:, :, 0, 0]
        normal[:, :p, p:] = np.swapaxes(summed[:, :, 1:-1, 0], 1, 2)
        normal[:, p:, :p] = summed[:, :, 1:-1, 0]
        right[:, p:] = -summed[:, :, 0, -1]
        hold = self.settings.bed.hold(variance, runs - 1)
        normal[:, p:, p:] += hold[:, None, None] * self.centring
        right[:, p:] -= hold[:, None] * (self.centring @ self.log_zeta)
        return normal, right


def _problem(matrices: GramMatrices, request: FitRequest, settings: LinearFitSettings) -> _Problem:
    fits = len(request.columns)
    last = np.full((fits, 1), matrices.gram.shape[-1] - 1)
    take = np.concatenate([np.zeros_like(last), 1 + request.columns, last], axis=1)
    gram = matrices.gram[:, :, take[:, :, None], take[:, None, :]]
    total = matrices.sample_count.sum(axis=0)
    return _Problem(
        np.ascontiguousarray(np.moveaxis(gram, 2, 0)),
        np.maximum(total, 1),
        total * settings.worth(matrices.blocks),
        request.inflation[:, None] * settings.model_errors(matrices.blocks),
        matrices.log_zeta,
        1 / request.prior**2,
        request.offset,
        request.lower,
        settings,
    )


def floor_inflation(
    blocks: Sequence[Block],
    mean_square: np.ndarray,
    share: float,
    settings: LinearFitSettings = DEFAULT_LINEAR_FIT,
) -> float:
    """A share of the worst block's RMS in model errors [-], of those that count; one at least.

    Args:
        blocks: (channel, kind) of each block.
        mean_square: Mean square of what is left in each, shape (blocks,).
        share: The share [-].
        settings: For the model errors, and for which blocks count.
    """
    miss = np.sqrt(mean_square) / settings.model_errors(blocks)
    return max(1.0, share * float(miss[settings.worth(blocks) > 0].max()))


def log_score(
    blocks: Sequence[Block],
    sample_count: np.ndarray,
    mean_square: np.ndarray,
    zeta_variance: float,
    runs: int,
    inflation: float = 1.0,
    settings: LinearFitSettings = DEFAULT_LINEAR_FIT,
) -> float:
    """Log score of what a model leaves; see the formula at the head of this module.

    Args:
        blocks: (channel, kind) of each block.
        sample_count: Samples in each, shape (blocks,).
        mean_square: Mean square of what is left in each, shape (blocks,).
        zeta_variance: Variance of log zeta over the runs [-].
        runs: Number of runs.
        inflation: Factor on every block's model error [-].
        settings: Weights.
    """
    floor = (inflation * settings.model_errors(blocks)) ** 2
    worth = sample_count * settings.worth(blocks)
    score = -0.5 * float((worth * np.log(mean_square + floor)).sum())
    return score + settings.bed.evidence(zeta_variance, runs - 1)


def block_names(channels: Sequence[str]) -> tuple[Block, ...]:
    """(channel, kind) of the blocks of these channels."""
    return tuple((channel, kind) for channel in channels for kind in kinds_of(channel))
