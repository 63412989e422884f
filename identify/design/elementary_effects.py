r"""Elementary effects of many numbers on the channels of a run: the screening of Morris (1991).

A trajectory is a walk through the box of all ranges that moves one number at a time, each once. A
move by the share $\delta$ of a number's range changes a channel from $y(t)$ to $y'(t)$, and

$$ d_i(t) = (y'(t) - y(t)) / \delta $$

is an elementary effect: the channel's change, were it linear, across the whole range. Morris takes
it of a single output. Here it is a curve, and its size is its root mean square over the run:
changes at different times cannot cancel, and a small change is not hidden beside a large one, as it
would be in the distance from a reference run. Of one sample all numbers are Morris's own.

Morris, M. D. (1991), Technometrics 33, 161-174; mean of absolute values: Campolongo, F., Cariboni,
J., & Saltelli, A. (2007), Environmental Modelling & Software 22, 1509-1518. SALib makes the
trajectories.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from drftjax.common.arrays import require_between
from drftjax.common.errors import InputError

Outputs = Callable[[Float[np.ndarray, "points numbers"]], Float[np.ndarray, "points channels _"]]


@dataclass(frozen=True)
class MorrisSettings:
    """Numbers of a screening by elementary effects.

    Attributes:
        trajectories: Walks through the box; each costs a run for every number, and one. Ten, as
            is usual: four times as many halve the intervals.
        levels: Values that a number takes in its range; four, so that a move is two thirds of it
            (Morris 1991), and every value is as probable as the others.
        quantile: Standard errors in the half width of an interval: 95 % of a normal distribution.
    """

    trajectories: int = 10
    levels: int = 4
    quantile: float = 1.96

    def check(self) -> None:
        """Raise InputError for numbers that cannot be."""
        # One has no spread; hundreds fill the memory, and screen no better.
        require_between("the number of trajectories", self.trajectories, 2, 100)
        require_between("the number of levels", self.levels, 2, 100)
        if self.levels % 2:
            raise InputError(f"the levels are {self.levels}, must be an even number")


@dataclass(frozen=True, eq=False)
class ElementaryEffects:
    """Statistics of the elementary effects of every number on every channel.

    All in the unit of the outputs, for the whole range of a number; NaN where too few simulations
    succeed. Arrays have the shape (numbers, channels).

    Attributes:
        mean_size: Mean size, the mu* of Campolongo et al. (2007).
        interval: Half width of its confidence interval.
        spread: Root mean square distance of the effects from their mean curve, Morris's sigma: how
            much an effect depends on the other numbers, or on where in its range it is.
        counted: Effects that succeeded, shape (numbers,).
        simulations, failed: Simulations in all, and those without finite outputs.
    """

    mean_size: Float[np.ndarray, "numbers channels"]
    interval: Float[np.ndarray, "numbers channels"]
    spread: Float[np.ndarray, "numbers channels"]
    counted: np.ndarray
    simulations: int
    failed: int


def require_extra() -> None:
    """Raise InputError where SALib is not installed."""
    if importlib.util.find_spec("SALib") is None:
        raise InputError("--screen needs SALib: in a checkout, pip install '.[screen]'")


def sample_trajectories(
    numbers: int, settings: MorrisSettings, seed: int
) -> Float[np.ndarray, "trajectories points numbers"]:
    """Trajectories through the unit box, each of one point more than it has numbers.

    Args:
        numbers: Dimension of the box.
        settings: How many trajectories, on how many levels.
        seed: Of the random walks; the same seed gives the same ones.

    Raises:
        InputError: SALib is not installed, or a setting cannot be.
    """
    settings.check()
    require_extra()
    from SALib.sample import morris

    box = {
        "num_vars": numbers,
        "names": [f"{index}" for index in range(numbers)],
        "bounds": [[0.0, 1.0]] * numbers,
    }
    points = morris.sample(box, settings.trajectories, num_levels=settings.levels, seed=seed)
    return np.asarray(points).reshape(settings.trajectories, numbers + 1, numbers)


def trajectory_effects(
    points: Float[np.ndarray, "points numbers"], outputs: Float[np.ndarray, "points channels _"]
) -> Float[np.ndarray, "numbers channels _"]:
    """Elementary effect of every number along one trajectory.

    Args:
        points: Of the trajectory, in the unit box.
        outputs: Of the simulation at each, shape (points, channels, samples); NaN where it failed.

    Returns:
        Change of the outputs per whole range of the number, shape (numbers, channels, samples).
    """
    moves = np.diff(points, axis=0)
    moved = np.abs(moves).argmax(axis=1)
    share = moves[np.arange(len(moves)), moved]
    effects = np.full((points.shape[1], *outputs.shape[1:]), np.nan)
    effects[moved] = np.diff(outputs, axis=0) / share[:, None, None]
    return effects


def screen_function(
    outputs: Outputs,
    numbers: int,
    settings: MorrisSettings,
    seed: int,
    progress: Callable[[int], None] = lambda done: None,
) -> ElementaryEffects:
    """Elementary effects of the numbers of a function.

    Args:
        outputs: Function of points in the unit box, shape (points, numbers), to outputs of shape
            (points, channels, samples). It is called once for each trajectory, always with as
            many points. A point any of whose outputs is not finite has failed.
        numbers: Dimension of the box.
        settings: Trajectories, levels and intervals.
        seed: Of the trajectories.
        progress: Called with the number of trajectories done.

    Raises:
        InputError: SALib is not installed, or a setting cannot be.
    """
    effects, failed, simulations = [], 0, 0
    for done, points in enumerate(sample_trajectories(numbers, settings, seed), start=1):
        values = np.asarray(outputs(points), dtype=float)
        bad = ~np.all(np.isfinite(values), axis=(1, 2))
        values = np.where(bad[:, None, None], np.nan, values)
        failed, simulations = failed + int(bad.sum()), simulations + len(points)
        effects.append(trajectory_effects(points, values))
        progress(done)
    return _statistics(np.stack(effects), settings.quantile, simulations, failed)


def _statistics(
    effects: Float[np.ndarray, "trajectories numbers channels _"],
    quantile: float,
    simulations: int,
    failed: int,
) -> ElementaryEffects:
    succeeded = np.all(np.isfinite(effects), axis=(2, 3))
    effects = np.where(succeeded[:, :, None, None], effects, 0.0)
    counted = succeeded.sum(axis=0)
    size = np.sqrt(np.mean(effects**2, axis=-1))
    # Fewer than two have no spread, and give no number at all.
    enough = np.where(counted > 1, counted, np.nan)[:, None]
    mean_size = size.sum(axis=0) / enough
    mean_curve = effects.sum(axis=0) / enough[:, :, None]
    apart = np.where(succeeded[:, :, None, None], effects - mean_curve, 0.0)
    power = np.mean(apart**2, axis=-1).sum(axis=0)
    scatter = np.where(succeeded[:, :, None], size - mean_size, 0.0)
    variance = (scatter**2).sum(axis=0) / (enough - 1)
    return ElementaryEffects(
        mean_size,
        quantile * np.sqrt(variance / enough),
        np.sqrt(power / (enough - 1)),
        counted,
        simulations,
        failed,
    )
