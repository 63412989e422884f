"""Prepared runs: recorded runs made ready for simulation and comparison.

`prepare_run` takes four steps: `drop_refused` takes out the readings that the loop refused,
`setup_for` gives the set-up, `observe` the channels that are compared, `start_state` the start.
"""

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from drftjax.common.arrays import as_real
from drftjax.common.errors import InputError, RunError
from drftjax.recorded.observation import (
    DEFAULT_OBSERVATION,
    Observation,
    ObservationSettings,
    observe,
)
from drftjax.recorded.refused_readings import drop_refused
from drftjax.recorded.start_state import (
    DEFAULT_START,
    StartSettings,
    settles_at_first,
    start_state,
)
from drftjax.recorded.wheel_speed import WheelSpeed, measured_wheel_speed
from drftjax.runlog.hdf5.api import read_run
from drftjax.runlog.plausibility import require_upright
from drftjax.runlog.record import CHANNELS, RunLog
from drftjax.setups.chosen_step import choose_setup_step
from drftjax.setups.from_run import setup_from_run
from drftjax.setups.setup import CommandSetUp, SetUp, add_fitted_effects
from drftjax.setups.terrain_setup import ZetaKnots
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.statics import zeta_from_sinkage
from drftjax.simulation.step_choice import StepChoice, StepSettings
from drftjax.simulation.trial import Trial

# For a run that is compared with a recording: its step's error is taken off, so it may be larger;
# of what it is taken for, a twentieth is left (docs/theory/integrator.md).
RECORDED_STEPS = StepSettings(sinkage=1e-4, sinkage_of_radius=6e-4, travel=2e-3)


@dataclass(frozen=True)
class PreparedRun:
    """Recorded run with set-up, start and observation, ready to be simulated and compared.

    Attributes:
        name: The run, as reports call it.
        setup: Its set-up and commands, the start as recorded.
        trial: Simulator, start and command, built from the set-up.
        observation: Recorded channels that a simulation is compared with.
        made_in_loop: The run log itself where it was made in the loop; None for others.
        step_choice: The step that was chosen for it, and its estimated error; None where one was
            given.
        wheel_speed: Measured speed of its wheel; None where there is none.
        rest_left_out: Rest before it sets off that was left out [s].
    """

    name: str
    setup: SetUp
    trial: Trial
    observation: Observation
    made_in_loop: RunLog | None = None
    step_choice: StepChoice | None = None
    wheel_speed: WheelSpeed | None = None
    rest_left_out: float = 0.0


def prepare_run(
    name: str,
    run: RunLog,
    *,
    model: SetUp | None = None,
    fitted: Sequence[str] = (),
    zeta: float | None = None,
    step: float | None = None,
    keep_rest: bool = False,
    compare: Sequence[str] = CHANNELS,
    carriage_forces: bool = False,
    start_settings: StartSettings = DEFAULT_START,
    settings: ObservationSettings = DEFAULT_OBSERVATION,
) -> PreparedRun:
    """Make a recorded run ready for simulation and comparison.

    Args:
        name: The run, as reports call it.
        run: Recorded run.
        model, fitted, zeta, step: See `setup_for`.
        keep_rest, compare, carriage_forces: See `observe`.
        start_settings: Which samples give the start, and by which curve.
        settings: Which samples are compared, and how noisy they are at least.

    Raises:
        RunError: the run cannot be simulated or compared.
    """
    made_in_loop = None if run.online is None else run
    try:
        run = drop_refused(run)
        require_upright(run)
        setup = setup_for(run, model, fitted=fitted, zeta=zeta, step=step)
        observation = observe(
            run,
            setup.wheel.radius,
            keep_rest=keep_rest,
            compare=compare,
            carriage_forces=carriage_forces,
            settings=settings,
        )
        setup.start = start_state(run, setup, start_settings, settings)
        choice = None
        if setup.integrator.step is None:
            settles = settles_at_first(run, setup.wheel.radius, start_settings, settings)
            held = setup if settles else standing_setup(setup)
            choice = choose_setup_step(held, RECORDED_STEPS)
            setup.integrator.step = held.integrator.step
        # A row for every step, so that runs of any step share one program.
        trial = setup.trial(interval=0)
        return PreparedRun(
            name, setup, trial, observation, made_in_loop, choice, measured_wheel_speed(run)
        )
    except InputError as problem:
        raise RunError(name, str(problem)) from None


def standing_setup(setup: SetUp) -> SetUp:
    """The set-up with the zeta at which the sand carries the wheel where the run starts.

    The zeta of a run log may be a guess. Where it is too low the wheel falls first, which takes
    steps a quarter to a sixteenth as long; every comparison moves zeta to what the run shows.

    Args:
        setup: Of a recorded run, with the start as recorded; not changed.

    Returns:
        The same where no zeta carries the wheel there, or zeta changes over time.
    """
    standing = copy.deepcopy(setup)
    if not isinstance(setup.terrain.zeta, ZetaKnots):
        start = as_real(setup.start.sinkage), as_real(setup.start.angle)
        carrying = float(_zeta_at(setup.trial().simulator, *start))
        if setup.start.sinkage > 0 and 0 < carrying < np.inf:
            standing.terrain.zeta = carrying
    return standing


@eqx.filter_jit
def _zeta_at(
    simulator: Simulator, sinkage: Float[Array, ""], angle: Float[Array, ""]
) -> Float[Array, ""]:
    return zeta_from_sinkage(simulator, sinkage, angle=angle)


def setup_for(
    run: RunLog,
    model: SetUp | None = None,
    *,
    fitted: Sequence[str] = (),
    zeta: float | None = None,
    step: float | None = None,
) -> SetUp:
    """Set-up that a recorded run is simulated with.

    Args:
        run: Recorded run, for its command, and for its set-up where no model is given.
        model: Wheel, sand, rig and effects in place of those that the run log names; not changed.
        fitted: Names of parameters to be fitted: effects whose numbers are among them are added.
        zeta: Scaling factor to start from [-]; the set-up's where none is given.
        step: Integrator step [s]; where neither this nor the model gives one, `prepare_run` chooses
            one for the run.

    Raises:
        InputError: names what the run log lacks.
    """
    setup = setup_from_run(run) if model is None else _under_command(model, run)
    add_fitted_effects(setup, fitted)
    if step is not None:
        setup.integrator.step = step
    if zeta is not None:
        setup.terrain.zeta = zeta
    return setup


def _under_command(model: SetUp, run: RunLog) -> SetUp:
    """A copy of the model under a recorded run's command, with the carriage that the run had."""
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
    """Make runs ready, each with a name of its own.

    Args:
        runs: Files, run logs, pairs of a model and a run log, or prepared runs: one, several, or
            several by name. Run logs without a name go by their number.
        model: Wheel, sand and rig of all runs that do not bring their own; each run log's where
            none is given.
        options: See `prepare_run`.

    Raises:
        InputError: names the run, and what must hold.
    """
    return [as_prepared(name, each, model, **options) for name, each in named_runs(runs).items()]


def named_runs(runs: Run | Sequence[Run] | Mapping[str, Run]) -> dict[str, object]:
    """Runs by their names.

    Args:
        runs: As `prepare_runs` takes them.

    Raises:
        InputError: two runs have one name.
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
    """Make one run ready.

    Args:
        name: The run, as reports call it.
        run: File, run log, pair of a model and a run log, or prepared run.
        model: Wheel, sand and rig of a run that does not bring its own.
        options: See `prepare_run`.

    Raises:
        RunError: the run cannot be used.
        InputError: the object is no run.
    """
    if isinstance(run, PreparedRun):
        return replace(
            run, observation=run.observation.select_channels(options.get("compare", CHANNELS))
        )
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
    """Names of runs by their files: the stem, with its folder where two are the same, numbered.

    Args:
        paths: Files.

    Returns:
        One name for each file; no two are the same.
    """
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
