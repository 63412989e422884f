"""The runs of one rig, padded to common sizes, and the zeta that each one starts from."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diagnose.model.augmented_model import (
    MAX_COVERED_SHARE,
    REFERENCE,
    AugmentedModel,
    Directions,
    predict,
    predict_with_jacobian,
    program_within,
    slopes,
)
from diagnose.model.carriage_hold import CarriageHold
from diagnose.run_pool import RunPool
from diagnose.setting_off import from_setting_off
from drftjax.common.arrays import as_real
from drftjax.common.errors import InputError, RunError
from drftjax.physics.wheel import DEFAULT_REACH
from drftjax.recorded.batch import Batch, PaddedObservations, make_batch
from drftjax.recorded.matched_zeta import ZetaMatchSettings, match_mean_sinkage
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.simulation.step_error import parts_within_turn, step_error
from drftjax.simulation.trial import Trial

Result = TypeVar("Result")

PLAIN_SECTORS = 32  # of a bare rim, of which those that reach the sand are carried
MIN_PADDED_SIZE = 2304  # of all lengths [samples]; padding costs next to nothing


@dataclass(frozen=True)
class DatasetSettings:
    """Numbers by which recorded runs are prepared for a diagnosis.

    Attributes:
        max_sample_rate: Samples per second that are kept at most [Hz]. Evidence counts by the
            sample where it is fast, as on runs at this rate; what a model leaves is no newer for
            being read more often.
        plate_margin: Plates are carried for a wheel that sinks this many times as deep as was
            recorded [-], so that a model with effects may sink somewhat deeper.
        with_first_rest: A run keeps its rest before it sets off (`diagnose.setting_off`).
    """

    max_sample_rate: float = 100.0
    plate_margin: float = 1.25
    with_first_rest: bool = False


DEFAULT_DATASET = DatasetSettings()

INITIAL_ZETA_MATCH = ZetaMatchSettings(max_steps=12)


@dataclass(frozen=True)
class InitialZetaSettings:
    """Numbers of the search for the zeta at which each run is linearised.

    Attributes:
        window: Part of all that a wheel turns and travels, (from, to) [-], over which mean sinkage
            is matched: past the start, and before most effects have grown.
        search: Numbers of the secant search. It may take more steps than others: the zeta of a
            set-up may be a guess, and far from the sand's.
    """

    window: tuple[float, float] = (0.05, 0.4)
    search: ZetaMatchSettings = INITIAL_ZETA_MATCH


DEFAULT_INITIAL_ZETA = InitialZetaSettings()


@dataclass(frozen=True, eq=False)
class RigDataset:
    """Runs of one rig.

    A run's log zeta counts from the zeta of its set-up.

    Attributes:
        runs: The runs, as for a fit.
        batch: The same, padded to common sizes.
        settings: How they were prepared.
        shared: Model whose program simulates every other, where it may.
    """

    runs: Sequence[PreparedRun]
    batch: Batch
    settings: DatasetSettings = DEFAULT_DATASET
    shared: AugmentedModel = REFERENCE

    @classmethod
    def of(
        cls, runs: Sequence[PreparedRun], settings: DatasetSettings = DEFAULT_DATASET
    ) -> "RigDataset":
        """Runs from where they set off, with `settings.max_sample_rate` at most, of common sizes.

        Raises:
            InputError: where they are not runs of one kind of wheel, carriage and sand.
        """
        begun = runs if settings.with_first_rest else [from_setting_off(each) for each in runs]
        runs = [decimate(each, settings.max_sample_rate) for each in begun]
        trials, seen = [each.trial for each in runs], [each.observation for each in runs]
        return cls(runs, make_batch(trials, seen, size=padded_count), settings)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels that any run has, in the order of every array of channels."""
        return self.batch.channels

    @property
    def run_numbers(self) -> range:
        return range(len(self.runs))

    def map(self, pool: RunPool, work: Callable[[int], Result]) -> list[Result]:
        """Do `work` for the number of every run, side by side, the longest runs first.

        A long run that came last would leave other cores idle. `work` must not use the pool.
        """
        steps = self.batch.observed.compared_rows * self.batch.trials.parts
        order = np.argsort(-np.asarray(steps)[: len(self.runs)], kind="stable").tolist()
        found = dict(zip(order, pool.map(work, order), strict=True))
        return [found[run] for run in self.run_numbers]

    @cached_property
    def holds(self) -> list[CarriageHold]:
        """By run, what its readings say of how a free carriage is held."""
        return [
            CarriageHold.of(each, self.channels, self.time(run))
            for run, each in enumerate(self.runs)
        ]

    @cached_property
    def trials(self) -> list[Trial]:
        """Each run's trial, padded."""
        return [_unstack(self.batch.trials, run) for run in self.run_numbers]

    @cached_property
    def observations(self) -> list[PaddedObservations]:
        """Each run's recording, padded."""
        return [_unstack(self.batch.observed, run) for run in self.run_numbers]

    def with_fewer_plates(self) -> "RigDataset":
        """The same dataset without plates that stay above the sand: no change but for roundings.

        A bare rim is cut anew, into plates of nearly the same length. A simulation that sinks far
        deeper than was recorded returns NaN.
        """
        shapes = {each.setup.wheel.shape for each in self.runs}
        if len(shapes) > 1 or "outline" in shapes:
            return self
        z = self.channels.index("z")
        deepest = max(
            float(np.nanmax(-self.recording(run)[z], initial=0)) for run in self.run_numbers
        )
        wheel = self.runs[0].setup.wheel
        sectors = wheel.grouser_count if wheel.shape == "grouser" else PLAIN_SECTORS
        for number in range(1, sectors // 2):
            reach = number * 2 * math.pi / sectors
            limit = MAX_COVERED_SHARE * float(wheel.build(reach).cut().sinkage_limit)
            if reach < DEFAULT_REACH and limit > self.settings.plate_margin * deepest:
                fewer = [_with_plates_within(reach, each) for each in self.runs]
                return RigDataset.of(fewer, self.settings)
        return self

    def compile(
        self,
        pool: RunPool,
        program: Callable,
        model: AugmentedModel | Directions,
        waits: bool = True,
    ) -> None:
        """Compile a program for a model in one thread, before several need it.

        Otherwise each of them would compile it for itself. While it is compiled, other threads may
        simulate. All arguments have the same types as in `prediction`: JAX takes a weakly typed
        number, as Python's are, for another program.

        Args:
            pool: Threads.
            program: `predict`, or `predict_with_jacobian`.
            model: What is going to be simulated: its first argument.
            waits: Until it is compiled; else it is only begun.
        """
        observed = self.observations[0]
        none = jnp.zeros_like(observed.compared_rows)
        nothing = eqx.tree_at(lambda o: o.compared_rows, observed, none)
        if isinstance(model, Directions):
            key, null = model.key, np.zeros(model.free)
        else:
            key, null = program_within(model, self.shared).model, model.null()
        given = (self.channels, self.trials[0], nothing, as_real(0.0), null)
        if not isinstance(model, Directions):
            given = (*given, self.shared)
        begun = pool.begin((self, program, key), lambda: program(model, *given))
        if waits:
            begun.result()

    def counts(self, run: int) -> np.ndarray:
        """Mask of a run's recorded samples that are compared, shape (all samples,)."""
        return self.runs[run].observation.counts

    def time(self, run: int) -> np.ndarray:
        """Times of the samples compared [s], shape (samples,)."""
        return self.runs[run].observation.time[self.counts(run)]

    def logged_time(self, run: int) -> np.ndarray:
        """The same from the log's first command on, with the rest that was left out [s]."""
        return self.time(run) + self.runs[run].rest_left_out

    def sample_interval(self, run: int) -> float:
        """Median time between the samples compared [s]; that of the largest rate for only one."""
        time = self.time(run)
        if len(time) > 1:
            return float(np.median(np.diff(time)))
        return 1 / self.settings.max_sample_rate

    def recording(self, run: int) -> np.ndarray:
        """Recorded channels at the times compared [m, N, N m], shape (channels, samples).

        NaN for a channel that was not recorded.
        """
        observation = self.runs[run].observation
        values = np.full((len(self.channels), int(self.counts(run).sum())), np.nan)
        for name, row in zip(observation.channels, observation.values, strict=True):
            values[self.channels.index(name)] = row[self.counts(run)]
        return self.holds[run].of_readings(values)

    def prediction(
        self, model: AugmentedModel, run: int, log_zeta: float, coordinates: np.ndarray
    ) -> np.ndarray:
        """Simulated channels at the times compared [m, N, N m], shape (channels, samples).

        Args:
            model: With effects or without.
            run: Number of the run.
            log_zeta: Logarithm of its zeta over its set-up's [-].
            coordinates: The model's free numbers, shape (free,).
        """
        found = predict(
            model,
            self.channels,
            self.trials[run],
            self.observations[run],
            as_real(log_zeta),
            coordinates,
            self.shared,
        )
        counts = self.counts(run)
        return self.holds[run].of_simulation(np.asarray(found)[:, : len(counts)][:, counts])

    def derivatives(
        self,
        pool: RunPool,
        directions: Directions,
        log_zeta: np.ndarray,
        coordinates: np.ndarray,
    ) -> list[np.ndarray]:
        """By run, slopes of the channels at the times compared, by the simulator itself.

        Args:
            pool: Threads.
            directions: Of a model.
            log_zeta: Logarithm of each run's zeta over its set-up's [-], shape (runs,).
            coordinates: The model's free numbers, shape (free,) or (runs, free).

        Returns:
            [m, N, N m] by (own log zeta, free numbers), shape (channels, samples, 1 + free) each.
        """
        self.compile(pool, predict_with_jacobian, directions)
        of_runs = np.broadcast_to(coordinates, (len(self.runs), np.shape(coordinates)[-1]))

        def of(run: int) -> np.ndarray:
            slope = slopes(
                directions,
                self.channels,
                self.trials[run],
                self.observations[run],
                as_real(log_zeta[run]),
                of_runs[run],
            )
            counts = self.counts(run)
            return self.holds[run].of_simulation(slope[:, : len(counts)][:, counts])

        return self.map(pool, of)

    def all_finite(self, residuals: Sequence[np.ndarray]) -> bool:
        """Tell whether every run was simulated to its end.

        Args:
            residuals: By run, simulated minus recorded, shape (channels, samples).

        Returns:
            True where no number is missing at a sample that was recorded.
        """
        return all(
            bool(np.isfinite(each[~np.isnan(self.recording(run))]).all())
            for run, each in enumerate(residuals)
        )


def _unstack(stacked, run: int):
    return jax.tree.map(lambda leaf: leaf[run], stacked)


def _with_plates_within(reach: float, each: PreparedRun) -> PreparedRun:
    """The run with only those plates of its wheel within an angle from straight down [rad]."""
    wheel = each.setup.wheel.build(reach)
    return replace(each, trial=eqx.tree_at(lambda t: t.simulator.wheel, each.trial, wheel))


def decimate(each: PreparedRun, max_rate: float = DEFAULT_DATASET.max_sample_rate) -> PreparedRun:
    """The run with every n-th of its samples, where a logger took more than `max_rate` [Hz]."""
    seen = each.observation
    if len(seen.time) < 2:
        return each
    every = math.floor(1 / (max_rate * float(np.median(np.diff(seen.time)))) + 1e-6)
    if every < 2:
        return each
    kept = slice(int(np.argmax(seen.after_start)) % every, None, every)
    return replace(each, observation=seen.thinned(kept))


def padded_count(count: int) -> int:
    """The next power of two, but never small, so that datasets of most rigs share programs."""
    return max(MIN_PADDED_SIZE, 2 ** (count - 1).bit_length())


def with_zeta(trial: Trial, log_zeta: float) -> Trial:
    """The trial with its zeta multiplied by exp(`log_zeta`)."""
    zeta = trial.simulator.terrain.zeta.value * np.exp(log_zeta)  # pyright: ignore
    return eqx.tree_at(lambda t: t.simulator.terrain.zeta.value, trial, zeta)


def pitch(trial: Trial) -> float:
    """Angle from one grouser to the next [rad]; infinite without any."""
    return float(getattr(trial.simulator.wheel.cut(), "pitch", np.inf))


def match_initial_zeta(
    dataset: RigDataset, pool: RunPool, settings: InitialZetaSettings = DEFAULT_INITIAL_ZETA
) -> np.ndarray:
    """Log zeta of each run at which the reference model matches its early mean sinkage.

    All responses are linearised there; it is not yet the zeta that suits all channels best.

    Args:
        dataset: The runs.
        pool: Threads.
        settings: Numbers of the search.

    Returns:
        Logarithm of zeta over that of the run's set-up [-], shape (runs,).

    Raises:
        InputError: where no run has a sinkage.
        RunError: where a run cannot be simulated, or zeta does not change its sinkage.
    """
    if "z" not in dataset.channels:
        raise InputError("no run has a recorded sinkage (/measured/z), and nothing stands for it")
    dataset.compile(pool, predict, AugmentedModel())
    return np.array(dataset.map(pool, lambda run: _initial_zeta(dataset, run, settings)))


def in_short_steps(dataset: RigDataset) -> RigDataset:
    """The dataset whose simulations turn a wheel by little in a step.

    Numbers far from those at which the error of longer steps was found change this error.
    """

    def shortened(each: PreparedRun) -> PreparedRun:
        parts = jnp.asarray(parts_within_turn(each.trial), each.trial.parts.dtype)
        return replace(each, trial=eqx.tree_at(lambda t: t.parts, each.trial, parts))

    return RigDataset.of([shortened(each) for each in dataset.runs], dataset.settings)


def without_step_errors(
    dataset: RigDataset, pool: RunPool, settings: InitialZetaSettings = DEFAULT_INITIAL_ZETA
) -> RigDataset:
    """The dataset whose simulated channels are those of far shorter steps.

    What its steps are wrong by is found with the reference model at the run's early mean sinkage.

    Args:
        dataset: The runs.
        pool: Threads.
        settings: Numbers of the search for zeta.

    Raises:
        InputError: where no run has a sinkage.
        RunError: where a run cannot be simulated, or zeta does not change its sinkage.
    """
    log_zeta = match_initial_zeta(dataset, pool, settings)
    errors = step_errors(dataset, AugmentedModel(), log_zeta, np.zeros(0), pool)
    return with_step_errors(dataset, errors)


def step_errors(
    dataset: RigDataset,
    model: AugmentedModel,
    log_zeta: np.ndarray,
    coordinates: np.ndarray,
    pool: RunPool,
) -> list[np.ndarray]:
    """By run, what the steps of a dataset make of a model's channels [m, N, N m].

    Args:
        dataset: The runs.
        model: With effects or without.
        log_zeta: Logarithm of each run's zeta over its set-up's [-], shape (runs,).
        coordinates: The model's free numbers, shape (free,).
        pool: Threads.

    Returns:
        Each of shape (channels, all samples). Where a run cannot be simulated in shorter steps, the
        error that the dataset takes off already.
    """

    def of(run: int) -> np.ndarray:
        trial, observed = dataset.trials[run], dataset.observations[run]
        known, plain = np.asarray(observed.step_error), jnp.zeros_like(observed.step_error)
        observed = eqx.tree_at(
            lambda o: (o.step_error, o.compared_rows), observed, (plain, observed.all_rows)
        )

        def simulated(parts: np.ndarray) -> np.ndarray:
            finer = eqx.tree_at(lambda t: t.parts, trial, jnp.asarray(parts, trial.parts.dtype))
            at = as_real(log_zeta[run]), coordinates
            return predict(model, dataset.channels, finer, observed, *at, dataset.shared)

        found = step_error(simulated, trial, known=known)
        return found[:, : len(dataset.runs[run].observation.time)]

    return dataset.map(pool, of)


def with_step_errors(dataset: RigDataset, errors: Sequence[np.ndarray]) -> RigDataset:
    """The dataset from whose simulated channels these errors are taken off.

    Args:
        dataset: The runs.
        errors: By run, shape (channels, all samples).
    """
    runs = []
    for each, error in zip(dataset.runs, errors, strict=True):
        rows = [dataset.channels.index(name) for name in each.observation.channels]
        runs.append(replace(each, observation=replace(each.observation, step_error=error[rows])))
    return replace(RigDataset.of(runs, dataset.settings), shared=dataset.shared)


def with_step_errors_of(other: RigDataset, dataset: RigDataset) -> RigDataset:
    """A dataset without the step's errors that another one of the same runs takes off."""
    known = zip(other.observations, other.runs, strict=True)
    errors = [
        np.asarray(padded.step_error)[:, : len(run.observation.time)] for padded, run in known
    ]
    return with_step_errors(dataset, errors)


def _initial_zeta(dataset: RigDataset, run: int, settings: InitialZetaSettings) -> float:
    z = dataset.channels.index("z")
    early = _early_samples(dataset, run, settings.window)
    recorded = dataset.recording(run)[z, early].mean()

    def miss(log_zeta: np.ndarray) -> float:
        simulated = dataset.prediction(AugmentedModel(), run, float(log_zeta), np.zeros(0))
        return float(simulated[z, early].mean() - recorded)

    found = match_mean_sinkage(miss, settings=settings.search)
    if not np.isfinite(found.miss) or found.slope == 0:
        name = dataset.runs[run].name
        raise RunError(name, "no zeta lets the reference model follow its sinkage")
    return float(found.log_zeta)


def _early_samples(dataset: RigDataset, run: int, window: tuple[float, float]) -> np.ndarray:
    """Mask of the compared samples within a window of the angle turned and the distance travelled.

    All of them where none was taken then.
    """
    each, time = dataset.runs[run], dataset.time(run)
    omega, vx = (
        np.abs(np.interp(time, np.asarray(each.trial.time), np.asarray(speed)))
        for speed in (each.trial.omega, each.trial.vx)
    )
    speed = each.setup.wheel.radius * omega + vx
    moved = np.cumsum(speed * np.gradient(time)) if len(time) > 1 else speed
    early = (moved > window[0] * moved[-1]) & (moved < window[1] * moved[-1])
    return early if early.any() else np.ones_like(early)
