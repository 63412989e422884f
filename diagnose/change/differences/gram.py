r"""Differences between runs of one condition, which hold nothing that all of them share.

The recording of run i of condition c is taken as

$$y_i(t) = m_i(t; \theta, \zeta_i) - p_c(t) + \text{noise},$$

with the model m, and a path $p_c$ that all runs of the condition share: whatever the model is wrong
by there, in sand, rig and instruments. Nothing is believed of it. Its flat prior leaves of the
residuals $r_i = m_i - y_i$ their deviations from the condition's mean,
$r_i - \bar r_c$, and so of every derivative. With one run before and one now that is half their
difference.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.change.differences.conditions import MatchedCondition
from diagnose.change.differences.settings import DifferenceFitSettings
from diagnose.dataset import RigDataset
from diagnose.linear.linear_fit import Block, block_names
from diagnose.linear.residual_blocks import SlowFastSplit
from diagnose.model.carriage_hold import holds_carriage
from diagnose.run_pool import RunPool


@dataclass(frozen=True, eq=False)
class SharedClock:
    """Times at which all runs of a condition are compared.

    Attributes:
        condition: The runs.
        time: Samples of the shortest run where all were recorded [s], shape (samples,).
        split: Maps from these samples to blocks.
    """

    condition: MatchedCondition
    time: np.ndarray
    split: SlowFastSplit

    @classmethod
    def of(cls, dataset: RigDataset, condition: MatchedCondition) -> "SharedClock":
        """The clock of a condition."""
        times = [dataset.time(run) for run in condition.runs]
        shortest = min(times, key=len)
        begin, end = max(each[0] for each in times), min(each[-1] for each in times)
        time = shortest[(shortest >= begin) & (shortest <= end)]
        return cls(condition, time, SlowFastSplit.of(time))

    def at(self, time: np.ndarray, values: np.ndarray) -> np.ndarray:
        """A run's values, shape (samples, columns), linearly between its own samples."""
        if len(time) == len(self.time) and np.array_equal(time, self.time):
            return values
        return np.stack([np.interp(self.time, time, each) for each in values.T], axis=1)


@dataclass(frozen=True, eq=False)
class DifferenceGram:
    """Products of all columns' deviations from the means of their conditions, by block.

    Attributes:
        blocks: (channel, kind) of each block.
        gram: Of (coefficients..., own log zeta of each run, residual), shape (blocks, n, n), in the
            blocks' units squared.
        count: Values in each block, less those that the means take, shape (blocks,).
        chance: Mean square in each block that repeats on one side differ by beyond noise and zeta,
            shape (blocks,): nothing is asked of a model there.
        least_worth: Independent statements in each block at least, shape (blocks,).
    """

    blocks: tuple[Block, ...]
    gram: np.ndarray
    count: np.ndarray
    chance: np.ndarray
    least_worth: np.ndarray

    @property
    def by_law(self) -> tuple[str, ...]:
        """Channels that move by the sand's law for some change of z.

        What holds a free carriage does not.
        """
        holds = holds_carriage(self.blocks)
        by_law = (c for (c, _), hold in zip(self.blocks, holds, strict=True) if not hold)
        return tuple(each for each in dict.fromkeys(by_law) if each != "z")

    def mean_square(self, gram: np.ndarray, factors: np.ndarray) -> np.ndarray:
        """Mean square of a sum of columns in each block, shape (blocks,).

        Args:
            gram: Of these columns, as by `of_columns`.
            factors: Share of each, shape (n,).
        """
        total = np.einsum("i,bij,j->b", factors, gram, factors, optimize=True)
        return np.maximum(total, 0) / np.maximum(self.count, 1)

    def worth(self, settings: DifferenceFitSettings) -> np.ndarray:
        """Independent statements in each block [-], shape (blocks,)."""
        return np.maximum(self.count * settings.worth(self.blocks), self.least_worth)

    def floor(self, settings: DifferenceFitSettings) -> np.ndarray:
        """Mean square in each block below which nothing is asked of a model, shape (blocks,)."""
        return settings.model_errors(self.blocks) ** 2 + self.chance

    def of_columns(self, columns: Sequence[int], runs: int) -> np.ndarray:
        """Gram matrices of some coefficients, all log zetas and the residual."""
        last = self.gram.shape[-1]
        take = np.r_[np.asarray(columns, int), np.arange(last - 1 - runs, last)]
        return self.gram[:, take[:, None], take]


@dataclass(frozen=True, eq=False)
class Differences:
    """The runs of all matched conditions.

    Attributes:
        dataset: The runs, those before and those now; each is of one condition.
        clocks: One for each condition.
        is_now: For each run, True where it was made now, shape (runs,).
        chance: See `DifferenceGram`; zero until it is known.
        has_repeats: Repeats have told the chance. A short run then says one thing in each channel's
            slow part at least.
    """

    dataset: RigDataset
    clocks: tuple[SharedClock, ...]
    is_now: np.ndarray
    chance: float | np.ndarray = 0.0
    has_repeats: bool = False

    @classmethod
    def of(cls, dataset: RigDataset, conditions: Sequence[MatchedCondition]) -> "Differences":
        """Differences of a dataset whose runs are those of the conditions."""
        is_now = np.zeros(len(dataset.runs), bool)
        is_now[[run for each in conditions for run in each.now]] = True
        clocks = tuple(SharedClock.of(dataset, each) for each in conditions)
        return cls(dataset, clocks, is_now)

    def within_sides(self) -> "Differences":
        """Repeats of one side alone: a group for each side of a condition with two runs or more."""
        sides = [s for clock in self.clocks for s in (clock.condition.before, clock.condition.now)]
        groups = [MatchedCondition(each, ()) for each in sides if len(each) > 1]
        clocks = tuple(SharedClock.of(self.dataset, each) for each in groups)
        return Differences(self.dataset, clocks, self.is_now)

    @property
    def centring(self) -> np.ndarray:
        """Matrix that takes the mean over each run's condition off, shape (runs, runs).

        Runs of no condition become zero.
        """
        found = np.zeros((len(self.is_now), len(self.is_now)))
        for clock in self.clocks:
            members = np.array(clock.condition.runs)
            found[np.ix_(members, members)] = np.eye(len(members)) - 1 / len(members)
        return found

    def gram(
        self,
        columns: Sequence[np.ndarray],
        by_zeta: Sequence[np.ndarray],
        residual: Sequence[np.ndarray],
        pool: RunPool,
    ) -> DifferenceGram:
        """Gram matrices of columns that act as they are given, in each run.

        Args:
            columns: By run, derivatives by the coefficients, shape (channels, samples, columns).
            by_zeta: By run, derivative by its own log zeta, shape (channels, samples).
            residual: By run, simulated minus recorded, shape (channels, samples).
            pool: Threads.
        """
        runs, width = len(residual), columns[0].shape[-1]

        def of(clock: SharedClock) -> tuple[np.ndarray, np.ndarray]:
            members = clock.condition.runs
            grams, counts, statements = [], [], []
            for place, channel in enumerate(self.dataset.channels):
                parts: dict[str, list[np.ndarray]] = {}
                for run in members:
                    own = np.zeros((len(self.dataset.time(run)), width + runs + 1))
                    own[:, :width] = columns[run][place]
                    own[:, width + run] = by_zeta[run][place]
                    own[:, -1] = residual[run][place]
                    at = clock.at(self.dataset.time(run), own)
                    for kind, values in clock.split.split(channel, at).items():
                        parts.setdefault(kind, []).append(values)
                for kind, each in parts.items():
                    stacked = np.array(each)
                    recorded = np.isfinite(stacked[:, :, -1]).all()
                    deviation = (stacked - stacked.mean(axis=0)).reshape(-1, width + runs + 1)
                    deviation = deviation if recorded else np.zeros_like(deviation)
                    grams.append(deviation.T @ deviation)
                    free = stacked.shape[1] * (len(members) - 1)
                    counts.append(free if recorded else 0)
                    told = recorded and self.has_repeats and kind == "slow"
                    statements.append(len(members) - 1 if told else 0)
            return np.array(grams), np.array([counts, statements])

        found = pool.map(of, self.clocks)
        blocks = block_names(self.dataset.channels)
        count, least_worth = np.sum([counts for _, counts in found], axis=0)
        return DifferenceGram(
            blocks,
            np.sum([gram for gram, _ in found], axis=0),
            count,
            np.zeros(len(blocks)) + self.chance,
            least_worth,
        )
