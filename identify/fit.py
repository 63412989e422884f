"""Fit numbers of the simulator to recorded runs."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from drftjax.errors import InputError
from drftjax.integrator import steady_step
from drftjax.runlog.record import RunLog
from drftjax.saved import thinned
from drftjax.setup import SetUp, setup_from_run
from drftjax.trial import Trial
from identify.batch import OTHER_KIND, Problem, alike, device_mesh, make_batch
from identify.findings import findings
from identify.noise import AbstractNoise, White
from identify.observation import Observation, observe
from identify.parameter import Parameter
from identify.result import FitResult, RunFit, Value
from identify.solve import Coordinates, Solution, solve
from identify.uncertainty import covariance

# Fits step with the method that keeps its derivatives bounded at rest; docs/integrator.md.
FIT_METHOD = "held pace"
STEPS_A_ROW = 5

# Recorded sinkage and travel are averaged over this long for the start [s].
START_WINDOW = 0.2

# Fits with the weights that the last fit's residuals give; two change the values no further than
# a small part of their errors.
REWEIGHTINGS = 2

WHITE = White()

# How far the simulation may be off by a constant over a phase of the command [m, N, N m]: what its
# plates and step leave open in sinkage (docs/integrator.md), and the same share of the rest.
MODEL_ERROR = {"x": 5e-5, "z": 2e-5, "fx": 0.1, "fz": 0.1, "torque": 0.01}

Progress = Callable[[str, int, float], None]


@dataclass(frozen=True)
class Candidate:
    """A run on its way into a fit.

    Attributes:
        name: The run, as reports call it.
        setup: Its set-up and commands.
        trial: What is simulated.
        observation: What was recorded.
    """

    name: str
    setup: SetUp
    trial: Trial
    observation: Observation


def candidate(
    name: str,
    run: RunLog,
    *,
    zeta: float | None = None,
    method: str = FIT_METHOD,
    step: float | None = None,
    keep_rest: bool = False,
) -> Candidate:
    """A recorded run made ready: its set-up as believed, its start as recorded.

    Args:
        name: The run, as reports call it.
        run: What was recorded.
        zeta: Scaling factor to start from [-]; the set-up's where none is given.
        method: Integrator.
        step: Its step [s]; where none is given, the longest that the command allows.
        keep_rest: See `observe`.

    Raises:
        InputError: where the run cannot be simulated or compared.
    """
    try:
        observation = observe(run, keep_rest=keep_rest)
        setup = setup_from_run(run)
        setup.integrator.method = method  # pyright: ignore[reportAttributeAccessIssue]
        setup.integrator.step = (
            steady_step(setup.wheel.radius, run.command.time, run.command.omega)
            if step is None
            else step
        )
        early = observation.time <= max(START_WINDOW, observation.time[0])
        if run.measured.z is not None and early.sum() > 1:
            setup.start.sinkage = float(-run.measured.z[early].mean())
        if run.measured.x is not None and run.command.vx is None:
            setup.start.x = float(run.measured.x[early].mean())
        if zeta is not None:
            setup.terrain.zeta = zeta
        trial = setup.trial(STEPS_A_ROW * setup.integrator.step)
        return Candidate(name, setup, trial, observation)
    except InputError as problem:
        raise InputError(f"{name}: {problem}") from None


def fit(
    candidates: Sequence[Candidate],
    parameters: Sequence[Parameter],
    progress: Progress | None = None,
    noise: AbstractNoise = WHITE,
) -> FitResult:
    """Fit `parameters` to all runs together.

    Residuals are weighted first by each instrument's white noise; then, as the model's own error
    is mostly far larger, by what each channel's residuals were over all runs.

    Args:
        candidates: Runs; those of another kind of wheel, law or carriage than most are left out.
        parameters: What to fit, shared or for each run.
        progress: Called with the stage, the solver's step and the sum of squares.
        noise: How residuals scatter.

    Raises:
        InputError: where no run is left, or two have the same name.
    """
    problem, before, failures = _problem(list(candidates), tuple(parameters))
    kept = [each for each in candidates if each.name not in failures]
    coordinates = problem.start()
    report = progress or (lambda stage, step, loss: None)
    solution = solve(problem, coordinates, lambda s, v: report("fit", s, v))
    for turn in range(REWEIGHTINGS):
        problem = _reweighted(problem, _predicted(problem, solution.coordinates), noise)
        stage = f"reweighted fit {turn + 1} of {REWEIGHTINGS}"
        solution = solve(
            problem, solution.coordinates, lambda s, v, stage=stage: report(stage, s, v)
        )
    return _result(kept, problem, solution, before, failures)


def _problem(
    candidates: list[Candidate], parameters: tuple[Parameter, ...]
) -> tuple[Problem, np.ndarray, dict[str, str]]:
    """The batch of runs that the set-up's own values can simulate, what they give, and the rest."""
    candidates, failures = _of_one_kind(candidates, parameters)
    while True:
        if not candidates:
            named = "; ".join(f"{name}: {why}" for name, why in failures.items())
            raise InputError(f"no run is left to fit{f' ({named})' if named else ''}")
        batch = make_batch(
            [each.trial for each in candidates],
            [each.observation for each in candidates],
            jax.device_count(),
        )
        white = jnp.zeros(len(batch.channels))
        problem = Problem(batch, parameters, white, device_mesh())
        before = _predicted(problem, problem.start())
        fine = [bool(np.isfinite(run).all()) for run in before[: len(candidates)]]
        if all(fine):
            return problem, before, failures
        for each, good in zip(candidates, fine, strict=True):
            if not good:
                failures[each.name] = "its simulation diverges at the values it starts from"
        candidates = [each for each, good in zip(candidates, fine, strict=True) if good]


def _of_one_kind(
    candidates: list[Candidate], parameters: tuple[Parameter, ...]
) -> tuple[list[Candidate], dict[str, str]]:
    """The largest set of runs that one program fits, and why the others are left out."""
    names = [each.name for each in candidates]
    if len(set(names)) < len(names):
        raise InputError(f"two runs have one name among {', '.join(names)}; names must differ")
    failures: dict[str, str] = {}
    kinds: list[list[Candidate]] = []
    for each in candidates:
        try:
            for parameter in parameters:
                _require_start(parameter, each.trial)
        except InputError as problem:
            failures[each.name] = str(problem)
            continue
        for kind in kinds:
            if alike(each.trial, kind[0].trial):
                kind.append(each)
                break
        else:
            kinds.append([each])
    largest = max(kinds, key=len, default=[])
    for each in (each for kind in kinds if kind is not largest for each in kind):
        failures[each.name] = f"it {OTHER_KIND} than {largest[0].name}; fit it apart"
    return largest, failures


def _require_start(parameter: Parameter, trial: Trial) -> None:
    if not np.isfinite(parameter.coordinate(trial)):
        quantity = parameter.quantity
        value = float(quantity.read(trial))
        raise InputError(f"its {quantity.name} is {value:g}, where no fit within its bounds starts")


@eqx.filter_jit
def _predicted_jit(problem: Problem, coordinates: Coordinates) -> jax.Array:
    return problem.predicted(*coordinates)


def _predicted(problem: Problem, coordinates: Coordinates) -> np.ndarray:
    return np.asarray(_predicted_jit(problem, coordinates))


def _reweighted(problem: Problem, predicted: np.ndarray, noise: AbstractNoise) -> Problem:
    """The problem with each channel weighed, and whitened, by its residuals over all runs."""
    weight = np.asarray(problem.batch.observed.weight)
    counts = weight > 0
    raw = np.where(counts, predicted - np.asarray(problem.batch.observed.values), 0)
    power = (raw**2).sum(axis=(0, 2)) / np.maximum(counts.sum(axis=(0, 2)), 1)
    # A channel that is met better than its instrument can tell must not rule the others.
    finest = 1 / weight.max(axis=(0, 2))
    fresh = counts / np.maximum(np.sqrt(power), finest)[:, None]
    return eqx.tree_at(
        lambda p: (p.batch.observed.weight, p.correlation),
        problem,
        (jnp.asarray(fresh), jnp.asarray(noise.correlation(raw, counts))),
    )


def _result(
    candidates: list[Candidate],
    problem: Problem,
    solution: Solution,
    before: np.ndarray,
    failures: dict[str, str],
) -> FitResult:
    counts = np.asarray(problem.batch.observed.weight) > 0
    spread = covariance(
        solution.residual,
        solution.blocks,
        counts,
        len(problem.shared),
        solution.belief_slope,
        _offset(problem),
        _phases(candidates, counts),
    )
    error = np.sqrt(np.diag(spread))
    shared_coordinates, own_coordinates = solution.coordinates
    shared_count = len(problem.shared)
    own_error = error[shared_count:].reshape(own_coordinates.shape)
    shared = _values(problem.shared, shared_coordinates, error[:shared_count])
    after = _predicted(problem, solution.coordinates)
    recorded = np.asarray(problem.batch.observed.values)

    runs = []
    for index, each in enumerate(candidates):
        own = _values(problem.own, own_coordinates[index], own_error[index])
        setup = copy.deepcopy(each.setup)
        for parameter in problem.parameters:
            name = parameter.quantity.name
            parameter.quantity.record(setup, (shared | own)[name].value)
        length = len(each.observation.time)
        channels = each.observation.channels
        picked = [problem.batch.channels.index(channel) for channel in channels]
        runs.append(
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
            )
        )
    ends = [*zip(problem.shared, shared_coordinates, strict=True)]
    ends += [*zip(problem.own, own_coordinates[: len(runs)].T, strict=True)]
    bounded = [p.quantity.label for p, at in ends if np.any(p.near_bound(at))]
    return FitResult(
        shared=shared,
        runs=runs,
        status=solution.status,
        steps=solution.steps,
        failures=failures,
        findings=findings(problem.parameters, shared, runs, spread, bounded),
    )


def _offset(problem: Problem) -> np.ndarray:
    """Weighted residual that the simulation's own error makes, held over a phase."""
    error = np.array([MODEL_ERROR[channel] for channel in problem.batch.channels])[:, None]
    carried = np.asarray(problem.correlation)[:, None]
    whitened = (1 - carried) / np.sqrt(1 - carried**2)
    return np.asarray(problem.batch.observed.weight) * error * whitened


def _phases(candidates: list[Candidate], counts: np.ndarray) -> np.ndarray:
    """Number of the phase of the command (a straight piece of it) that each sample falls in."""
    phases = np.zeros((counts.shape[0], counts.shape[2]), int)
    for index, each in enumerate(candidates):
        knots = np.asarray(thinned(each.setup.command).time)
        time = each.observation.time + knots[0]
        phases[index, : len(time)] = np.searchsorted(knots, time, side="right")
    return phases


def _values(
    parameters: tuple[Parameter, ...], coordinates: jax.Array, errors: np.ndarray
) -> dict[str, Value]:
    """Values and standard errors by name; an error is carried over by the bijector's slope."""
    values = {}
    for parameter, coordinate, error in zip(parameters, coordinates, errors, strict=True):
        quantity = parameter.quantity
        values[quantity.name] = Value(
            value=float(parameter.bijector.value(coordinate)),
            error=float(abs(parameter.bijector.slope(coordinate)) * error),
            unit=quantity.unit,
            label=quantity.label,
        )
    return values
