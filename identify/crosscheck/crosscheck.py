"""Comparison of the online tuner with the offline zeta(t): difference, lag and ripple.

Eq. 7 is replayed over each recorded run (`drftjax.tuning.replay`), and zeta(t) is fitted to the
same run (`identify.zeta_path.smoother`). One factor at a time, tick, zeta step and tolerance are
varied about the setting asked for; all settings and runs are one compiled program.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from drftjax import __version__
from drftjax.common.errors import InputError, RunError
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.runlog.record import Online
from identify.compatible_runs import retry_without_failures
from identify.crosscheck.comparison import (
    COMPARISON_SETTINGS,
    Comparison,
    ComparisonSettings,
    Path,
    compare_series,
    moving_part,
    root_mean_square,
)
from identify.crosscheck.replays import ReplayedTuner, TunerSetting, replay_settings
from identify.zeta_path.path import ZetaPath
from identify.zeta_path.smoother import KNOT_SPACING, zeta_paths

CROSSCHECK_SCHEMA = "drft-crosscheck"


@dataclass(frozen=True)
class CrossCheckSettings:
    """Numbers of a cross-check.

    Attributes:
        tick_factors: Multiples of the tuner's tick that the sweep tries [-].
        step_factors: Multiples of its zeta step [-].
        tolerance_factors: Multiples of its tolerance [-].
        comparison: Numbers of the comparison of two zeta series.
    """

    tick_factors: tuple[float, ...] = (0.25, 0.5, 2.0, 4.0)
    step_factors: tuple[float, ...] = (0.25, 0.5, 2.0, 4.0)
    tolerance_factors: tuple[float, ...] = (0.0, 0.3, 3.0, 10.0)
    comparison: ComparisonSettings = COMPARISON_SETTINGS


CROSSCHECK_SETTINGS = CrossCheckSettings()


@dataclass(frozen=True)
class SweepRow:
    """One setting of the tuner on one run."""

    setting: TunerSetting
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
        rmse: Simulated minus recorded up to where the command last moves, by "tuner", "offline" and
            channel [m].
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
        """Name of the zeta that is closer to the truth, where that is known."""
        if self.offline_from_truth is None or self.tuner.from_truth is None:
            return None
        return "offline" if self.offline_from_truth < self.tuner.from_truth else "tuner"


@dataclass(frozen=True, eq=False)
class CrossCheck:
    """The tuner and the offline zeta(t) of many runs."""

    setting: TunerSetting
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
            "told": path.identified,
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
    prepared: Sequence[PreparedRun],
    setting: TunerSetting,
    *,
    online: Mapping[str, Online] | None = None,
    truths: Mapping[str, Path] | None = None,
    knot_spacing: float = KNOT_SPACING,
    sweep: bool = True,
    numbers: CrossCheckSettings = CROSSCHECK_SETTINGS,
) -> CrossCheck:
    """Replay the tuner over recorded runs, and compare it with their offline zeta(t).

    Args:
        prepared: Runs; one that cannot be replayed or fitted, moves for too few ticks, or is of
            another kind of wheel, law or carriage than most, is left out.
        setting: The tuner.
        online: What a run logged of its own tuner, by name.
        truths: The true zeta(t) of a run, by name, where it is known.
        knot_spacing: Of the offline zeta(t) [s].
        sweep: Try other settings as well.
        numbers: Decision numbers.

    Raises:
        InputError: where the tuner cannot be, or no run is left.
    """
    settings = [setting, *(_sweep(setting, numbers) if sweep else [])]

    def both_ways(runs: list[PreparedRun]) -> list[RunCheck]:
        made = zip(
            runs, zeta_paths(runs, knot_spacing), replay_settings(runs, settings), strict=True
        )
        return [checked(*each) for each in made]

    def checked(each: PreparedRun, path: ZetaPath, replayed: ReplayedTuner) -> RunCheck:
        logged, truth = (online or {}).get(each.name), (truths or {}).get(each.name)
        try:
            return _check(each, path, settings, replayed, logged, truth, numbers.comparison)
        except InputError as problem:
            raise RunError(each.name, str(problem)) from None

    _, runs, left_out = retry_without_failures(prepared, both_ways)
    return CrossCheck(setting, runs, left_out)


def _sweep(setting: TunerSetting, numbers: CrossCheckSettings) -> list[TunerSetting]:
    """Return the setting with one number varied at a time."""
    tick, step, tolerance = setting.tick, setting.zeta_step, setting.tolerance
    return [
        *(TunerSetting(tick * factor, step, tolerance) for factor in numbers.tick_factors),
        *(TunerSetting(tick, step * factor, tolerance) for factor in numbers.step_factors),
        *(TunerSetting(tick, step, tolerance * factor) for factor in numbers.tolerance_factors),
    ]


def _check(
    each: PreparedRun,
    path: ZetaPath,
    settings: Sequence[TunerSetting],
    replayed: ReplayedTuner,
    online: Online | None,
    truth: Path | None,
    numbers: ComparisonSettings,
) -> RunCheck:
    """Return the comparison of one run's zetas."""

    def compared(number: int) -> Comparison:
        pick = np.s_[number, :: replayed.every[number]]
        time = replayed.time[:: replayed.every[number]]
        tolerance = settings[number].tolerance
        error = replayed.error[pick]
        direction = np.where(error < -tolerance, 1, np.where(error > tolerance, -1, 0))
        if settings[number].zeta_step == 0:
            direction = 0 * direction
        moving = moving_part(each.trial, time, numbers)
        return compare_series(time, replayed.zeta[pick], direction, moving, path.at, truth, numbers)

    time = replayed.time[:: replayed.every[0]]
    moving = moving_part(each.trial, time, numbers)
    logged = None
    online_time = online_zeta = None
    if online is not None:
        online_time = online.time - each.setup.command.time[0]
        online_zeta = online.zeta
        direction = np.sign(np.diff(online_zeta, prepend=online_zeta[0])).astype(int)
        when = moving_part(each.trial, online_time, numbers)
        logged = compare_series(online_time, online_zeta, direction, when, path.at, truth, numbers)
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
            None if truth is None else root_mean_square(path.at(time[moving]) - truth(time[moving]))
        ),
    )


def _replay_rmse(each: PreparedRun, replayed: ReplayedTuner) -> dict[str, float]:
    observation = each.observation
    ends = replayed.time + replayed.time[1]
    when = observation.counts & (observation.time >= ends[0]) & (observation.time <= ends[-1])
    simulated = {"x": replayed.x[0], "z": replayed.z[0]}
    return {
        channel: root_mean_square(
            np.interp(observation.time[when], ends, simulated[channel]) - values[when]
        )
        for channel, values in zip(observation.channels, observation.values, strict=True)
        if channel in simulated
    }
