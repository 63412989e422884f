"""Fit of the simulator's parameters to recorded runs, constant in time or by phase."""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from drftjax.common.errors import InputError
from drftjax.recorded.batch import Batch, device_mesh, make_batch
from drftjax.recorded.observation import white_noise
from drftjax.recorded.prepared_run import PreparedRun
from identify.compatible_runs import largest_compatible_set
from identify.parameters.bijector import Interval
from identify.parameters.parameter import Parameter
from identify.parameters.phase_zeta import PhaseZeta, has_phase_zeta, with_phases
from identify.results.findings import (
    FINDING_SETTINGS,
    FindingSettings,
    findings,
    step_doubts,
)
from identify.results.misfit import channel_floors, judged, misfit_sentences, overall
from identify.results.result import FitResult
from identify.results.values import RunFit, values_of
from identify.solver.batched_levenberg_marquardt import BatchedLevenbergMarquardt
from identify.solver.first_weights import MODEL_SHARES, with_model_shares
from identify.solver.initial_zeta import zeta_from_mean_sinkage
from identify.solver.levenberg_marquardt import Solution, solve
from identify.solver.multistart import best_start, require_starts
from identify.solver.problem import IN_PROCESS, AbstractEvaluator, Coordinates, Problem, predict
from identify.solver.settings import (
    BATCHED_SETTINGS,
    MULTISTART_SETTINGS,
    SOLVER_SETTINGS,
    BatchedSolverSettings,
    MultistartSettings,
    SolverSettings,
)
from identify.uncertainty.covariance import null_directions
from identify.uncertainty.derivative_check import (
    DERIVATIVE_CHECK_SETTINGS,
    DerivativeCheckSettings,
    derivative_doubts,
)
from identify.uncertainty.estimate import Estimate
from identify.uncertainty.height_zero import (
    HEIGHT_ZERO_SETTINGS,
    HeightZeroSettings,
    height_zero_sentences,
)
from identify.uncertainty.model_error import MISFIT_SETTINGS, MODEL_ERROR, MisfitSettings
from identify.uncertainty.noise_model import AbstractNoise, White
from identify.uncertainty.priors import (
    PRIOR_SETTINGS,
    PriorSettings,
    apply_priors,
    prior_conflicts,
)

WHITE = White()


@dataclass(frozen=True)
class FitSettings:
    """Decision numbers of a fit with constant parameters.

    Attributes:
        reweightings: Fits with the weights that the last fit's residuals give; two change the
            values no further than a small part of their errors.
        rough_gain: Gain of a step [residual variances] below which a fit has converged while its
            weights are not yet final: other weights move the minimum by more.
        odd_misfit: A run whose RMS residual is so many times that of most runs is weighted by its
            own: it was recorded or set up wrongly, and must not count as scatter of the others.
        farthest: Move of a bounded number's coordinate from its start beyond which it has no slope
            left to come back by.
        finest: Share of a channel's constant simulation error (`MODEL_ERROR`) below which no
            channel is weighted as finer, however fine its readings: the others tell as much then.
        finest_run: Smallest residual of a run; see `identify.solver.whitening.Whitening`.
        solver, short_steps, multistart, priors, derivatives: Numbers of these.
        findings: Numbers of the sentences on the result.
        misfit: Numbers that say from when on a model does not fit.
        height_zero: Numbers that say from when on zeta hangs on the zero of the height.
        model_shares: Shares of the channels' sizes by which they are first weighted, by channel.
    """

    reweightings: int = 2
    rough_gain: float = 10.0
    odd_misfit: float = 10.0
    farthest: float = 5.0
    finest: float = 0.2
    finest_run: float = 0.1
    solver: SolverSettings = SOLVER_SETTINGS
    short_steps: BatchedSolverSettings = BATCHED_SETTINGS
    multistart: MultistartSettings = MULTISTART_SETTINGS
    priors: PriorSettings = PRIOR_SETTINGS
    derivatives: DerivativeCheckSettings = DERIVATIVE_CHECK_SETTINGS
    findings: FindingSettings = FINDING_SETTINGS
    misfit: MisfitSettings = MISFIT_SETTINGS
    height_zero: HeightZeroSettings = HEIGHT_ZERO_SETTINGS
    model_shares: Mapping[str, float] = field(default_factory=lambda: MODEL_SHARES)


FIT_SETTINGS = FitSettings()


Progress = Callable[[str, int, float], None]


def fit(
    runs: Sequence[PreparedRun],
    parameters: Sequence[Parameter],
    progress: Progress | None = None,
    noise: AbstractNoise = WHITE,
    model_error: Mapping[str, float] = MODEL_ERROR,
    starts: int = 1,
    settings: FitSettings = FIT_SETTINGS,
    evaluator: AbstractEvaluator = IN_PROCESS,
) -> FitResult:
    """Fit `parameters` to all runs together, by weighted least squares.

    Residuals are weighted first by shares of each channel's size
    (`identify.solver.first_weights`), then by the RMS of each channel's residuals over all runs.

    Args:
        runs: Runs; those of another kind of wheel, law or carriage than most are left out.
        parameters: Fitted parameters, shared or one for each run.
        progress: Called with the stage, the solver's step and the sum of squares.
        noise: Model of the residuals.
        model_error: Standard deviation of a constant error of the simulation over a phase of the
            command, by channel [m, N, N m]; none where it is empty.
        starts: Starting points to try; the best is kept. See `identify.solver.multistart`.
        settings: Decision numbers.
        evaluator: Place where the runs are simulated; the result's own methods use this process.

    Raises:
        InputError: where no run is left, or two have the same name.
    """
    runs = with_phases(runs, parameters) if has_phase_zeta(parameters) else list(runs)
    problem, before, failures = _problem(
        runs, tuple(parameters), noise, settings.model_shares, evaluator
    )
    kept = [each for each in runs if each.name not in failures]
    coordinates, summary = zeta_from_mean_sinkage(problem, problem.start()), None
    report = progress or (lambda stage, step, loss: None)
    require_starts(starts)
    if starts > 1:
        coordinates, summary = best_start(
            problem,
            len(kept),
            starts,
            progress=lambda s, n: report(f"{starts} starts", s, n),
            settings=settings.multistart,
        )
    solution = solve(
        problem,
        coordinates,
        lambda s, v: report("fit", s, v),
        least_gain=settings.rough_gain,
        settings=settings.solver,
    )
    stuck = _stuck_at_bounds(problem, coordinates, solution.coordinates, settings.farthest)
    if solution.status != "converged" or any(stuck):
        solution = _in_short_steps(
            problem, len(kept), coordinates, solution, stuck, report, settings
        )
    problem = problem.without_step_error(solution.coordinates)
    before = before - np.asarray(problem.batch.observed.step_error)
    for turn in range(settings.reweightings):
        active, start = solution.active, solution.coordinates
        problem = _reweighted(problem, predict(problem, start), noise, active, settings)
        stage = f"reweighted fit {turn + 1} of {settings.reweightings}"
        solution = solve(
            problem,
            start,
            lambda s, v, stage=stage: report(stage, s, v),
            active,
            None if turn == settings.reweightings - 1 else settings.rough_gain,
            settings.solver,
        )
        stuck = _stuck_at_bounds(problem, start, solution.coordinates, settings.farthest)
        if any(stuck):
            solution = _in_short_steps(problem, len(kept), start, solution, stuck, report, settings)
    doubts = derivative_doubts(problem, solution, coordinates, kept, settings.derivatives)
    numbers = settings.finest_run, settings.misfit
    estimate = Estimate.of(problem, solution, tuple(kept), model_error, *numbers)
    if any(np.isfinite(each.prior_error) for each in problem.parameters):
        estimate = apply_priors(
            estimate, lambda s, size: report("fit with its priors", s, np.nan), settings.priors
        )
    result = _result(estimate, before, failures, doubts, settings)
    # What simulates the runs elsewhere may be gone when the result is asked for more.
    kept = replace(estimate, problem=replace(estimate.problem, evaluator=IN_PROCESS))
    return replace(result, starts=summary, estimate=kept)


def _in_short_steps(
    problem: Problem,
    runs: int,
    start: Coordinates,
    solution: Solution,
    stuck: list[bool],
    report: Progress,
    settings: FitSettings = FIT_SETTINGS,
) -> Solution:
    """Return the solution that short steps lead to.

    A long step may move a number that hardly bears on the runs to its bound, and leave it there.

    Args:
        problem: Runs and parameters.
        runs: Number of true runs.
        start: Coordinates that the solver started from.
        solution: Its end. From there short steps go on. Where a number is stuck they go from the
            start, with that number held first and then free, so that they come to no worse an end
            than without it; the better end counts.
        stuck: Numbers that are stuck, by `_stuck_at_bounds`.
        report: Called with the stage, the step and the sum of squares.
        settings: Decision numbers.
    """
    descent = BatchedLevenbergMarquardt(problem, runs, None, solution.active)
    point = descent.flat(start if any(stuck) else solution.coordinates)[None]

    def tell(step: int, _: int) -> None:
        report("short steps", step, np.nan)

    if any(stuck):
        shared, own = stuck[: descent.shared], stuck[descent.shared :]
        held = np.array([*shared, *own * runs])
        point = descent.run(point, held, progress=tell).points
    ends = descent.run(point, progress=tell)
    again = solve(
        problem,
        descent.coordinates(ends.points[0]),
        lambda s, v: report("fit again", s, v),
        solution.active,
        settings=settings.solver,
    )
    return again if not any(stuck) or again.loss < solution.loss else solution


def _stuck_at_bounds(
    problem: Problem, start: Coordinates, end: Coordinates, farthest: float
) -> list[bool]:
    """Return which bounded numbers were moved so near to a bound that they hardly move any more.

    Returns:
        For each shared number, then for each of the runs' own.
    """
    (shared, own), (shared_there, own_there) = start, end
    moved = np.abs(np.asarray(shared_there - shared)), np.abs(np.asarray(own_there - own)).max(0)
    return [
        isinstance(each.bijector, Interval) and bool(move > farthest)
        for each, move in zip(problem.shared + problem.own, np.concatenate(moved), strict=True)
    ]


def _problem(
    runs: list[PreparedRun],
    parameters: tuple[Parameter, ...],
    noise: AbstractNoise = WHITE,
    model_shares: Mapping[str, float] = MODEL_SHARES,
    evaluator: AbstractEvaluator = IN_PROCESS,
) -> tuple[Problem, np.ndarray, dict[str, str]]:
    """Return the problem of the runs that can be simulated at their own values.

    Returns:
        The problem; its prediction there, shape (runs, channels, samples); and the reason for each
        run that is left out.
    """
    runs, failures = _startable_runs(runs, parameters)
    while True:
        if not runs:
            named = "; ".join(f"{name}: {why}" for name, why in failures.items())
            raise InputError(f"no run is left to fit{f' ({named})' if named else ''}")
        batch = make_batch(
            [each.trial for each in runs],
            [with_model_shares(each.observation, model_shares) for each in runs],
            jax.device_count(),
        )
        white = noise.for_channels(len(batch.channels))
        scale = jnp.asarray(_prior_scale(runs, batch))
        problem = Problem(batch, parameters, white, device_mesh(), scale, evaluator)
        before = predict(problem, problem.start())
        fine = [bool(np.isfinite(run).all()) for run in before[: len(runs)]]
        if all(fine):
            return problem, before, failures
        for each, good in zip(runs, fine, strict=True):
            if not good:
                failures[each.name] = "its simulation diverges at the values it starts from"
        runs = [each for each, good in zip(runs, fine, strict=True) if good]


def _prior_scale(runs: list[PreparedRun], batch: Batch) -> float:
    """Return the least share of the weight by its noise that any channel is first given [-]."""
    given = np.asarray(batch.observed.weight).max(axis=2)
    return min(
        float(noise * given[run, batch.channels.index(channel)])
        for run, each in enumerate(runs)
        for channel, noise in zip(each.observation.channels, each.observation.noise, strict=True)
        if each.observation.counts.any()
    )


def _startable_runs(
    runs: list[PreparedRun], parameters: tuple[Parameter, ...]
) -> tuple[list[PreparedRun], dict[str, str]]:
    """Return the largest set of runs that one program fits, and why the others are left out."""
    failures: dict[str, str] = {}
    for each in runs:
        try:
            for parameter in parameters:
                parameter.require_start(each.trial)
        except InputError as problem:
            failures[each.name] = str(problem)
    kept, others = largest_compatible_set([each for each in runs if each.name not in failures])
    return kept, failures | others


def _reweighted(
    problem: Problem,
    simulated: np.ndarray,
    noise: AbstractNoise,
    active: np.ndarray,
    settings: FitSettings,
) -> Problem:
    """Return the problem weighted and whitened by the residuals of all runs, channel by channel."""
    weight = np.asarray(problem.batch.observed.weight)
    counts = (weight > 0) & active[:, None, None]
    raw = np.where(counts, simulated - np.asarray(problem.batch.observed.values), 0)
    intervals = np.asarray(problem.batch.observed.intervals)
    number = counts.sum(axis=2)
    each = np.sqrt((raw**2).sum(axis=2) / np.maximum(number, 1))
    # A channel that is fitted better than its instrument resolves must not outweigh the others.
    finest = np.array(
        [
            max(_lower_median(fast), settings.finest * MODEL_ERROR[channel])
            for channel, fast in zip(problem.batch.channels, _fast(raw, counts), strict=True)
        ]
    )
    usual = [_lower_median(e[n > 0]) for e, n in zip(each.T, number.T, strict=True)]
    odd = each > settings.odd_misfit * np.maximum(usual, finest)
    kept = np.where(odd, 0, number)
    pooled = np.sqrt((kept * each**2).sum(axis=0) / np.maximum(kept.sum(axis=0), 1))
    fresh = (weight > 0) / np.where(odd, each, np.maximum(pooled, finest))[:, :, None]
    problem = eqx.tree_at(
        lambda p: (p.batch.observed.weight, p.prior_scale),
        problem,
        (jnp.asarray(fresh), jnp.ones_like(problem.prior_scale)),
    )
    return replace(problem, noise=noise.fit(raw, counts, intervals))


def _fast(raw: np.ndarray, counts: np.ndarray) -> list[np.ndarray]:
    """Return the white noise of the residuals [m, N, N m], by channel and run that has some."""
    return [
        np.array(
            [
                white_noise(residual[here])
                for residual, here in zip(raw[:, channel], counts[:, channel], strict=True)
                if here.any()
            ]
        )
        for channel in range(raw.shape[1])
    ]


def _lower_median(values: np.ndarray) -> float:
    return float(np.sort(values)[(len(values) - 1) // 2]) if len(values) else 0.0


def _result(
    estimate: Estimate,
    before: np.ndarray,
    failures: dict[str, str],
    doubts: list[str],
    settings: FitSettings,
) -> FitResult:
    """Return the result of a fit, with its findings and doubts of its derivatives."""
    problem, solution = estimate.problem, estimate.solution
    error = np.sqrt(np.diag(estimate.covariance))
    shared_coordinates, own_coordinates = solution.coordinates
    own_error = error[estimate.shared :].reshape(own_coordinates.shape)
    own_error = np.where(solution.active[:, None], own_error, np.inf)
    shared = values_of(problem.shared, shared_coordinates, error[: estimate.shared])
    after = predict(problem, solution.coordinates)
    recorded = np.asarray(problem.batch.observed.values)
    states = run_states(estimate, settings.solver.negligible)
    fits = []
    for index, each in enumerate(estimate.runs):
        own = values_of(problem.own, own_coordinates[index], own_error[index])
        status = states[index]
        if status != "diverged" and any(value.at_bound for value in own.values()):
            status = "at a bound"
        setup = copy.deepcopy(each.setup)
        for parameter in problem.parameters:
            name = parameter.quantity.name
            parameter.quantity.record(setup, (shared | own)[name].value)
        if isinstance(each.trial.simulator.terrain.zeta, PhaseZeta):
            fitted = problem.trial_at(each.trial, shared_coordinates, own_coordinates[index])
            setup.terrain.zeta = fitted.simulator.terrain.zeta.knots()  # pyright: ignore
        length = len(each.observation.time)
        channels = each.observation.channels
        picked = [problem.batch.channels.index(channel) for channel in channels]
        fits.append(
            RunFit(
                name=each.name,
                setup=setup,
                values=own,
                time=each.observation.time,
                counts=each.observation.counts,
                channels=channels,
                recorded=recorded[index, picked, :length],
                before=before[index, picked, :length],
                after=after[index, picked, :length],
                status=status,
                believed=(each.setup.wheel, each.setup.rig),
            )
        )
    floors = channel_floors([each for each in fits if each.status != "diverged"])
    fits = judged(fits, floors, settings.misfit)
    size = len(estimate.coordinate_parameters)
    spread = estimate.covariance[:size, :size]
    hidden = null_directions(solution.blocks, estimate.shared, solution.prior_slope)[:size]
    alone = np.sqrt(estimate.run_variance) * np.abs(estimate.slopes[: estimate.shared])
    scatter = {
        each.quantity.name: float(size) for each, size in zip(problem.shared, alone, strict=True)
    }
    return FitResult(
        shared=shared,
        runs=fits,
        status=overall(solution.status, fits),
        steps=solution.steps,
        failures=failures,
        findings=[
            *misfit_sentences(fits, floors, settings.misfit),
            *findings(problem.parameters, shared, fits, spread, hidden, scatter, settings.findings),
            *prior_conflicts(estimate, settings.priors),
            *height_zero_sentences(estimate, settings.height_zero),
            *step_doubts(estimate.runs),
            *doubts,
        ],
        labels=estimate.labels,
        covariance=estimate.covariance_of_values,
        estimate=estimate,
        floors=floors,
    )


def run_states(estimate: Estimate, negligible: float = SolverSettings.negligible) -> list[str]:
    """Return the state of each run: "converged", "stalled" or "diverged".

    A run has stalled where the linearisation still promises to lower its own sum of squares by more
    than a negligible share, moving its own parameters by more than their errors.

    Args:
        estimate: Of the fit.
        negligible: Share of a run's sum of squares that is not worth a warning.
    """
    solution = estimate.solution
    _, own = map(np.asarray, solution.coordinates)
    counted = (estimate.whitening.scale > 0).sum(axis=(1, 2))
    priors = solution.prior_residual[estimate.shared :].reshape(own.shape)
    slopes = solution.prior_slope[estimate.shared :].reshape(own.shape)
    states = []
    for run in range(len(estimate.runs)):
        if not solution.active[run]:
            states.append("diverged")
            continue
        if estimate.slope_rescaling is not None or not estimate.own:
            states.append("converged" if solution.status == "converged" else "stalled")
            continue
        rows = solution.blocks[run][..., estimate.shared :].reshape(-1, estimate.own)
        residual = solution.residual[run].ravel()
        information = rows.T @ rows + np.diag(slopes[run] ** 2)
        slope = rows.T @ residual + slopes[run] * priors[run]
        gain = float(slope @ np.linalg.lstsq(information, slope, rcond=None)[0])
        noticeable = max(negligible, 1 / max(int(counted[run]), 1)) * float(residual @ residual)
        states.append("stalled" if gain > noticeable else "converged")
    return states
