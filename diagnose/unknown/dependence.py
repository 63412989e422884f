"""What an unknown error follows: the variable of which it is a curve, in runs not seen."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.localization.kinematics import RunKinematics, kinematics_of_run
from diagnose.unknown.disturbances import Disturbance, DisturbanceRegressors
from diagnose.unknown.gaussian_smoother import SMOOTHER_SETTINGS
from drftjax.effects.correction import VARIABLES, Curve, correction_class
from drftjax.recorded.repeats import group_by_condition

# A curve's values may be as large as this many levels of the signal; its bends as one of these,
# whichever predicts the conditions left out best.
CURVE_LEVELS, CURVE_BENDS = 5.0, (1.5, 0.3, 0.06, 0.012)


# Knots of a curve, and how far it may well change from end to end, in levels: a coarse one that may
# go far, also where no other run has been, and a fine one that is held to the signal's own size.
CURVES = ((6, 10.0), (12, 1.0))


# Where it may be a matter of places or of moments, patches and waves need more.
MORE_KNOTS = {"travel": 16, "turning": 16, "time": 16, "wheel angle": 12}


# Stages whose logarithm of evidence differs by less than this are not told apart by it.
TIED = 10.0


# The knots span the variable but for this percentage on either side.
OUTER = 1.0


def rank_dependence(case: RigDataset, stage: Disturbance) -> list[tuple[str, float]]:
    """How well a curve over each variable stands for a stage's signal, best first.

    One curve for all runs is put in the signal's place and fitted to all conditions but one; what
    it explains of that one, each in turn, is compared with what the signal explains of all.

    Args:
        case: The runs.
        stage: Of `stages`.

    Returns:
        Variables of `VARIABLES` with that share [-]; with one condition, of its runs themselves.
    """
    motions = [kinematics_of_run(case, run) for run in range(len(case.runs))]
    found = []
    for variable in VARIABLES:
        values = _at_knots(motions, stage.columns, variable)
        if values is None:
            continue
        found.append((variable, _share(stage, _curves(case, stage, values, variable))))
    return sorted(found, key=lambda each: -each[1])


def choose_disturbance(
    case: RigDataset, found: Sequence[Disturbance]
) -> tuple[Disturbance, list[tuple[str, float]]]:
    """The stage to look in first, and what its signal follows.

    Among stages that the runs cannot tell apart it is the one that follows one variable best: an
    error that is a curve of something is simpler than one that only lasts.

    Args:
        case: The runs.
        found: By `stages`, best first; not empty.
    """
    tied = [each for each in found if each.evidence > found[0].evidence - TIED]
    both = [(each, rank_dependence(case, each)) for each in tied]
    return max(both, key=lambda pair: pair[1][0][1] if pair[1] else 0.0)


@dataclass(frozen=True, eq=False)
class FittedCurve:
    """A curve in the place of a stage's signal.

    Attributes:
        kind: The correction that holds it.
        values: At its knots.
        precision: Of what is believed of these values before any run, shape (knots, knots).
    """

    kind: type[Curve]
    values: np.ndarray
    precision: np.ndarray


def fit_curve(case: RigDataset, stage: Disturbance, variable: str) -> list[FittedCurve]:
    """Curves over a variable that stand for a stage's signal in all runs, on straight lines.

    Args:
        case: The runs.
        stage: Of `stages`.
        variable: That its stage can know.

    Returns:
        One for each of `CURVES`; none where some run does not tell the variable.
    """
    motions = [kinematics_of_run(case, run) for run in range(len(case.runs))]
    values = _at_knots(motions, stage.columns, variable)
    if values is None:
        return []
    runs = np.arange(len(values))
    return [
        FittedCurve(
            correction_class(stage.name, variable, each.knots.tolist()),
            each.fitted(runs, each.belief),
            each.belief,
        )
        for each in _curves(case, stage, values, variable)
    ]


def signal_against(
    case: RigDataset, stage: Disturbance, variable: str
) -> list[tuple[np.ndarray, np.ndarray]]:
    """By run, a variable and the stage's signal at its knots: what a figure of both shows."""
    motions = [kinematics_of_run(case, run) for run in range(len(case.runs))]
    values = _at_knots(motions, stage.columns, variable)
    if values is None:
        return []
    return list(zip(values, stage.signal, strict=True))


class _Curves:
    """One curve in the place of a stage's signal: its products with the data, by run."""

    def __init__(
        self,
        knots: np.ndarray,
        gram: np.ndarray,
        groups: list[list[int]],
        beliefs: list[np.ndarray],
    ):
        self.knots, self.gram, self.groups = knots, gram, groups
        self.belief = max(beliefs, key=self.gained)

    @classmethod
    def of(
        cls,
        stage: Disturbance,
        values: list[np.ndarray],
        knots: np.ndarray,
        around: bool,
        groups: list[list[int]],
        change: float,
    ) -> "_Curves":
        """Of a variable at the stage's knots of every run."""
        size = len(knots) + 2
        gram = np.zeros((len(values), size, size))
        for channel, noise in enumerate(stage.noise):
            for run, at in enumerate(values):
                a, y = stage.columns.columns[channel][run], stage.columns.data[channel][run]
                shape = _basis(at, knots, around)
                both = np.c_[a[:, :1], a[:, 1 : 1 + len(at)] @ shape, y] / noise
                gram[run] += both.T @ both
        return cls(knots, gram, groups, _beliefs(knots, max(stage.level, 1e-12), change, around))

    def free(self, run: int) -> np.ndarray:
        """A run's products with its own zeta fitted away."""
        gram = self.gram[run]
        own = gram[0, 0] + SMOOTHER_SETTINGS.own_zeta**-2
        return gram[1:, 1:] - np.outer(gram[1:, 0], gram[0, 1:]) / own

    def fitted(self, runs: np.ndarray, belief: np.ndarray) -> np.ndarray:
        """Values of the curve of these runs, with the precision of what is believed of them."""
        total = np.sum([self.free(run) for run in runs], axis=0)
        return np.linalg.solve(total[:-1, :-1] + belief, total[:-1, -1])

    def gained(self, belief: np.ndarray) -> float:
        """Squares that a curve takes away from each condition in turn, fitted to the others."""
        runs, gain = np.arange(len(self.gram)), 0.0
        for group in self.groups:
            others = np.setdiff1d(runs, group) if len(self.groups) > 1 else runs
            values = self.fitted(others, belief)
            for run in group:
                gain += self.left(run, np.zeros(len(values))) - self.left(run, values)
        return gain

    def left(self, run: int, values: np.ndarray) -> float:
        """Squares that a curve leaves in a run."""
        both = np.r_[values, -1.0]
        return float(both @ self.free(run) @ both)


def _curves(
    case: RigDataset, stage: Disturbance, values: list[np.ndarray], variable: str
) -> list[_Curves]:
    """Every curve of `CURVES` over a variable, given at the stage's knots of every run."""
    around = variable == "wheel angle"
    groups = group_by_condition(case.runs)
    found = []
    # A curve around a turn has no ends to go on from.
    for count, change in CURVES[:1] if around else CURVES:
        knots = _places(np.concatenate(values), around, MORE_KNOTS.get(variable, count))
        found.append(_Curves.of(stage, values, knots, around, groups, change))
    return found


def _beliefs(knots: np.ndarray, level: float, change: float, around: bool) -> list[np.ndarray]:
    """Precisions of a curve's values, one for each bend that it may be believed to have.

    Args:
        knots: Places of the values, ascending.
        level: Of the signal.
        change: From end to end [levels].
        around: Whether it closes around a turn, where it has no ends and only bends.
    """
    unit = np.eye(len(knots))
    ahead, behind = (np.roll(unit, way, axis=1) for way in (1, -1))
    steps, bends = ahead - unit, ahead - 2 * unit + behind
    size = unit / (CURVE_LEVELS * level) ** 2
    if not around:
        steps, bends = steps[:-1], bends[1:-1]
        size += steps.T @ steps * len(steps) / (change * level) ** 2
    return [size + bends.T @ bends / (bend * level) ** 2 for bend in CURVE_BENDS]


def _share(stage: Disturbance, curves: list[_Curves]) -> float:
    runs = range(len(curves[0].gram))
    nothing = sum(curves[0].left(run, np.zeros(len(curves[0].knots))) for run in runs)
    signal = 0.0
    for channel, noise in enumerate(stage.noise):
        for run in runs:
            a, y = stage.columns.columns[channel][run], stage.columns.data[channel][run]
            given = np.zeros(a.shape[1])
            given[1 : 1 + len(stage.signal[run])] = stage.signal[run]
            given[0] = stage.own[run]
            signal += float((((y - a @ given) / noise) ** 2).sum())
    explained = nothing - signal
    if not explained > 0:
        return 0.0
    gained = max(each.gained(each.belief) for each in curves)
    return float(np.clip(gained / explained, 0, 1))


def _at_knots(
    motions: list[RunKinematics], columns: DisturbanceRegressors, variable: str
) -> list[np.ndarray] | None:
    """A variable at the knots of every run; None where some run does not tell it."""
    pick = {
        "angular velocity": lambda m: m.omega,
        "slip speed": lambda m: m.slip_speed,
        "sinkage": lambda m: m.sinkage,
        "travel": lambda m: m.travel,
        "turning": lambda m: m.turning,
        "time": lambda m: m.time,
        "wheel angle": lambda m: m.angle,
        "vx": lambda m: m.vx,
        "vz": lambda m: m.vz,
    }[variable]
    found = []
    for motion, at in zip(motions, columns.time, strict=True):
        values = pick(motion)
        if values is None:
            return None
        found.append(np.interp(at, motion.time, values))
    return found


def _places(values: np.ndarray, around: bool, count: int) -> np.ndarray:
    """Knots over the variable's range."""
    if around:
        return np.arange(count) * 2 * np.pi / count
    low, high = np.percentile(values, [OUTER, 100 - OUTER])
    if not high - low > 1e-9 * max(abs(low), abs(high), 1e-9):
        high = low + 1e-6
    return np.linspace(low, high, count)


def _basis(values: np.ndarray, knots: np.ndarray, around: bool) -> np.ndarray:
    """Values at which each knot's own value counts, shape (values, knots)."""
    if around:
        turn = 2 * np.pi
        units = [np.interp(np.mod(values, turn), knots, u, period=turn) for u in np.eye(len(knots))]
    else:
        units = [np.interp(values, knots, unit) for unit in np.eye(len(knots))]
    return np.stack(units, axis=1)
