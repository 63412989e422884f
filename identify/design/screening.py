"""Global sensitivity of a run: numbers that could matter on a rig at all, and those that cannot.

Zeta, lambda, numbers of sand, rig and start, and the strengths of all effects move through their
ranges together, so that each is judged beside all others and not at one point. Changes of a channel
count in its noise: 1 is as large, root mean square over the run, as the noise of one reading.
"""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.common.errors import InputError
from drftjax.recorded.observation import comparable_channels
from drftjax.recorded.prepared_run import RECORDED_STEPS
from drftjax.setups.chosen_step import choose_setup_step
from drftjax.setups.setup import SetUp
from drftjax.simulation.ensemble import map_runs
from drftjax.simulation.trial import ROW_INTERVAL, Trial
from identify.design.elementary_effects import (
    ElementaryEffects,
    MorrisSettings,
    require_extra,
    screen_function,
)
from identify.design.fisher_information import InstrumentNoise, compared_rows
from identify.design.number_ranges import NumberRange, RangeSettings, add_effects, number_ranges
from identify.parameters.parameter import Quantity

# Names in a sentence at most, where a table has all.
MOST_NAMED = 10


@dataclass(frozen=True, eq=False)
class GlobalSensitivity:
    """Numbers of a rig, and the change that each could make to its channels.

    Attributes:
        title: Of the set-up.
        ranges: Numbers screened, with their ranges.
        excluded: Reasons why others are not, by name.
        channels: Channels that the rig measures.
        noise: Of each [m, N, N m].
        effects: Elementary effects in noise.
        settings, seed: Of the trajectories.
    """

    title: str
    ranges: tuple[NumberRange, ...]
    excluded: dict[str, str]
    channels: tuple[str, ...]
    noise: dict[str, float]
    effects: ElementaryEffects
    settings: MorrisSettings
    seed: int

    @property
    def order(self) -> list[int]:
        """Numbers by their largest effect on any channel, the largest first."""
        largest = np.nan_to_num(self.effects.mean_size, nan=-1.0).max(axis=1)
        return np.argsort(-largest, kind="stable").tolist()

    @property
    def undetermined(self) -> list[int]:
        """Numbers too few of whose simulations succeeded."""
        return [i for i in self.order if not np.isfinite(self.effects.mean_size[i]).all()]

    @property
    def relevant(self) -> list[int]:
        """Numbers whose interval reaches the noise of some channel, the largest first."""
        reach = self.effects.mean_size + self.effects.interval
        return [i for i in self.order if bool((reach[i] >= 1).any())]

    def summary(self) -> str:
        """Return the outcome in a few sentences."""
        undetermined, relevant = self.undetermined, self.relevant
        without = [i for i in self.order if i not in relevant and i not in undetermined]

        def named(numbers: list[int], most: int | None = None) -> str:
            names = [self.ranges[index].quantity.label for index in numbers]
            more = len(names[most:]) if most else 0
            return (", ".join(names[:most]) or "none") + (f" and {more} more" if more else "")

        lines = [
            f"{len(relevant)} of {len(self.ranges)} numbers can matter here: across its range each "
            f"may change {' or '.join(self.channels)} by the noise or more. The largest: "
            f"{named(relevant, MOST_NAMED)}.",
            f"Cannot matter, as all changes stay below the noise: {named(without)}.",
        ]
        if undetermined:
            lines.append(f"Not determined, as their simulations fail: {named(undetermined)}.")
        if self.excluded:
            reasons: dict[str, list[str]] = {}
            for name, reason in self.excluded.items():
                reasons.setdefault(reason, []).append(name)
            lines += [f"Not screened: {', '.join(them)} ({why})." for why, them in reasons.items()]
        if self.effects.failed:
            lines.append(
                f"{self.effects.failed} of {self.effects.simulations} simulations diverge or sink "
                "past the wheel's plates; their effects are left out."
            )
        return "\n".join(lines)


def screen(
    setup: SetUp,
    *,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    instrument: InstrumentNoise | None = None,
    settings: MorrisSettings | None = None,
    choices: RangeSettings | None = None,
    seed: int = 0,
    progress: Callable[[str], None] = lambda what: None,
) -> GlobalSensitivity:
    """Screen the numbers of a set-up for those that can matter; see `elementary_effects`.

    Args:
        setup: Wheel, sand, rig, start and command.
        ranges: Lowest and highest value of some numbers, in SI units, in place of their usual
            ranges; other numbers that a fit knows are screened as well.
        instrument: Channels that the rig measures, and their noise; all that a fit compares, with
            the usual noise, where none are given.
        settings: Numbers of the method.
        choices: Usual ranges.
        seed: Of the random trajectories.
        progress: Called with a description of the work in progress.

    Raises:
        InputError: SALib is not installed; a range, channel or number of the set-up cannot be; or
            most simulations fail.
    """
    settings, choices = settings or MorrisSettings(), choices or RangeSettings()
    require_extra()
    settings.check()
    if instrument is None:
        channels = comparable_channels(setup.rig.carriage == "driven")
        instrument = InstrumentNoise(channels=channels)
    instrument.check()
    setup = copy.deepcopy(setup)
    progress("choosing a step")
    choose_setup_step(setup, RECORDED_STEPS)
    excluded = add_effects(setup, instrument.channels)
    trial, counts = _trial(setup, choices)
    screened, lacking = number_ranges(setup, trial, ranges or {}, choices)

    low = np.array([each.low for each in screened])
    width = np.array([each.high for each in screened]) - low
    quantities = [each.quantity for each in screened]
    noise = jnp.array([instrument.noise[channel] for channel in instrument.channels])

    def outputs(points: np.ndarray) -> np.ndarray:
        values = jnp.asarray(low + points * width)
        runs = _simulated(values, trial, quantities, instrument.channels, noise)
        return np.asarray(runs)[:, :, counts]

    def report(done: int) -> None:
        progress(f"{done} of {settings.trajectories} trajectories, {len(screened) + 1} runs each")

    report(0)
    effects = screen_function(outputs, len(screened), settings, seed, report)
    if effects.failed > choices.most_failed * effects.simulations:
        raise InputError(
            f"{effects.failed} of {effects.simulations} simulations diverge or sink past the "
            "wheel's plates: the set-up itself may, or its ranges are too wide (--range)"
        )
    return GlobalSensitivity(
        setup.title,
        screened,
        excluded | lacking,
        instrument.channels,
        {channel: instrument.noise[channel] for channel in instrument.channels},
        effects,
        settings,
        seed,
    )


def _trial(setup: SetUp, choices: RangeSettings) -> tuple[Trial, np.ndarray]:
    """The trial, and a mask of the rows that count: those until the wheel stops for good."""
    command = setup.command.build()
    lasts = float(command.time[-1] - command.time[0])
    trial = setup.trial(max(ROW_INTERVAL, lasts / choices.max_rows))
    interval = float(trial.step) * trial.every
    return trial, compared_rows(setup, trial.rows + 1, interval) > 0


@eqx.filter_jit
def _simulated(
    values: Float[Array, "points numbers"],
    trial: Trial,
    quantities: list[Quantity],
    channels: tuple[str, ...],
    noise: Float[Array, " channels"],
) -> Float[Array, "points channels rows"]:
    """Channels of the runs, in their noise; NaN of a run that sinks past the wheel's plates."""

    def one(run: Float[Array, " numbers"], trial: Trial) -> Float[Array, "channels rows"]:
        for index, each in enumerate(quantities):
            trial = each.write(trial, run[index])
        output = trial.run()
        table = jnp.stack([getattr(output, each) for each in channels]) / noise[:, None]
        covered = jnp.max(output.sinkage) <= trial.simulator.adjusted().wheel.cut().sinkage_limit
        return jnp.where(covered, table, jnp.nan)

    return map_runs(one, values, trial)
