"""Runs on their way into a fit: from files, run logs and set-ups to what can be simulated."""

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from drftjax.common.errors import InputError, RunError
from drftjax.physics.integrator import steady_step
from drftjax.recorded.observation import (
    ROUNDING,
    SMALLEST_NOISE,
    Observation,
    drop_refused,
    observe,
    white_noise,
)
from drftjax.runlog.hdf5.api import read_run
from drftjax.runlog.plausibility import require_upright
from drftjax.runlog.record import CHANNELS, Measured, RunLog
from drftjax.setups.from_run import setup_from_run
from drftjax.setups.setup import CommandSetUp, SetUp, put_effects
from drftjax.simulation.trial import Trial

# Fits step with the method that keeps its derivatives bounded at rest; docs/integrator.md.
FIT_METHOD = "held pace"


STEPS_A_ROW = 5


# Recorded sinkage and travel are averaged over so much of the rest before the run [s]. A wheel
# creeps into the sand: where it stands for longer, a straight line tells its sinkage at the start.
START_WINDOW, CREEP_WINDOW = 0.2, 0.5


# Fewer samples make no line that tells it better than their mean.
LEAST_SAMPLES = 10


# Where the curvature of its creep is so many standard errors, a parabola does; noise that lasts
# over a few samples makes four.
CURVED = 6.0


# A wheel still settles where a straight line through that rises by more than so many standard
# errors (instruments' slow errors reach ten), and by more than so much in that time [m].
SETTLING, SETTLED = 30.0, 2e-4


# What a measured or rounded command moves by while the wheel rests [m]: less than scales tell.
STILL = 1e-5


@dataclass(frozen=True)
class PreparedRun:
    """A run on its way into a fit.

    Attributes:
        name: The run, as reports call it.
        setup: Its set-up and commands.
        trial: What is simulated.
        observation: What was recorded.
        made_in_loop: The run log itself where it was made in the loop; None for others.
    """

    name: str
    setup: SetUp
    trial: Trial
    observation: Observation
    made_in_loop: RunLog | None = None


def prepare_run(
    name: str,
    run: RunLog,
    *,
    model: SetUp | None = None,
    fitted: Sequence[str] = (),
    zeta: float | None = None,
    method: str = FIT_METHOD,
    step: float | None = None,
    keep_rest: bool = False,
    compare: Sequence[str] = CHANNELS,
) -> PreparedRun:
    """A recorded run made ready: its set-up as believed, its start as recorded.

    Args:
        name: The run, as reports call it.
        run: What was recorded.
        model: Wheel, sand, rig and effects in place of what the run log believes of them.
        fitted: Names of what will be fitted: effects whose numbers are among them are added.
        zeta: Scaling factor to start from [-]; the set-up's where none is given.
        method: Integrator.
        step: Its step [s]; where none is given, the longest that the command allows.
        keep_rest, compare: See `observe`.

    Raises:
        InputError: where the run cannot be simulated or compared.
    """
    made_in_loop = None if run.online is None else run
    try:
        run = drop_refused(run)
        require_upright(run)
        setup = setup_from_run(run) if model is None else _commanded(model, run)
        observation = observe(run, setup.wheel.radius, keep_rest=keep_rest, compare=compare)
        put_effects(setup, fitted)
        setup.integrator.method = method  # pyright: ignore[reportAttributeAccessIssue]
        setup.integrator.step = (
            steady_step(setup.wheel.radius, run.command.time, run.command.omega)
            if step is None
            else step
        )
        # Of a wheel that sets off sooner, no more than its rest tells the start.
        window = min(START_WINDOW, _sets_off(run, setup.wheel.radius) + ROUNDING)
        begun = observation.begun
        first = observation.time[begun][0]
        early = begun & (observation.time <= max(window, first))
        told = early.sum() > 1 or window < START_WINDOW
        if _settles(observation.time, run.measured, early):
            early = observation.time == first
        if run.measured.z is not None and told:
            height = float(run.measured.z[early].mean())
            creeping = begun & (observation.time <= CREEP_WINDOW)
            stands = _sets_off(run, setup.wheel.radius) >= CREEP_WINDOW
            if stands and early.sum() > 1 and creeping.sum() >= LEAST_SAMPLES:
                height = _crept_from(observation.time[creeping], run.measured.z[creeping])
            setup.start.sinkage = -height
        if run.measured.x is not None and told:
            setup.start.x = float(run.measured.x[early].mean())
        if zeta is not None:
            setup.terrain.zeta = zeta
        trial = setup.trial(STEPS_A_ROW * setup.integrator.step)
        return PreparedRun(name, setup, trial, observation, made_in_loop)
    except InputError as problem:
        raise RunError(name, str(problem)) from None


def _sets_off(run: RunLog, radius: float) -> float:
    """Time from the run's start up to which neither wheel nor carriage is asked to move [s]."""
    command = run.command
    speeds = np.stack(
        [radius * command.omega, 0 * command.omega if command.vx is None else command.vx]
    )
    steps = np.diff(command.time) * (speeds[:, 1:] + speeds[:, :-1]) / 2
    gone = np.abs(np.cumsum(steps, axis=1)).max(axis=0) > STILL
    last = int(np.argmax(gone)) if gone.any() else len(gone)
    return float(command.time[last] - command.time[0])


def _settles(time: np.ndarray, measured: Measured, early: np.ndarray) -> bool:
    """Whether the wheel moves by more than its instruments' noise in these samples."""
    if early.sum() < 3:
        return False
    time = time[early] - time[early].mean()
    spread = time @ time
    for name in ("x", "z"):
        values = getattr(measured, name)
        if values is None:
            continue
        noise = max(white_noise(values), SMALLEST_NOISE[name])
        slope = abs(time @ values[early]) / spread
        if slope > max(SETTLING * noise / np.sqrt(spread), SETTLED / np.ptp(time)):
            return True
    return False


def _crept_from(time: np.ndarray, height: np.ndarray) -> float:
    """Height at the first of these times of a wheel that creeps [m].

    Args:
        time, height: What was recorded while it stood [s, m], shape (samples,).
    """
    powers = np.vander(time - time[0], 3)
    (curvature, _, at_first), square, *_ = np.linalg.lstsq(powers, height)
    noise = max(float(np.sqrt(square.sum() / (len(time) - 3))), SMALLEST_NOISE["z"])
    error = noise * np.sqrt(np.linalg.inv(powers.T @ powers)[0, 0])
    if abs(curvature) < CURVED * error:
        at_first = np.polyfit(powers[:, 1], height, 1)[1]
    return float(at_first)


def _commanded(model: SetUp, run: RunLog) -> SetUp:
    """A model under a recorded run's command, with the carriage that the run had."""
    setup = copy.deepcopy(model)
    command = run.command
    vx = None if command.vx is None else command.vx.tolist()
    setup.command = CommandSetUp(command.time.tolist(), command.omega.tolist(), vx)
    setup.rig.carriage = "free" if vx is None else "driven"
    setup.title = run.title
    return setup


Run: TypeAlias = str | Path | RunLog | tuple[SetUp, RunLog] | PreparedRun


def prepare_runs(
    runs: Run | Sequence[Run] | Mapping[str, Run], model: SetUp | None = None, **options
) -> list[PreparedRun]:
    """Runs made ready, each with a name of its own.

    Args:
        runs: Files, run logs, pairs of a model and a run log, or candidates: one, several, or
            several by name. Run logs without a name go by their number.
        model: Wheel, sand and rig of all runs that do not bring their own; each run log's where
            none is given.
        options: See `candidate`.

    Raises:
        InputError: names the run, and what must hold.
    """
    return [as_prepared(name, each, model, **options) for name, each in named_runs(runs).items()]


def named_runs(runs: Run | Sequence[Run] | Mapping[str, Run]) -> dict[str, object]:
    """Runs as `candidates_of` takes them, by their names.

    Raises:
        InputError: where two have one name.
    """
    if isinstance(runs, Mapping):
        named: dict[str, object] = dict(runs)
    else:
        alone = isinstance(runs, str) or not isinstance(runs, Iterable) or _is_pair(runs)
        several: list[object] = [runs] if alone else list(runs)  # pyright: ignore
        stems = iter(names_of([Path(r) for r in several if isinstance(r, str | Path)]))
        names = [
            next(stems)
            if isinstance(each, str | Path)
            else each.name
            if isinstance(each, PreparedRun)
            else f"run {number}"
            for number, each in enumerate(several, start=1)
        ]
        if len(set(names)) < len(names):
            raise InputError(f"two runs have one name among {', '.join(names)}; names must differ")
        named = dict(zip(names, several, strict=True))
    return named


def _is_pair(run: object) -> bool:
    return isinstance(run, tuple) and len(run) == 2 and isinstance(run[0], SetUp)


def as_prepared(name: str, run: object, model: SetUp | None = None, **options: Any) -> PreparedRun:
    """One run made ready; see `candidates_of`.

    Raises:
        RunError: where it cannot be used.
        InputError: for what is no run.
    """
    if isinstance(run, PreparedRun):
        return replace(run, observation=run.observation.of(options.get("compare", CHANNELS)))
    if _is_pair(run):
        model, run = run  # pyright: ignore[reportGeneralTypeIssues]
    if isinstance(run, str | Path):
        run = read_run(run)
    if not isinstance(run, RunLog):
        raise InputError(
            f"{name} is {type(run).__name__}; a run is a file, a RunLog, or a SetUp with a RunLog"
        )
    return prepare_run(name, run, model=model, **options)


def names_of(paths: list[Path]) -> list[str]:
    """Each run's file stem, with its folder where two are the same, then numbered."""
    stems = [path.stem for path in paths]
    names: list[str] = []
    for path in paths:
        several = stems.count(path.stem) > 1
        wanted = "_".join(path.with_suffix("").parts[-2:]) if several else path.stem
        # A name becomes a group of an HDF5 file.
        wanted = wanted.replace("/", "").strip(".") or "run"
        name, number = wanted, 1
        while name in names:
            number += 1
            name = f"{wanted}_{number}"
        names.append(name)
    return names
