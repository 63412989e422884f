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
from dataclasses import dataclass, replace
from difflib import get_close_matches
from statistics import NormalDist

import jax.numpy as jnp
import numpy as np
from rich.markup import escape

from drftjax.common.errors import InputError
from drftjax.common.rich_text import WholeWordTable
from drftjax.common.text import replace_unprintable
from identify.parameters.bijector import Interval, Positive
from identify.parameters.parameter import PHASES, SHORT_NAMES, Parameter
from identify.solver.batched_levenberg_marquardt import BatchedLevenbergMarquardt
from identify.solver.problem import normal_equations
from identify.solver.whitening import Whitening
from identify.uncertainty.covariance import regularized_inverse, rescaled_covariance
from identify.uncertainty.estimate import Estimate


@dataclass(frozen=True)
class ProfileSettings:
    """Numbers of a profile likelihood.

    Attributes:
        level: Level of the interval [-].
        places: Places to either side of the fitted value.
        outermost: Distance of the last place, in standard errors.
        farthest: Distance of the last place in coordinates, at most.
        margin: Distance from a bound, at least, as a share of the way between both bounds.
    """

    level: float = 0.90
    places: int = 5
    outermost: float = 2.5
    farthest: float = 3.0
    margin: float = 0.005


PROFILE_SETTINGS = ProfileSettings()


@dataclass(frozen=True, eq=False)
class ProfileLikelihood:
    """Profile likelihood of one value.

    Attributes:
        label: Name of the value.
        unit: Its unit.
        value: Places in `unit`, increasing, the fitted one among them; shape (places,).
        rise: Rise of the scaled sum of squares there [-], shape (places,).
        low, high: Ends of the interval; infinite where they lie beyond the places.
        level: Its level.
    """

    label: str
    unit: str
    value: np.ndarray
    rise: np.ndarray
    low: float
    high: float
    level: float = ProfileSettings.level

    def __str__(self) -> str:
        unit = "" if self.unit == "-" else f" {self.unit}"
        low = f"{self.low:.5g}" if np.isfinite(self.low) else "no lower end"
        high = f"{self.high:.5g}" if np.isfinite(self.high) else "no upper end"
        return f"{self.label}: {100 * self.level:.0f} % profile interval {low} to {high}{unit}"

    def table(self) -> WholeWordTable:
        """Return places and rises as a table."""
        table = WholeWordTable(title=escape(replace_unprintable(f"profile of {self.label}")))
        table.add_column(escape(f"{self.label} [{self.unit}]"), justify="right")
        table.add_column("rise of the sum of squares", justify="right")
        for value, rise in zip(self.value, self.rise, strict=True):
            table.add_row(f"{value:.5g}", f"{rise:.3g}")
        return table


def require_fitted(name: str, parameters: Sequence[Parameter], by_phase: bool = False) -> None:
    """Raise InputError for a profile of a parameter that is not fitted."""
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
    level: float | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    settings: ProfileSettings = PROFILE_SETTINGS,
) -> list[ProfileLikelihood]:
    """Return the profile of a shared value, or one for each run that has its own.

    Args:
        estimate: Of the fit.
        name: As users write it: "lambda", "zeta".
        level: Of the interval, if another than that of the settings.
        progress: Called with the label, the step and the number of places that still move.
        settings: Decision numbers.

    Raises:
        InputError: where no such number was fitted.
    """
    if level is not None:
        settings = replace(settings, level=level)
    full = SHORT_NAMES.get(name, name)
    require_fitted(name, [p for p, _ in estimate.coordinate_parameters])
    numbers = [
        index
        for index, (p, run) in enumerate(estimate.coordinate_parameters)
        if p.quantity.name == full and (run is None or estimate.solution.active[run])
    ]
    return [_profile(estimate, n, settings, progress) for n in numbers]


def _profile(
    estimate: Estimate, number: int, settings: ProfileSettings, progress
) -> ProfileLikelihood:
    runs, active = len(estimate.runs), estimate.solution.active
    descent = BatchedLevenbergMarquardt(estimate.problem, runs, _scaled(estimate, number), active)
    fitted = descent.run(estimate.flat[None])
    parameter, _ = estimate.coordinate_parameters[number]
    best, least = fitted.points[0], fitted.loss[0]
    size = len(best)
    covariance = estimate.covariance[:size, :size]
    error = np.sqrt(covariance[number, number])
    held = np.zeros(size, bool)
    held[number] = True
    moves = _places(parameter, float(best[number]), float(error), settings) - best[number]
    # The others start where the linearisation puts them.
    points = best + moves[:, None] * covariance[number] / covariance[number, number]
    label = estimate.labels[number]
    report = None if progress is None else lambda step, left: progress(label, step, left)
    ends = descent.run(points, held=held, progress=report)
    places = np.r_[moves[moves < 0], 0.0, moves[moves > 0]]
    rise = np.insert(ends.loss - least, int((moves < 0).sum()), 0.0)
    wanted = NormalDist().inv_cdf(0.5 + settings.level / 2) ** 2
    low = -_crossing(-places[places <= 0][::-1], rise[places <= 0][::-1], wanted)
    high = _crossing(places[places >= 0], rise[places >= 0], wanted)

    def value(coordinate: np.ndarray) -> np.ndarray:
        full = np.tile(best, (len(coordinate), 1))
        full[:, number] += coordinate
        return estimate.values(full)[:, number]

    bounds = [float(value(np.array([e]))[0]) if np.isfinite(e) else e for e in (low, high)]
    return ProfileLikelihood(
        label, parameter.quantity.unit, value(places), rise, bounds[0], bounds[1], settings.level
    )


def _scaled(estimate: Estimate, number: int) -> Whitening:
    """Return one scale for all residuals that gives a coordinate its standard error by the runs."""
    solution, counts = estimate.solution, estimate.whitening.scale > 0
    alike, _ = normal_equations(solution.blocks, estimate.shared, solution.residual)
    information, _ = rescaled_covariance(
        solution.blocks, estimate.whitening, estimate.shared, estimate.run_variance
    )
    share = (
        regularized_inverse(alike)[number, number]
        / regularized_inverse(information)[number, number]
    )
    even = counts * np.sqrt(share)
    return Whitening(even, np.zeros(counts.shape), estimate.whitening.phase)


def _places(
    parameter: Parameter, best: float, error: float, settings: ProfileSettings
) -> np.ndarray:
    """Return coordinates, evenly spaced in the value to either side of the best, within bounds."""
    reach = settings.outermost * error
    bijector = parameter.bijector
    if isinstance(bijector, Interval):
        inner = settings.margin * (bijector.high - bijector.low)
        edges = bijector.coordinate(jnp.array([bijector.low + inner, bijector.high - inner]))
        ends = [max(best - reach, float(edges[0])), min(best + reach, float(edges[1]))]
    else:
        reach = min(reach, settings.farthest) if isinstance(bijector, Positive) else reach
        ends = [best - reach, best + reach]
    middle, *outer = map(float, bijector.value(jnp.array([best, *ends])))
    values = [
        middle + (end - middle) * share
        for end in outer
        if (end - middle) * (outer[1] - outer[0]) != 0
        for share in np.arange(1, settings.places + 1) / settings.places
    ]
    sides = np.sort([v for v in values if min(outer) <= v <= max(outer)])
    return np.asarray(bijector.coordinate(jnp.asarray(sides)))


def _crossing(distance: np.ndarray, rise: np.ndarray, wanted: float) -> float:
    """Return the distance at which the rise first exceeds `wanted`, linear in its square root."""
    root = np.sign(rise) * np.sqrt(np.abs(rise))
    over = np.flatnonzero(~(rise < wanted))
    if not len(over):
        return np.inf
    after = int(over[0])
    if not np.isfinite(root[after]):
        return float(distance[after])
    share = (np.sqrt(wanted) - root[after - 1]) / (root[after] - root[after - 1])
    return float(distance[after - 1] + share * (distance[after] - distance[after - 1]))
