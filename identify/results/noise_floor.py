"""Repeats: runs of the same command and set-up, and what they say of chance."""

from collections.abc import Iterator, Sequence

import numpy as np

from drftjax.recorded.observation import white_noise
from drftjax.recorded.repeats import interpolate_recorded, noise_after_interpolation
from drftjax.runlog.record import RecordedCommand
from identify.results.values import RunFit

# Numbers of set-ups and commands are the same within this share of their size, and within so much
# where they are zero: what files of different makers round.
SAME, NOUGHT = 1e-6, 1e-9


# Repeats were recorded over this share of each other's time at least. With more missing, the zeta
# of one meets other parts of the run than the other's, and a misfit that grows passes for chance.
LEAST_SHARED = 0.95


# Samples that tell what noise they have: three second differences.
LEAST_SAMPLES = 5


# Each repeat is held against so many others at most, as hundreds have too many pairs.
PARTNERS = 10


def repeated_runs(runs: Sequence[RunFit]) -> list[list[int]]:
    """Groups of two or more runs with the same command and believed set-up, by index.

    Clocks may differ, and one run may have been stopped a little earlier than another. Each is held
    against the longest of a group, so that the order of the runs is no matter.
    """
    groups: list[list[int]] = []
    commands = [run.setup.command.build() for run in runs]
    lasts = [float(command.time[-1] - command.time[0]) for command in commands]
    for index in sorted(range(len(runs)), key=lambda each: -lasts[each]):
        for group in groups:
            first = group[0]
            if _same_built(runs[index], runs[first]) and _same_command(
                commands[index], commands[first]
            ):
                group.append(index)
                break
        else:
            groups.append([index])
    return sorted(sorted(group) for group in groups if len(group) > 1)


def _same_built(run: RunFit, other: RunFit) -> bool:
    """Whether two runs of the same channels are believed to be of one wheel and rig."""
    ours, theirs = (each.believed or (each.setup.wheel, each.setup.rig) for each in (run, other))
    return run.channels == other.channels and all(
        bool(abs(a - b) <= SAME * max(abs(a), abs(b)) + NOUGHT)
        if isinstance(a := getattr(one, name), float)
        and isinstance(b := getattr(another, name), float)
        else a == getattr(another, name)
        for one, another in zip(ours, theirs, strict=True)
        for name in one.__struct_fields__
    )


def _same_command(a: RecordedCommand, b: RecordedCommand) -> bool:
    """Whether two commands agree for as long as both go on."""
    if (a.vx is None) != (b.vx is None):
        return False
    ours, theirs = a.time - a.time[0], b.time - b.time[0]
    end = min(ours[-1], theirs[-1])
    if end < LEAST_SHARED * max(ours[-1], theirs[-1]):
        return False
    # Straight lines agree where they agree at the corners of both.
    corners = np.union1d(ours, theirs)
    corners = corners[corners <= end]

    def agree(first: np.ndarray, second: np.ndarray) -> bool:
        top = max(float(np.abs(first).max()), float(np.abs(second).max()))
        apart = np.interp(corners, ours, first) - np.interp(corners, theirs, second)
        return bool(np.abs(apart).max() <= SAME * top + NOUGHT)

    return agree(a.omega, b.omega) and (a.vx is None or b.vx is None or agree(a.vx, b.vx))


def noise_floor(runs: Sequence[RunFit]) -> dict[str, float]:
    """What two repeats differ by beyond their own fitted values, per run and channel [m, N, N m].

    Half the power of the difference of two runs' residuals is what neither model nor sand, the
    same for both, can account for. One is read between its samples where the clocks differ, which
    averages some of its white noise away: that is put back. Empty where no run was repeated.
    """
    powers: dict[str, list[float]] = {}
    for group in repeated_runs(runs):
        for first, second in _pairs(group):
            a, b = runs[first], runs[second]
            # A copy of a run repeats nothing.
            if np.ptp(a.recorded) > 0 and np.array_equal(a.recorded, b.recorded):
                continue
            told = b.time[b.counts]
            both = a.counts & interpolate_recorded(told, a.time)
            if both.sum() < LEAST_SHARED * max(a.counts.sum(), len(told)):
                continue
            kept = noise_after_interpolation(told, a.time[both])
            for channel, residual in a.residuals.items():
                beside = np.interp(a.time[both], told, b.residuals[channel][b.counts])
                power = float(np.mean((residual[both] - beside) ** 2))
                averaged = (1 - kept) * white_noise(b.residuals[channel][b.counts]) ** 2
                power = (power + averaged) / 2
                powers.setdefault(channel, []).append(power)
    return {channel: float(np.sqrt(np.mean(each))) for channel, each in powers.items()}


def _pairs(group: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Every two of a group, in whatever order; of a large one, each run beside as many others."""
    size = len(group)
    for apart in range(1, min(PARTNERS, size // 2) + 1):
        # Half way round a circle, each two meet twice.
        for place in range(size // 2 if 2 * apart == size else size):
            yield group[place], group[(place + apart) % size]


def fast_scatter(runs: Sequence[RunFit]) -> dict[str, float]:
    """White noise of what fits leave, by channel [m, N, N m]; root mean square over the runs.

    Runs of too few samples to tell it are passed over.
    """
    powers: dict[str, list[float]] = {}
    for run in runs:
        if run.counts.sum() < LEAST_SAMPLES:
            continue
        for channel, residual in run.residuals.items():
            powers.setdefault(channel, []).append(white_noise(residual[run.counts]) ** 2)
    return {channel: float(np.sqrt(np.mean(each))) for channel, each in powers.items()}
