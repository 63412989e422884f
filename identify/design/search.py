"""Descent of a parameter's standard error over profile, load and start angle (BFGS)."""

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from drftjax.physics.stress import Rounded
from drftjax.setups.setup import CommandSetUp
from drftjax.simulation.rollout import step_times
from drftjax.simulation.trial import ROW_INTERVAL, Trial
from identify.design.fisher_information import (
    BOUND_MARGIN,
    Objective,
    SpeedProfile,
    parameter_scales,
    with_gradient,
)
from identify.design.options import RunEvaluator, RunOption

Progress = Callable[[str], None]


@dataclass(frozen=True)
class DesignSettings:
    """Numbers of the search for the run to make.

    Attributes:
        knots: Number of free speeds, evenly in time.
        starts: Number of descents, from the best peak speeds of the scan.
        steps: Steps of each descent.
        scan: Number of peak speeds scanned.
        slowest_peak: Lowest peak speed scanned, as a share of the highest [-].
        shortest_hold: Factor by which the ramp of a trapezoid is shorter than the limits allow, so
            that the peak is held, if not for long [-].
        plate_size: Plate size of the wheel while searching [m].
        skipped_end: Share of the run at its end that the search leaves out [-].
    """

    knots: int = 6
    starts: int = 2
    steps: int = 3
    scan: int = 7
    slowest_peak: float = 1 / 12
    shortest_hold: float = 1.01
    plate_size: float = 8e-3
    skipped_end: float = 0.08


@eqx.filter_jit
def _descend(
    start: Float[Array, " free"], objective: Objective, steps: int
) -> Float[Array, " free"]:
    solver = optx.BFGS(rtol=1e-3, atol=1e-3)
    function = lambda c, objective: with_gradient(objective, c)  # noqa: E731
    found = optx.minimise(function, solver, start, objective, max_steps=steps, throw=False)
    return found.value


def _rounded(trial: Trial) -> Trial:
    """Return the trial with a stress law whose derivatives have no jumps."""
    return eqx.tree_at(lambda t: t.simulator.terrain.law.corners, trial, Rounded())


def objective_of(
    judge: RunEvaluator, search: DesignSettings, duration: float | None = None
) -> Objective:
    """The standard error around the given set-up, on coarse plates with rounded corners.

    Args:
        judge: Of the parameter.
        search: Effort of the search.
        duration: Of the run [s]; all that the limits allow where none is given.
    """
    setup = copy.deepcopy(judge.base)
    setup.wheel.plate_size = max(search.plate_size, setup.wheel.plate_length)
    limit = judge.limits
    lasts = limit.duration if duration is None else duration
    turn = limit.travel / setup.wheel.radius
    profile = SpeedProfile(search.knots, limit.speed, limit.acceleration, lasts, limit.rest, turn)
    setup.command = CommandSetUp(profile.time.tolist(), np.zeros(search.knots + 4).tolist())
    setup.integrator.step = judge.step
    trial = _rounded(setup.trial())
    loads, depths = np.zeros(0), np.zeros(0)
    if limit.loads is not None:
        loads = np.array(limit.loads) / setup.rig.gravity
        depths = np.array([judge.extra_sinkage(each) for each in limit.loads])
    ends = np.asarray(step_times(trial.rows, ROW_INTERVAL))
    until = (lasts - limit.rest) * (1 - search.skipped_end)
    counts = np.concatenate([[1.0], ends <= until]).astype(float)
    scale = parameter_scales(trial, judge.quantities)
    weight = judge.instrument.weight()
    real = jnp.asarray
    return Objective(
        trial,
        profile,
        real(loads),
        real(depths),
        real(scale),
        real(weight),
        real(counts),
        tuple(judge.quantities),
    )


def local_optimum(
    judge: RunEvaluator, search: DesignSettings, starts: list[RunOption], report: Progress
) -> list[RunOption]:
    """Results of the descents that improved on their start, evaluated alike.

    Args:
        judge: Of the parameter.
        search: Effort of the search.
        starts: Where descents begin.
        report: Called with what is being done.
    """
    # Where the travel is limited, slower runs last longer.
    longest = max(each.setup.command.time[-1] for each in starts)
    objective = objective_of(judge, search, longest)
    profile = objective.profile
    points = []
    for each in starts:
        command = each.setup.command
        speeds = np.asarray(np.interp(profile.time[2:-2], command.time, command.omega))
        extra = [judge.base.start.angle]
        if judge.limits.loads is not None:
            low, high = judge.limits.loads
            share = np.clip((judge.load() - low) / (high - low), BOUND_MARGIN, 1 - BOUND_MARGIN)
            extra = [math.log(share / (1 - share)), *extra]
        points.append(np.concatenate([profile.coordinates(speeds), extra]))
    report(f"descending from {len(starts)} peak speeds, {search.steps} steps each")
    ends = [_descend(jnp.asarray(each), objective, search.steps) for each in points]
    options = []
    for start, end in zip(starts, map(np.asarray, ends), strict=True):
        if not np.isfinite(end).all():
            continue
        knots = profile.knots
        omega = np.asarray(profile.omega(jnp.asarray(end[:knots])))
        command = CommandSetUp(profile.time.tolist(), omega.tolist())
        chosen = {"angle": float(end[-1])}
        if judge.limits.loads is not None:
            low, high = judge.limits.loads
            chosen["load"] = low + (high - low) / (1 + math.exp(-end[knots]))
        name = f"descended from {start.name}"
        options.append(RunOption(name, judge.setup_for(command, **chosen), start.information, {}))
    return options
