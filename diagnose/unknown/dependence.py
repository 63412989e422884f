"""Dependence of a disturbance on state variables, by cross-validated curves."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.localization.kinematics import RunKinematics, kinematics_of_run
from diagnose.unknown.disturbances import Disturbance, DisturbanceRegressors
from diagnose.unknown.gaussian_smoother import SMOOTHER_SETTINGS
from diagnose.unknown.settings import DEFAULT_UNKNOWN_EFFECT, UnknownEffectSettings
from drftjax.effects.correction import VARIABLES, Curve, correction_class
from drftjax.recorded.repeats import group_by_condition

PERIODIC_VARIABLE = "wheel angle"
"""The variable over which a curve closes after a turn."""

VARIABLE_OF: dict[str, Callable[[RunKinematics], np.ndarray | None]] = {
    "angular velocity": lambda m: m.omega,
    "slip speed": lambda m: m.slip_speed,
    "sinkage": lambda m: m.sinkage,
    "travel": lambda m: m.travel,
    "turning": lambda m: m.turning,
    "time": lambda m: m.time,
    "wheel angle": lambda m: m.angle,
    "vx": lambda m: m.vx,
    "vz": lambda m: m.vz,
}
"""Variables of a curve, from a run's kinematics."""


def rank_dependence(
    dataset: RigDataset,
    disturbance: Disturbance,
    settings: UnknownEffectSettings = DEFAULT_UNKNOWN_EFFECT,
) -> list[tuple[str, float]]:
    r"""Share of a disturbance that a curve over each variable explains, the best first.

    One curve c of a variable s for all runs, $u(t) = c(s(t))$, is put in the disturbance's place
    and fitted to all conditions but one; what it removes of that one's squared residual, each in
    turn, is compared with what the disturbance removes of all.

    Args:
        dataset: The runs.
        disturbance: By `estimate_disturbances`.
        settings: Knots of the curves.

    Returns:
        Variables of `VARIABLES` with that share [-]; with one condition, of its runs themselves.
    """
    motions = _motions(dataset)
    found = []
    for variable in VARIABLES:
        values = _values_at_knots(motions, disturbance.regressors, variable)
        if values is None:
            continue
        curves = _curve_fits(dataset, disturbance, values, variable, settings)
        found.append((variable, _explained_share(disturbance, curves)))
    return sorted(found, key=lambda each: -each[1])


def choose_disturbance(
    dataset: RigDataset,
    found: Sequence[Disturbance],
    settings: UnknownEffectSettings = DEFAULT_UNKNOWN_EFFECT,
) -> tuple[Disturbance, list[tuple[str, float]]]:
    """The disturbance to explain first, and its dependence by `rank_dependence`.

    Of disturbances with equal evidence it is the one that depends best on one variable: an error
    that is a curve of something is simpler than one that is only smooth.

    Args:
        dataset: The runs.
        found: By `estimate_disturbances`, best first; not empty.
        settings: Tie of the evidences.
    """
    tied = [each for each in found if each.evidence > found[0].evidence - settings.tied_evidence]
    ranked = [(each, rank_dependence(dataset, each, settings)) for each in tied]
    return max(ranked, key=lambda pair: pair[1][0][1] if pair[1] else 0.0)


@dataclass(frozen=True, eq=False)
class FittedCurve:
    """Curve in the place of a disturbance.

    Attributes:
        effect_type: The correction that holds it.
        values: At its knots, shape (knots,).
        precision: Of the prior of these values, shape (knots, knots).
    """

    effect_type: type[Curve]
    values: np.ndarray
    precision: np.ndarray


def fit_curve(
    dataset: RigDataset,
    disturbance: Disturbance,
    variable: str,
    settings: UnknownEffectSettings = DEFAULT_UNKNOWN_EFFECT,
) -> list[FittedCurve]:
    """Curves over a variable in the disturbance's place in all runs, by the linear response.

    Args:
        dataset: The runs.
        disturbance: By `estimate_disturbances`.
        variable: A variable that its stage can know.
        settings: Knots of the curves.

    Returns:
        One for each of `settings.curves`; empty where the variable of some run is not known.
    """
    values = _values_at_knots(_motions(dataset), disturbance.regressors, variable)
    if values is None:
        return []
    runs = np.arange(len(values))
    return [
        FittedCurve(
            correction_class(disturbance.name, variable, each.knots.tolist()),
            each.fit(runs, each.precision),
            each.precision,
        )
        for each in _curve_fits(dataset, disturbance, values, variable, settings)
    ]


def signal_against(
    dataset: RigDataset, disturbance: Disturbance, variable: str
) -> list[tuple[np.ndarray, np.ndarray]]:
    """By run, a variable and the disturbance at its knots, shape (knots,) each, for a figure."""
    values = _values_at_knots(_motions(dataset), disturbance.regressors, variable)
    return [] if values is None else list(zip(values, disturbance.signal, strict=True))


class _CurveFit:
    """Linear fit of one curve in the place of a disturbance.

    Attributes:
        knots: Of the curve, shape (knots,).
        gram: By run, products of the columns (own zeta, knots, data), shape (runs, knots + 2,
            knots + 2).
        groups: Runs of each condition.
        precision: Of the prior that predicts held-out conditions best, shape (knots, knots).
    """

    def __init__(
        self,
        knots: np.ndarray,
        gram: np.ndarray,
        groups: list[list[int]],
        precisions: list[np.ndarray],
    ):
        self.knots, self.gram, self.groups = knots, gram, groups
        self.precision = max(precisions, key=self.gain)

    @classmethod
    def of(
        cls,
        disturbance: Disturbance,
        values: list[np.ndarray],
        knots: np.ndarray,
        periodic: bool,
        groups: list[list[int]],
        precisions: list[np.ndarray],
    ) -> "_CurveFit":
        """Fit over a variable that is given at the disturbance's knots of every run."""
        size = len(knots) + 2
        gram = np.zeros((len(values), size, size))
        regressors = disturbance.regressors
        for channel, noise in enumerate(disturbance.noise):
            for run, at in enumerate(values):
                a, y = regressors.columns[channel][run], regressors.data[channel][run]
                basis = _basis(at, knots, periodic)
                both = np.c_[a[:, :1], a[:, 1 : 1 + len(at)] @ basis, y] / noise
                gram[run] += both.T @ both
        return cls(knots, gram, groups, precisions)

    def without_zeta(self, run: int) -> np.ndarray:
        """A run's products with its own zeta eliminated, shape (knots + 1, knots + 1)."""
        gram = self.gram[run]
        own = gram[0, 0] + SMOOTHER_SETTINGS.own_zeta**-2
        return gram[1:, 1:] - np.outer(gram[1:, 0], gram[0, 1:]) / own

    def fit(self, runs: np.ndarray, precision: np.ndarray) -> np.ndarray:
        """Posterior mean of the curve's values from some runs, with a prior's precision."""
        total = np.sum([self.without_zeta(run) for run in runs], axis=0)
        return np.linalg.solve(total[:-1, :-1] + precision, total[:-1, -1])

    def gain(self, precision: np.ndarray) -> float:
        """Squares that a curve removes from each condition in turn, fitted to the others."""
        runs, gain = np.arange(len(self.gram)), 0.0
        for group in self.groups:
            others = np.setdiff1d(runs, group) if len(self.groups) > 1 else runs
            values = self.fit(others, precision)
            for run in group:
                gain += self.squares(run, np.zeros(len(values))) - self.squares(run, values)
        return gain

    def squares(self, run: int, values: np.ndarray) -> float:
        """Squares that remain in a run with a curve of these values."""
        both = np.r_[values, -1.0]
        return float(both @ self.without_zeta(run) @ both)


def _motions(dataset: RigDataset) -> list[RunKinematics]:
    return [kinematics_of_run(dataset, run) for run in range(len(dataset.runs))]


def _curve_fits(
    dataset: RigDataset,
    disturbance: Disturbance,
    values: list[np.ndarray],
    variable: str,
    settings: UnknownEffectSettings,
) -> list[_CurveFit]:
    """Fits of all `settings.curves` over a variable, given at the disturbance's knots."""
    periodic = variable == PERIODIC_VARIABLE
    groups = group_by_condition(dataset.runs)
    level = max(disturbance.level, 1e-12)
    found = []
    # A periodic curve has no ends to go on from: one is enough.
    for count, change in settings.curves[:1] if periodic else settings.curves:
        count = dict(settings.more_knots).get(variable, count)
        knots = _curve_knots(np.concatenate(values), periodic, count, settings.outer_percent)
        precisions = _prior_precisions(knots, level, change, periodic, settings)
        found.append(_CurveFit.of(disturbance, values, knots, periodic, groups, precisions))
    return found


def _prior_precisions(
    knots: np.ndarray, level: float, change: float, periodic: bool, settings: UnknownEffectSettings
) -> list[np.ndarray]:
    r"""Precisions of a curve's values, one for each of `settings.curve_bends`.

    $I / (s l)^2 + n D_1^T D_1 / (c l)^2 + D_2^T D_2 / (b l)^2$ with the first and second
    differences D over the knots, the level l, the size s, the change c and the bend b.

    Args:
        knots: Places of the values, ascending, shape (knots,).
        level: Of the disturbance.
        change: From end to end [levels].
        periodic: True where the curve closes, so that it has no ends and only bends.
        settings: Sizes and bends.
    """
    unit = np.eye(len(knots))
    ahead, behind = (np.roll(unit, shift, axis=1) for shift in (1, -1))
    steps, bends = ahead - unit, ahead - 2 * unit + behind
    size = unit / (settings.curve_size * level) ** 2
    if not periodic:
        steps, bends = steps[:-1], bends[1:-1]
        size += steps.T @ steps * len(steps) / (change * level) ** 2
    return [size + bends.T @ bends / (bend * level) ** 2 for bend in settings.curve_bends]


def _explained_share(disturbance: Disturbance, curves: list[_CurveFit]) -> float:
    """Cross-validated gain of the best curve over the squares that the disturbance removes [-]."""
    runs = range(len(curves[0].gram))
    nothing = sum(curves[0].squares(run, np.zeros(len(curves[0].knots))) for run in runs)
    with_signal = 0.0
    for channel, noise in enumerate(disturbance.noise):
        for run in runs:
            a = disturbance.regressors.columns[channel][run]
            y = disturbance.regressors.data[channel][run]
            coefficients = np.zeros(a.shape[1])
            coefficients[1 : 1 + len(disturbance.signal[run])] = disturbance.signal[run]
            coefficients[0] = disturbance.log_zeta_change[run]
            with_signal += float((((y - a @ coefficients) / noise) ** 2).sum())
    removed = nothing - with_signal
    if not removed > 0:
        return 0.0
    gain = max(each.gain(each.precision) for each in curves)
    return float(np.clip(gain / removed, 0, 1))


def _values_at_knots(
    motions: list[RunKinematics], regressors: DisturbanceRegressors, variable: str
) -> list[np.ndarray] | None:
    """By run, a variable at the disturbance's knots; None where it is not known of some run."""
    found = []
    for motion, at in zip(motions, regressors.time, strict=True):
        values = VARIABLE_OF[variable](motion)
        if values is None:
            return None
        found.append(np.interp(at, motion.time, values))
    return found


def _curve_knots(
    values: np.ndarray, periodic: bool, count: int, outer_percent: float
) -> np.ndarray:
    """Evenly spaced knots over the variable's range."""
    if periodic:
        return np.arange(count) * 2 * np.pi / count
    low, high = np.percentile(values, [outer_percent, 100 - outer_percent])
    if not high - low > 1e-9 * max(abs(low), abs(high), 1e-9):
        high = low + 1e-6
    return np.linspace(low, high, count)


def _basis(values: np.ndarray, knots: np.ndarray, periodic: bool) -> np.ndarray:
    """Linear interpolation from values at knots, as a matrix of shape (values, knots)."""
    if periodic:
        turn = 2 * np.pi
        units = [np.interp(np.mod(values, turn), knots, u, period=turn) for u in np.eye(len(knots))]
    else:
        units = [np.interp(values, knots, unit) for unit in np.eye(len(knots))]
    return np.stack(units, axis=1)
