"""A case: the runs of one rig made ready for a diagnosis, with the baseline fitted to each."""

import math
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diagnose.model.augmented_model import COVERED, AugmentedModel, predict
from diagnose.model.linearized_run import (
    LinearizedRun,
    linearize,
    repair_outlier_maps,
    steps_per_node,
)
from drftjax.common.arrays import as_real
from drftjax.common.errors import InputError, RunError
from drftjax.physics.wheel import DEFAULT_REACH, GrouserWheel
from drftjax.recorded.batch import Batch, PaddedObservations, make_batch, padded_size
from drftjax.recorded.matched_zeta import (
    ZetaMatchSettings,
    match_mean_sinkage,
)
from drftjax.recorded.observation import SMALLEST_NOISE, white_noise
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.simulation.trial import Trial

Item = TypeVar("Item")


Result = TypeVar("Result")


# Samples a second: what a run tells counts by the sample where it is fast, as on runs at this rate,
# and what a model leaves there is no newer for being read more often.
FASTEST = 100.0


# Lengths are padded to this at least; padding costs next to nothing.
SMALLEST_SIZE = 2304


# Plates are carried for a wheel that sinks this much deeper than was recorded.
ROOM = 1.25


# Part of the way, of all that a run turns and travels, over which sinkage is met at first.
EARLY = (0.05, 0.4)


INITIAL_ZETA_MATCH = ZetaMatchSettings(max_steps=12)
"""The zeta of a set-up may be a guess, and far from the sand's."""


@dataclass(frozen=True, eq=False)
class RigDataset:
    """Runs of one rig.

    Attributes:
        candidates: The runs, as for a fit.
        batch: The same, padded to common sizes.
    """

    runs: Sequence[PreparedRun]
    batch: Batch

    @classmethod
    def of(cls, candidates: Sequence[PreparedRun]) -> "RigDataset":
        """Runs made ready, with `FASTEST` samples a second at most.

        Raises:
            InputError: where they are not runs of one kind of wheel, carriage and sand.
        """
        candidates = [decimate(each) for each in candidates]
        batch = make_batch(
            [each.trial for each in candidates],
            [each.observation for each in candidates],
            size=padded_count,
        )
        return cls(candidates, batch)

    @property
    def channels(self) -> tuple[str, ...]:
        return self.batch.channels

    @cached_property
    def threads(self) -> ThreadPoolExecutor:
        """As many threads as there are cores: JAX computes outside Python's lock.

        They compute in the precision of the thread that asks first, which JAX does not hand on,
        and end with the case.
        """
        return _threads()

    @cached_property
    def leaders(self) -> ThreadPoolExecutor:
        """Threads like these that do no more than hand work to them and wait."""
        return _threads()

    @cached_property
    def trials(self) -> list[Trial]:
        """Each run's trial, padded."""
        return [self._of_run(self.batch.trials, run) for run in self._runs]

    @cached_property
    def observations(self) -> list[PaddedObservations]:
        """Each run's recording, padded."""
        return [self._of_run(self.batch.observed, run) for run in self._runs]

    def with_fewer_plates(self) -> "RigDataset":
        """The same case without plates that stay above the sand: but for roundings no change.

        What sinks far deeper than was recorded has no numbers.
        """
        if not all(isinstance(each.trial.simulator.wheel, GrouserWheel) for each in self.runs):
            return self
        z = self.channels.index("z")
        deepest = max(float(np.nanmax(-self.recording(run)[z], initial=0)) for run in self._runs)
        wheel = self.runs[0].setup.wheel
        for sectors in range(1, wheel.grouser_count // 2):
            reach = sectors * 2 * math.pi / wheel.grouser_count
            limit = float(wheel.build(reach).cut().sinkage_limit)
            if reach < DEFAULT_REACH and COVERED * limit > ROOM * deepest:
                return RigDataset.of([_sampled_within(reach, each) for each in self.runs])
        return self

    @property
    def _runs(self) -> range:
        return range(len(self.runs))

    def _of_run(self, stacked, run: int):
        return jax.tree.map(lambda leaf: leaf[run], stacked)

    def map_runs(self, work: Callable[[int], Result]) -> list[Result]:
        """`work` done for every run, side by side."""
        return list(self.threads.map(work, self._runs))

    def map_items(self, work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """`work` done for every item, side by side, where it goes over runs itself.

        Runs are of different lengths: one item alone leaves cores idle at the end of each pass.
        """
        return list(self.leaders.map(work, items))

    def precompile(self, program: Callable, models: Sequence[AugmentedModel]) -> None:
        """Compile a program for some models side by side, rather than one by one as they come.

        Without this every thread that needs a program first would compile it for itself. All is of
        the same types here as in `predicted`: JAX takes a weakly typed number, as Python's are, for
        another program.
        """
        observed = self.observations[0]
        none = jnp.zeros_like(observed.compared_rows)
        nothing = eqx.tree_at(lambda o: o.compared_rows, observed, none)

        def of(model: AugmentedModel) -> None:
            program(model, self.channels, self.trials[0], nothing, as_real(0.0), model.null())

        # One of each program, or threads would compile the same side by side.
        list(self.threads.map(of, {each.program[0]: each for each in models}.values()))

    def counts(self, run: int) -> np.ndarray:
        """Which of a run's recorded samples are compared."""
        return self.runs[run].observation.counts

    def time(self, run: int) -> np.ndarray:
        """Times of the samples compared [s]."""
        return self.runs[run].observation.time[self.counts(run)]

    def sample_interval(self, run: int) -> float:
        """Time that one of them stands for [s]; of one alone, what it would at `FASTEST`."""
        time = self.time(run)
        return float(np.median(np.diff(time))) if len(time) > 1 else 1 / FASTEST

    def recording(self, run: int) -> np.ndarray:
        """What was recorded then, shape (channels, samples); NaN for a channel not recorded."""
        observation = self.runs[run].observation
        values = np.full((len(self.channels), int(self.counts(run).sum())), np.nan)
        for name, row in zip(observation.channels, observation.values, strict=True):
            values[self.channels.index(name)] = row[self.counts(run)]
        return values

    def prediction(
        self, model: AugmentedModel, run: int, log_zeta: float, coordinates: np.ndarray
    ) -> np.ndarray:
        """What a model gives then, like `recorded`."""
        found = predict(
            model,
            self.channels,
            self.trials[run],
            self.observations[run],
            as_real(log_zeta),
            coordinates,
        )
        return np.asarray(found)[:, : len(self.counts(run))][:, self.counts(run)]

    def all_finite(self, residuals: Sequence[np.ndarray]) -> bool:
        """Whether every run was simulated to its end: no number is missing where one was recorded.

        Args:
            residuals: By run, simulated less recorded, shape (channels, samples).
        """
        return all(
            bool(np.isfinite(each[~np.isnan(self.recording(run))]).all())
            for run, each in enumerate(residuals)
        )

    @cached_property
    def _traced(self) -> dict[int, tuple[float, LinearizedRun]]:
        return {}

    def linearized(self, run: int, log_zeta: float) -> LinearizedRun:
        """A run of the reference model at this zeta, linearised; the last one of a run is kept."""
        at, found = self._traced.get(run, (np.nan, None))
        if found is None or at != log_zeta:
            found = self._linearised(run, log_zeta)
            self._traced[run] = float(log_zeta), found
        return found

    def _linearised(self, run: int, log_zeta: float) -> LinearizedRun:
        trial = with_zeta(self.trials[run], log_zeta)
        steps = [steps_per_node(each) for each in self.trials]
        rows = np.asarray(self.batch.observed.compared_rows)
        nodes = [int(r) * t.every // s for r, t, s in zip(rows, self.trials, steps, strict=False)]
        size = max(SMALLEST_SIZE, padded_size(max(nodes)))
        found = linearize(trial, jnp.asarray(steps[run]), jnp.asarray(nodes[run]), size)
        return repair_outlier_maps(found, pitch(trial))

    def node_interval(self, run: int) -> float:
        """Length of a node of its trace [s]."""
        trial = self.trials[run]
        return float(trial.step) * steps_per_node(trial)


def _sampled_within(reach: float, each: PreparedRun) -> PreparedRun:
    """A run whose wheel carries only the plates within an angle from straight down [rad]."""
    wheel = each.setup.wheel.build(reach)
    return replace(each, trial=eqx.tree_at(lambda t: t.simulator.wheel, each.trial, wheel))


def decimate(each: PreparedRun) -> PreparedRun:
    """The run with every so many of its samples, where a logger took more than `FASTEST`."""
    seen = each.observation
    if len(seen.time) < 2:
        return each
    every = math.floor(1 / (FASTEST * float(np.median(np.diff(seen.time)))) + 1e-6)
    if every < 2:
        return each
    kept = slice(int(np.argmax(seen.after_start)) % every, None, every)
    values = seen.values[:, kept]
    noise = [
        max(white_noise(row), SMALLEST_NOISE[name])
        for name, row in zip(seen.channels, values, strict=True)
    ]
    fewer = replace(
        seen, time=seen.time[kept], values=values, counts=seen.counts[kept], noise=np.array(noise)
    )
    return replace(each, observation=fewer)


def _threads() -> ThreadPoolExecutor:
    double = bool(jax.config.values["jax_enable_x64"])

    def begin() -> None:
        jax.enable_x64(double).__enter__()  # for as long as the thread lives

    return ThreadPoolExecutor(os.cpu_count() or 1, initializer=begin)


def padded_count(count: int) -> int:
    """The next power of two, but never small: cases of most rigs share their programs."""
    return max(SMALLEST_SIZE, 2 ** (count - 1).bit_length())


def with_zeta(trial: Trial, log_zeta: float) -> Trial:
    """The trial with its zeta scaled."""
    zeta = trial.simulator.terrain.zeta.value * np.exp(log_zeta)  # pyright: ignore
    return eqx.tree_at(lambda t: t.simulator.terrain.zeta.value, trial, zeta)


def pitch(trial: Trial) -> float:
    """Angle from one grouser to the next [rad]; infinite without any."""
    return float(getattr(trial.simulator.wheel.cut(), "pitch", np.inf))


def match_initial_zeta(
    case: RigDataset, settings: ZetaMatchSettings = INITIAL_ZETA_MATCH
) -> np.ndarray:
    """Each run's log zeta over its set-up's, at which the reference model meets its early sinkage.

    Where all is linearised; not yet the zeta that suits all channels best.

    Args:
        case: The runs.
        settings: Numbers of the secant search.

    Returns:
        Shape (runs,).

    Raises:
        InputError: where a run has no sinkage, or cannot be simulated.
    """
    if "z" not in case.channels:
        raise InputError("no run has a recorded sinkage (/measured/z), and nothing stands for it")
    z = case.channels.index("z")
    plain = AugmentedModel()
    case.precompile(predict, [plain])

    def of(run: int) -> float:
        early = _early(case, run)
        recorded = case.recording(run)[z, early].mean()

        def miss(log_zeta: np.ndarray) -> float:
            found = case.prediction(plain, run, float(log_zeta), np.zeros(0))
            return float(found[z, early].mean() - recorded)

        found = match_mean_sinkage(miss, settings=settings)
        if not np.isfinite(found.miss) or found.slope == 0:
            name = case.runs[run].name
            raise RunError(name, "no zeta lets the reference model follow its sinkage")
        return float(found.log_zeta)

    return np.array(case.map_runs(of))


def _early(case: RigDataset, run: int) -> np.ndarray:
    """The samples compared early in the motion, past its start: before most effects have grown.

    All of them where none was taken then.
    """
    each, time = case.runs[run], case.time(run)
    omega, vx = (
        np.abs(np.interp(time, np.asarray(each.trial.time), np.asarray(speed)))
        for speed in (each.trial.omega, each.trial.vx)
    )
    speed = each.setup.wheel.radius * omega + vx
    moved = np.cumsum(speed * np.gradient(time)) if len(time) > 1 else speed
    early = (moved > EARLY[0] * moved[-1]) & (moved < EARLY[1] * moved[-1])
    return early if early.any() else np.ones_like(early)
