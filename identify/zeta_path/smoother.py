r"""zeta(t) of recorded runs, offline, as smooth as the data say.

The logarithm of zeta is a natural cubic spline through knots, simulated as short straight lines;
its values u at the knots are fitted to recorded sinkage and, close to its optimum, to travel too.
The prior is a discrete cubic smoothing spline's,

$$\sqrt{w}\,(u_{k-1} - 2 u_k + u_{k+1}) \sim N(0, 1),$$

and each channel's residual is first-order autoregressive, with a variance and a correlation of its
own; that of sinkage lasts no longer than knots can resolve, as the rest is for zeta to explain.
With the simulation linearised by its exact derivative, the probability of the data given w and the
noise (the evidence, by Laplace's approximation) is a Gaussian integral in closed form. Its largest
value over a grid of w, with the noise found by expectation-maximisation at each, chooses w;
Gauss-Newton steps move the linearisation until they converge. Close to its optimum the error by the
integrator's step is taken off (`drftjax.simulation.step_error`).
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from drftjax.common.errors import InputError, RunError
from drftjax.recorded.batch import device_mesh, make_batch
from drftjax.recorded.prepared_run import PreparedRun
from identify.zeta_path.gauss_newton import ZetaPathSolver, sinkage_and_travel
from identify.zeta_path.path import ZetaPath, cardinal_splines, segment_ends
from identify.zeta_path.settings import ZETA_PATH_SETTINGS, ZetaPathSettings
from identify.zeta_path.simulate import (
    START_COORDINATES,
    predict_with_jacobian,
    step_errors,
    with_zeta_knots,
)

# Time from knot to knot, unless asked for otherwise [s].
KNOT_SPACING = 1.0


def zeta_paths(
    runs: Sequence[PreparedRun],
    knot_spacing: float = KNOT_SPACING,
    settings: ZetaPathSettings = ZETA_PATH_SETTINGS,
) -> list[ZetaPath]:
    """Fit zeta(t) of each run; the runs are simulated side by side.

    Args:
        runs: Runs that share one program: same kind of wheel, law and carriage.
        knot_spacing: Time from knot to knot [s]; stretched a little, so that they end with the
            samples compared.
        settings: Decision numbers.

    Raises:
        RunError: where a run has no sinkage, is too short, or cannot be simulated.
        InputError: where the knot spacing is not positive.
    """
    return [each.path() for each in path_solvers(runs, knot_spacing, settings=settings)]


def path_solvers(
    runs: Sequence[PreparedRun],
    knot_spacing: float,
    begun: Sequence[ZetaPathSolver] | None = None,
    settings: ZetaPathSettings = ZETA_PATH_SETTINGS,
) -> list[ZetaPathSolver]:
    """Fit zeta(t) of each run; return the solvers, with the linearisations that they ended at.

    Args:
        runs, knot_spacing, settings: See `zeta_paths`.
        begun: The same runs' paths to go on from, at other values of what is not fitted here.
    """
    channels = [sinkage_and_travel(each).channels for each in runs]
    found: dict[int, ZetaPathSolver] = {}
    for kind in dict.fromkeys(channels):
        alike = [number for number, own in enumerate(channels) if own == kind]
        steps = _solve_together(
            [runs[number] for number in alike],
            knot_spacing,
            [None if begun is None else begun[number] for number in alike],
            settings,
        )
        found |= dict(zip(alike, steps, strict=True))
    return [found[number] for number in range(len(runs))]


def _solve_together(
    runs: Sequence[PreparedRun],
    knot_spacing: float,
    begun: Sequence[ZetaPathSolver | None],
    settings: ZetaPathSettings,
) -> list[ZetaPathSolver]:
    """Fit runs that have the same channels, with one simulation of all of them a step."""
    grids = [_knots(each, knot_spacing) for each in runs]
    longest = max(grids, key=len)
    most, lines = len(longest), len(segment_ends(longest))
    trials = [
        with_zeta_knots(each.trial, _padded_ends(segment_ends(grid), lines))
        for each, grid in zip(runs, grids, strict=True)
    ]
    observations = [sinkage_and_travel(each) for each in runs]
    batch, mesh = make_batch(trials, observations, jax.device_count()), device_mesh()
    curves = np.zeros((len(batch.order), lines, most))
    for curve, grid in zip(curves, grids, strict=False):
        drawn = cardinal_splines(grid, segment_ends(grid))
        curve[: len(drawn), : len(grid)] = drawn
    curves = jnp.asarray(curves)
    fits = [
        ZetaPathSolver(each, batch, number, grid, curves[number], last, settings)
        for number, (each, grid, last) in enumerate(zip(runs, grids, begun, strict=True))
    ]
    compared = batch.observed.compared_rows
    coordinates = np.zeros((len(curves), most + START_COORDINATES))
    while not all(fit.settled for fit in fits):
        for number, fit in enumerate(fits):
            coordinates[number] = fit.padded
            if fit.settled:
                compared = compared.at[number].set(0)
        near = [number for number, fit in enumerate(fits) if fit.close and fit.step_error is None]
        if near:
            error = step_errors(batch, mesh, curves, jnp.asarray(coordinates), near)
            for number in near:
                fits[number].take_off(error[number])
            batch = eqx.tree_at(
                lambda b: b.observed.step_error, batch, batch.observed.step_error + error
            )
        unsettled = eqx.tree_at(lambda b: b.observed.compared_rows, batch, compared)
        found = predict_with_jacobian(unsettled, mesh, curves, jnp.asarray(coordinates))
        predicted, derivative = (np.asarray(each)[: len(fits)] for each in found)
        for fit, values, slopes in zip(fits, predicted, derivative, strict=True):
            if not fit.settled:
                fit.advance(values, np.delete(slopes, np.s_[fit.knots : most], axis=-1))
    return fits


def _knots(each: PreparedRun, spacing: float) -> np.ndarray:
    """Return the knots of a run from its start [s]."""
    if not (np.isfinite(spacing) and spacing > 0):
        raise InputError(f"the knot spacing is {spacing:g} s, must be positive")
    duration = float(each.observation.time[each.observation.counts].max(initial=0.0))
    duration = min(duration, float(each.trial.time[-1]))
    intervals = max(2, round(duration / spacing))
    samples = int(each.observation.counts.sum())
    if samples < 2 * intervals:
        raise RunError(
            each.name,
            f"has {samples} samples to compare, too few for {intervals + 1} knots of zeta; give a "
            "longer knot spacing",
        )
    return np.linspace(0.0, duration, intervals + 1)


def _padded_ends(ends: np.ndarray, length: int) -> np.ndarray:
    """Return the ends with further ones after the run, which nothing depends on."""
    return np.concatenate([ends, ends[-1] + np.arange(1.0, length - len(ends) + 1)])
