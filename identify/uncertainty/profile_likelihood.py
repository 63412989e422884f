r"""Profile likelihood: the rise of a fit's sum of squares as one value is held elsewhere.

At each place of the value all others are fitted again. The runs' sum of squares is scaled so that
its curvature is that of the value's standard error without a prior (see
`identify.uncertainty.covariance.rescaled_covariance`), and the priors' squares are added. Twice the
logarithm of the likelihood ratio, which this rise is, follows a chi-squared distribution with one
degree of freedom (Wilks 1938): the interval of a level holds the values whose rise is less than
that level's quantile. Unlike a standard error, the interval follows a curved likelihood and may be
open on one side.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from statistics import NormalDist

import jax.numpy as jnp
import numpy as np
from rich.markup import escape
from rich.table import Table

from drftjax.common.errors import InputError
from drftjax.common.text import replace_unprintable
from identify.parameters.bijector import Interval, Positive
from identify.parameters.parameter import PHASES, SHORT_NAMES, Parameter
from identify.solver.batched_levenberg_marquardt import BatchedLevenbergMarquardt
from identify.solver.problem import normal_equations
from identify.solver.whitening import Whitening
from identify.uncertainty.covariance import regularized_inverse, rescaled_covariance
from identify.uncertainty.estimate import Estimate

# Places to either side of the fitted value, and how far out the last is in standard errors.
PLACES = 5


OUTERMOST = 2.5


LEVEL = 0.90


# No place lies further out than this in coordinates, nor closer to a bound than this share of the
# way between both.
FARTHEST = 3.0


MARGIN = 0.005


@dataclass(frozen=True, eq=False)
class ProfileLikelihood:
    """The profile of one value.

    Attributes:
        label: Which value.
        unit: Its unit.
        value: Places, increasing; the fitted one among them.
        rise: How far the scaled sum of squares has risen there.
        low, high: Ends of the interval; infinite where there is none within the places.
        level: Its level.
    """

    label: str
    unit: str
    value: np.ndarray
    rise: np.ndarray
    low: float
    high: float
    level: float = LEVEL

    def __str__(self) -> str:
        unit = "" if self.unit == "-" else f" {self.unit}"
        low = f"{self.low:.5g}" if np.isfinite(self.low) else "no lower end"
        high = f"{self.high:.5g}" if np.isfinite(self.high) else "no upper end"
        return f"{self.label}: {100 * self.level:.0f} % profile interval {low} to {high}{unit}"

    def table(self) -> Table:
        """Places and rises."""
        table = Table(title=escape(replace_unprintable(f"profile of {self.label}")))
        table.add_column(escape(f"{self.label} [{self.unit}]"), justify="right")
        table.add_column("rise of the sum of squares", justify="right")
        for value, rise in zip(self.value, self.rise, strict=True):
            table.add_row(f"{value:.5g}", f"{rise:.3g}")
        return table


def require_fitted(name: str, parameters: Sequence[Parameter], by_phase: bool = False) -> None:
    """Refuse a profile of what is not fitted."""
    if by_phase:
        parameters = [p for p in parameters if p.quantity.name != "terrain.zeta"]
    known = list(dict.fromkeys(p.quantity.label for p in parameters))
    known += [f"zeta.{phase}" for phase in PHASES] if by_phase else []
    if name not in known and name not in (p.quantity.name for p in parameters):
        near = get_close_matches(name, known, n=2, cutoff=0.4) or known
        raise InputError(
            f"a profile of {name!r} is asked for, which is not fitted; "
            f"did you mean {' or '.join(near)}?"
        )


def profile_likelihoods(
    estimate: Estimate,
    name: str,
    level: float = LEVEL,
    progress: Callable[[str, int, int], None] | None = None,
) -> list[ProfileLikelihood]:
    """The profile of a shared value, or one for each run that has the value for itself.

    Args:
        estimate: Where the fit ended.
        name: As users write it: "lambda", "zeta".
        level: Of the interval.
        progress: Called with the label, the step and the number of places that still move.

    Raises:
        InputError: where no such number was fitted.
    """
    full = SHORT_NAMES.get(name, name)
    require_fitted(name, [p for p, _ in estimate.coordinate_parameters])
    numbers = [
        index
        for index, (p, run) in enumerate(estimate.coordinate_parameters)
        if p.quantity.name == full and (run is None or estimate.solution.active[run])
    ]
    return [_profile(estimate, n, level, progress) for n in numbers]


def _profile(estimate: Estimate, number: int, level: float, progress) -> ProfileLikelihood:
    runs, active = len(estimate.runs), estimate.solution.active
    descent = BatchedLevenbergMarquardt(estimate.problem, runs, _scaled(estimate, number), active)
    at_optimum = descent.run(estimate.flat[None])
    parameter, _ = estimate.coordinate_parameters[number]
    best, least = at_optimum.points[0], at_optimum.loss[0]
    size = len(best)
    covariance = estimate.covariance[:size, :size]
    error = np.sqrt(covariance[number, number])
    held = np.zeros(size, bool)
    held[number] = True
    moves = _places(parameter, float(best[number]), float(error)) - best[number]
    # The straight line says where the others go meanwhile.
    points = best + moves[:, None] * covariance[number] / covariance[number, number]
    label = estimate.labels[number]
    report = None if progress is None else lambda step, left: progress(label, step, left)
    ends = descent.run(points, held=held, progress=report)
    places = np.r_[moves[moves < 0], 0.0, moves[moves > 0]]
    rise = np.insert(ends.loss - least, int((moves < 0).sum()), 0.0)
    wanted = NormalDist().inv_cdf(0.5 + level / 2) ** 2
    low = -_crossing(-places[places <= 0][::-1], rise[places <= 0][::-1], wanted)
    high = _crossing(places[places >= 0], rise[places >= 0], wanted)

    def value(coordinate: np.ndarray) -> np.ndarray:
        full = np.tile(best, (len(coordinate), 1))
        full[:, number] += coordinate
        return estimate.values(full)[:, number]

    bounds = [float(value(np.array([e]))[0]) if np.isfinite(e) else e for e in (low, high)]
    return ProfileLikelihood(
        label, parameter.quantity.unit, value(places), rise, bounds[0], bounds[1], level
    )


def _scaled(estimate: Estimate, number: int) -> Whitening:
    """One scale for all residuals, at which the runs tell of a coordinate what they do tell."""
    solution, counts = estimate.solution, estimate.whitening.scale > 0
    alike, _ = normal_equations(solution.blocks, estimate.shared, solution.residual)
    told, _ = rescaled_covariance(
        solution.blocks, estimate.whitening, estimate.shared, estimate.run_variance
    )
    share = regularized_inverse(alike)[number, number] / regularized_inverse(told)[number, number]
    even = counts * np.sqrt(share)
    return Whitening(even, np.zeros(counts.shape), estimate.whitening.phase)


def _places(parameter: Parameter, best: float, error: float) -> np.ndarray:
    """Coordinates evenly in the value to either side of the best, within the bounds."""
    reach = OUTERMOST * error
    bijector = parameter.bijector
    if isinstance(bijector, Interval):
        inner = MARGIN * (bijector.high - bijector.low)
        edges = bijector.coordinate(jnp.array([bijector.low + inner, bijector.high - inner]))
        ends = [max(best - reach, float(edges[0])), min(best + reach, float(edges[1]))]
    else:
        reach = min(reach, FARTHEST) if isinstance(bijector, Positive) else reach
        ends = [best - reach, best + reach]
    middle, *outer = map(float, bijector.value(jnp.array([best, *ends])))
    values = [
        middle + (end - middle) * share
        for end in outer
        if (end - middle) * (outer[1] - outer[0]) != 0
        for share in np.arange(1, PLACES + 1) / PLACES
    ]
    sides = np.sort([v for v in values if min(outer) <= v <= max(outer)])
    return np.asarray(bijector.coordinate(jnp.asarray(sides)))


def _crossing(distance: np.ndarray, rise: np.ndarray, wanted: float) -> float:
    """Where the rise first exceeds `wanted`; its root is near a straight line."""
    root = np.sign(rise) * np.sqrt(np.abs(rise))
    over = np.flatnonzero(~(rise < wanted))
    if not len(over):
        return np.inf
    after = int(over[0])
    if not np.isfinite(root[after]):
        return float(distance[after])
    share = (np.sqrt(wanted) - root[after - 1]) / (root[after] - root[after - 1])
    return float(distance[after - 1] + share * (distance[after] - distance[after - 1]))
