"""The online tuner beside the offline zeta(t): how far apart, how late, how restless.

Eq. 7 is replayed over each recorded run (`drftjax.tuner`), and zeta(t) is fitted to the same run
(`identify.zeta_path`). One factor at a time, tick, zeta step and tolerance are varied about the
setting asked for; all settings and runs are one compiled program.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax import __version__
from drftjax.command import Command
from drftjax.errors import InputError
from drftjax.runlog.record import Online
from drftjax.trial import Trial
from drftjax.tuner import Loop, StepTuner, known_sinkage, replay, tick_commands
from identify.batch import make_batch
from identify.candidate import Candidate
from identify.zeta_path import KNOT_SPACING, ZetaPath, zeta_paths

CROSSCHECK_SCHEMA = "drft-crosscheck"

# Shares and multiples of the setting asked for that the sweep tries.
TICK_FACTORS = (0.25, 0.5, 2.0, 4.0)
STEP_FACTORS = (0.25, 0.5, 2.0, 4.0)
TOLERANCE_FACTORS = (0.0, 0.3, 3.0, 10.0)
# The shortest tick of the sweep divides every other.
FINER = 4

RIPPLE_WINDOW = 1.0
# Ticks in a row that make a slope, or a rest, of more than chance.
SUSTAINED = 10
# A lag is looked for up to so long, and up to a third of the moving part [s].
LONGEST_LAG = 5.0
LEAST_CORRELATION = 0.5
# By so much the best lag must beat the longest ones: a straight line is like itself at any lag.
LEAST_PEAK = 0.02

Path = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Comparison:
    """One zeta over ticks beside the offline one, over the part in which the wheel moves.

    Attributes:
        difference: Root mean square difference from the offline zeta(t) [-].
        bias: Mean difference [-].
        lag: How long after the offline one, by cross-correlation [s]; None where it cannot be told.
        correlation: At that lag [-].
        ripple: Standard deviation about its own mean over 1 s [-].
        ripple_frequency: The strongest in that ripple [Hz]; None without ripple.
        up, down, idle: Shares of the ticks that raise, lower and leave zeta [-].
        slew_limit: Share of the ticks in rows of ten or more that all step the same way [-].
        dead_band: Share of the ticks in rows of ten or more that all leave zeta alone [-].
        from_truth: Root mean square difference from the true zeta(t) [-], where it is known.
    """

    difference: float
    bias: float
    lag: float | None
    correlation: float | None
    ripple: float
    ripple_frequency: float | None
    up: float
    down: float
    idle: float
    slew_limit: float
    dead_band: float
    from_truth: float | None = None


@dataclass(frozen=True)
class Setting:
    """A tuner's numbers [s], [-], [m]."""

    tick: float
    zeta_step: float
    tolerance: float


@dataclass(frozen=True)
class SweepRow:
    """One setting of the tuner on one run."""

    setting: Setting
    comparison: Comparison


@dataclass(frozen=True, eq=False)
class RunCheck:
    """Both zetas of one run.

    Attributes:
        name: The run, as reports call it.
        offline: The fitted zeta(t).
        time: Ticks [s].
        zeta: The replayed tuner's, on each tick [-].
        error: Recorded minus simulated sinkage on each tick [m].
        moving: Ticks on which the wheel is asked to move.
        tuner: The tuner's comparison.
        rmse: Simulated minus recorded over the moving part, by "tuner", "offline" and channel [m].
        sweep: Other settings of the tuner.
        online: The comparison of the zeta that the run itself logged, where it did.
        online_time, online_zeta: That zeta.
        truth: The true zeta on each tick, where it is known.
        offline_from_truth: Root mean square difference of the offline one from it [-].
    """

    name: str
    offline: ZetaPath
    time: np.ndarray
    zeta: np.ndarray
    error: np.ndarray
    moving: np.ndarray
    tuner: Comparison
    rmse: dict[str, dict[str, float]]
    sweep: list[SweepRow]
    online: Comparison | None
    online_time: np.ndarray | None
    online_zeta: np.ndarray | None
    truth: np.ndarray | None
    offline_from_truth: float | None

    @property
    def closer(self) -> str | None:
        """Which of the two is closer to the truth, where it is known."""
        if self.offline_from_truth is None or self.tuner.from_truth is None:
            return None
        return "offline" if self.offline_from_truth < self.tuner.from_truth else "tuner"


@dataclass(frozen=True, eq=False)
class CrossCheck:
    """The tuner and the offline zeta(t) of many runs."""

    setting: Setting
    runs: list[RunCheck]
    failures: Mapping[str, str]

    def document(self) -> dict:
        """The result as plain values, in the layout of the JSON file."""
        return _plain(
            {
                "schema": CROSSCHECK_SCHEMA,
                "schema_version": 1,
                "software": f"drftjax {__version__}",
                **asdict(self.setting),
                "failures": dict(self.failures),
                "runs": [_run_document(run) for run in self.runs],
            }
        )


def _run_document(run: RunCheck) -> dict:
    path = run.offline
    return {
        "name": run.name,
        "offline": {
            "time": path.time,
            "zeta": path.value,
            "error": path.error,
            "told": path.told,
            "smoothness_weight": path.weight,
            "noise": {c: {"spread": s, "correlation": r} for c, (s, r) in path.noise.items()},
            "converged": path.converged,
            "from_truth": run.offline_from_truth,
        },
        "tuner": asdict(run.tuner) | {"time": run.time, "zeta": run.zeta},
        "online": None if run.online is None else asdict(run.online),
        "rmse": run.rmse,
        "closer_to_truth": run.closer,
        "sweep": [asdict(row.setting) | asdict(row.comparison) for row in run.sweep],
    }


def _plain(value: Any) -> Any:
    """Numbers that JSON can hold; what is not finite is null."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def crosscheck(
    candidates: Sequence[Candidate],
    setting: Setting,
    *,
    online: Mapping[str, Online] | None = None,
    truths: Mapping[str, Path] | None = None,
    knot_spacing: float = KNOT_SPACING,
    sweep: bool = True,
) -> CrossCheck:
    """Replay the tuner over recorded runs, and hold it against their offline zeta(t).

    Args:
        candidates: Runs of the same kind of wheel, law and carriage.
        setting: The tuner.
        online: What a run logged of its own tuner, by name.
        truths: The true zeta(t) of a run, by name, where it is known.
        knot_spacing: Of the offline zeta(t) [s].
        sweep: Whether other settings are tried.

    Raises:
        InputError: where the tuner cannot be, or a run cannot be replayed or fitted.
    """
    settings = [setting, *(_sweep(setting) if sweep else [])]
    paths = zeta_paths(candidates, knot_spacing)
    replayed = _replays(candidates, settings)
    runs = [
        _check(
            each,
            path,
            settings,
            ticks,
            (online or {}).get(path.name),
            (truths or {}).get(path.name),
        )
        for each, path, ticks in zip(candidates, paths, replayed, strict=True)
    ]
    return CrossCheck(setting, runs, {})


def _sweep(setting: Setting) -> list[Setting]:
    tick, step, tolerance = setting.tick, setting.zeta_step, setting.tolerance
    return [
        *(Setting(tick * factor, step, tolerance) for factor in TICK_FACTORS),
        *(Setting(tick, step * factor, tolerance) for factor in STEP_FACTORS),
        *(Setting(tick, step, tolerance * factor) for factor in TOLERANCE_FACTORS),
    ]


# Replays ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Replayed:
    """One run under every setting, on the finest tick; arrays of shape (settings, ticks)."""

    time: np.ndarray
    zeta: np.ndarray
    error: np.ndarray
    z: np.ndarray
    x: np.ndarray
    every: list[int]


def _replays(candidates: Sequence[Candidate], settings: Sequence[Setting]) -> list[_Replayed]:
    """Every run under every setting.

    All settings are stepped on one fine tick. A tick in between, on which a setting does not
    measure, is one without a measurement, which leaves zeta as it is.
    """
    wanted = [StepTuner(s.tick, s.zeta_step, s.tolerance) for s in settings]
    tick = settings[0].tick / FINER
    every = [round(s.tick / tick) for s in settings]
    batch = make_batch([c.trial for c in candidates], [c.observation for c in candidates])
    longest = max(c.setup.integrator.step for c in candidates)
    substeps = max(1, math.ceil(tick / longest - 1e-9))
    lengths = [max(1, math.ceil(float(c.trial.time[-1]) / tick - 1e-9)) for c in candidates]
    starts = tick * np.arange(max(lengths))
    recorded = np.stack([_recorded(c, starts, every) for c in candidates])
    tuners = jax.tree.map(
        lambda *leaves: jnp.stack(leaves),
        *(eqx.tree_at(lambda t: t.tick, each, jnp.asarray(tick)) for each in wanted),
    )
    first = jnp.asarray([_first_zeta(c.trial) for c in candidates])
    commands = jax.vmap(
        lambda t: tick_commands(max(lengths), substeps, tick, t.time, t.omega, t.vx)
    )(batch.trials)
    found = _replay_all(batch.trials, first, commands, jnp.asarray(recorded), tuners)
    zeta, error, z, x = map(np.asarray, found)
    if not np.isfinite(z[:, 0]).all():
        raise InputError("a replay of the tuner diverges; give a shorter tick or a smaller step")
    return [
        _Replayed(starts[:n], zeta[i, :, :n], error[i, :, :n], z[i, :, :n], x[i, :, :n], every)
        for i, n in enumerate(lengths)
    ]


def _recorded(each: Candidate, starts: np.ndarray, every: Sequence[int]) -> np.ndarray:
    """Sinkage known on the fine ticks that a setting measures on, shape (settings, ticks)."""
    observation = each.observation
    if "z" not in observation.channels:
        raise InputError(f"{each.name}: the run has no /measured/z, so its sinkage is not known")
    z = observation.values[observation.channels.index("z")]
    known = known_sinkage(starts, observation.time, -z)
    number = np.arange(len(starts))
    return np.stack([np.where(number % n == 0, known, np.nan) for n in every])


def _first_zeta(trial: Trial) -> Array:
    first = Command(trial.omega[0], trial.vx[0], trial.omega[0])
    return trial.simulator.terrain.zeta(jnp.zeros_like(trial.step), first)


@eqx.filter_jit
def _replay_all(
    trials: Trial,
    zeta: Float[Array, " runs"],
    commands: Command,
    recorded: Float[Array, "runs settings ticks"],
    tuners: StepTuner,
) -> tuple[Array, ...]:
    """zeta, error, z and x, each of shape (runs, settings, ticks)."""

    def one(trial: Trial, zeta: Array, commands: Command, recorded: Array, tuner: StepTuner):
        start = Loop(trial.start, zeta)
        _, tick = replay(trial.simulator, start, commands, recorded, tuner)
        return tick.zeta, tick.error, tick.output.z, tick.output.x

    settings = jax.vmap(one, in_axes=(None, None, None, 0, 0))
    return jax.vmap(settings, in_axes=(0, 0, 0, 0, None))(trials, zeta, commands, recorded, tuners)


# Comparisons --------------------------------------------------------------------------------------


def _check(
    each: Candidate,
    path: ZetaPath,
    settings: Sequence[Setting],
    replayed: _Replayed,
    online: Online | None,
    truth: Path | None,
) -> RunCheck:
    def compared(number: int) -> Comparison:
        pick = np.s_[number, :: replayed.every[number]]
        time = replayed.time[:: replayed.every[number]]
        tolerance = settings[number].tolerance
        error = replayed.error[pick]
        direction = np.where(error < -tolerance, 1, np.where(error > tolerance, -1, 0))
        if settings[number].zeta_step == 0:
            direction = 0 * direction
        moving = _moving(each.trial, time)
        return comparison(time, replayed.zeta[pick], direction, moving, path.at, truth)

    time = replayed.time[:: replayed.every[0]]
    moving = _moving(each.trial, time)
    logged = None
    online_time = online_zeta = None
    if online is not None:
        online_time = online.time - each.setup.command.time[0]
        online_zeta = online.zeta
        direction = np.sign(np.diff(online_zeta, prepend=online_zeta[0])).astype(int)
        when = _moving(each.trial, online_time)
        logged = comparison(online_time, online_zeta, direction, when, path.at, truth)
    return RunCheck(
        name=each.name,
        offline=path,
        time=time,
        zeta=replayed.zeta[0, :: replayed.every[0]],
        error=replayed.error[0, :: replayed.every[0]],
        moving=moving,
        tuner=compared(0),
        rmse={"tuner": _replay_rmse(each, replayed), "offline": path.rmse},
        sweep=[
            SweepRow(setting, compared(number))
            for number, setting in enumerate(settings)
            if len(settings) > 1
        ],
        online=logged,
        online_time=online_time,
        online_zeta=online_zeta,
        truth=None if truth is None else truth(time),
        offline_from_truth=(
            None if truth is None else _rms(path.at(time[moving]) - truth(time[moving]))
        ),
    )


def comparison(
    time: np.ndarray,
    zeta: np.ndarray,
    direction: np.ndarray,
    moving: np.ndarray,
    offline: Path,
    truth: Path | None = None,
) -> Comparison:
    """One zeta over ticks beside the offline zeta(t).

    Args:
        time: Ticks, evenly spaced [s].
        zeta: On each of them [-].
        direction: 1, -1 or 0 where it was raised, lowered or left.
        moving: Ticks that are compared.
        offline, truth: zeta(t) [-].
    """
    tick = float(np.median(np.diff(time)))
    at, steps = time[moving], direction[moving]
    other = offline(at)
    apart = zeta[moving] - other
    late, correlation = lag(zeta[moving], other, tick)
    spread, frequency = ripple(zeta[moving], tick)
    return Comparison(
        difference=_rms(apart),
        bias=float(apart.mean()),
        lag=late,
        correlation=correlation,
        ripple=spread,
        ripple_frequency=frequency,
        up=float(np.mean(steps > 0)),
        down=float(np.mean(steps < 0)),
        idle=float(np.mean(steps == 0)),
        slew_limit=sustained(steps, steps != 0),
        dead_band=sustained(steps, steps == 0),
        from_truth=None if truth is None else _rms(zeta[moving] - truth(at)),
    )


def lag(late: np.ndarray, early: np.ndarray, tick: float) -> tuple[float | None, float | None]:
    """How long after `early` `late` does the same [s], and their correlation then.

    None where nothing changes, they are unlike, or the longest lags tried are as good.
    """
    most = int(min(LONGEST_LAG / tick, len(late) // 3))
    count = len(late)
    shifts = np.arange(-most, most + 1)
    found = np.array(
        [
            _correlation(late[max(k, 0) : count + min(k, 0)], early[max(-k, 0) : count - max(k, 0)])
            for k in shifts
        ]
    )
    best = int(np.argmax(found)) if len(found) else 0
    ends = (0, len(shifts) - 1)
    peaked = most > 0 and found[best] > max(found[list(ends)]) + LEAST_PEAK
    if not peaked or found[best] < LEAST_CORRELATION:
        return None, None
    return float(shifts[best] * tick), float(found[best])


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / power if power > 1e-12 else 0.0


def ripple(zeta: np.ndarray, tick: float) -> tuple[float, float | None]:
    """Standard deviation about the mean over 1 s, and its strongest frequency [Hz]."""
    half = max(1, round(RIPPLE_WINDOW / tick / 2))
    sums = np.r_[0.0, np.cumsum(zeta)]
    place = np.arange(len(zeta))
    low, high = np.maximum(place - half, 0), np.minimum(place + half + 1, len(zeta))
    left = zeta - (sums[high] - sums[low]) / (high - low)
    if left.std() < 1e-12:
        return 0.0, None
    power = np.abs(np.fft.rfft((left - left.mean()) * np.hanning(len(left)))) ** 2
    return float(left.std()), float(np.fft.rfftfreq(len(left), tick)[1 + np.argmax(power[1:])])


def sustained(steps: np.ndarray, counted: np.ndarray) -> float:
    """Share of the ticks that are counted and lie in a row of at least `SUSTAINED` equal ones."""
    ends = np.flatnonzero(np.diff(steps)) + 1
    rows = np.split(np.arange(len(steps)), ends)
    long = [row for row in rows if len(row) >= SUSTAINED and counted[row[0]]]
    return sum(len(row) for row in long) / max(len(steps), 1)


def _moving(trial: Trial, time: np.ndarray) -> np.ndarray:
    """From the first to the last time that wheel or carriage is asked to move."""
    knots = np.asarray(trial.time)
    asked = sum(np.abs(np.interp(time, knots, np.asarray(v))) for v in (trial.omega, trial.vx))
    at = np.flatnonzero(asked > 1e-9)
    if len(at) < 2 * SUSTAINED:
        raise InputError(
            f"the wheel moves over {len(at)} ticks, too few to compare; give a shorter tick"
        )
    return (np.arange(len(time)) >= at[0]) & (np.arange(len(time)) <= at[-1])


def _replay_rmse(each: Candidate, replayed: _Replayed) -> dict[str, float]:
    observation = each.observation
    ends = replayed.time + replayed.time[1]
    when = observation.counts & (observation.time >= ends[0]) & (observation.time <= ends[-1])
    simulated = {"x": replayed.x[0], "z": replayed.z[0]}
    return {
        channel: _rms(np.interp(observation.time[when], ends, simulated[channel]) - values[when])
        for channel, values in zip(observation.channels, observation.values, strict=True)
        if channel in simulated
    }


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
