"""Run logs for a diagnosis: read, without copies of each other, of one rig, from one origin."""

import copy
import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from zlib import crc32

import numpy as np

from drftjax.common.errors import InputError
from drftjax.recorded.gather import GatheredRuns, gather
from drftjax.recorded.prepared_run import PreparedRun, prepare_run
from drftjax.setups.setup import SetUp
from drftjax.setups.terrain_setup import ZetaKnots

# Wheels are the same where their lengths in millimetres agree to this many decimal places.
LENGTH_DECIMALS = 3


# x counts from where the runs start if they start farther from zero than this [m].
ORIGIN_TOLERANCE = 0.01


def gather_runs(
    given: Sequence[Path],
    tell: Callable[[str], None] = lambda _: None,
    origin: float | None = None,
) -> GatheredRuns:
    """Read the runs of one wheel from files and folders, and why others are left out.

    Args:
        given: Run logs, and folders of them.
        tell: Called with a sentence for every run that is left out.
        origin: See `with_common_origin`.

    Raises:
        InputError: where none can be used, or the runs are of several wheels and none prevails.
    """
    ready = partial(prepare_run, carriage_forces=True)
    gathered = gather(given, ready, sinkage=True, tell=tell)
    kept = require_one_rig(gathered.runs, origin)
    for why in kept.skipped.values():
        tell(f"left out: {why}")
    return GatheredRuns(kept.runs, gathered.skipped | kept.skipped)


def require_one_rig(runs: Sequence[PreparedRun], origin: float | None = None) -> GatheredRuns:
    """The runs of one wheel, each once, from one start, and why the others are left out.

    Args:
        runs: The runs.
        origin: See `with_common_origin`.

    Raises:
        InputError: where the runs are of several wheels and none prevails.
    """
    kept = require_one_wheel(runs)
    once = without_repeated_readings(kept.runs)
    return GatheredRuns(with_common_origin(once.runs, origin), kept.skipped | once.skipped)


def usable_runs(runs: Sequence[PreparedRun]) -> GatheredRuns:
    """The runs in which a gap is defined, with sinkage and one zeta; why the others are left out.

    Raises:
        InputError: where there are none.
    """
    kept, left_out = [], {}
    for each in runs:
        if "z" not in each.observation.channels:
            left_out[each.name] = f"{each.name}: has no z, so its sinkage is not known"
        elif isinstance(each.setup.terrain.zeta, ZetaKnots):
            left_out[each.name] = (
                f"{each.name}: the zeta of its set-up changes in time, must be one number: what "
                "changes would be the gap"
            )
        else:
            kept.append(each)
    if not kept:
        why = next(iter(left_out.values()), "there is no run: give files, folders or run logs")
        raise InputError(why)
    return GatheredRuns(kept, left_out)


def without_repeated_readings(runs: Sequence[PreparedRun]) -> GatheredRuns:
    """The runs without copies of others, which would pass for repeats that agree to the last digit.

    A file that was saved again, or given another title, holds the same readings as the first.
    """
    kept: list[PreparedRun] = []
    left_out = {}
    for each in runs:
        first = next((other for other in kept if _same_readings(each, other)), None)
        if first is None:
            kept.append(each)
        else:
            left_out[each.name] = f"{each.name}: has the very readings of {first.name}"
    return GatheredRuns(kept, left_out)


def _same_readings(one: PreparedRun, other: PreparedRun) -> bool:
    ours, theirs = one.observation, other.observation
    return (
        ours.channels == theirs.channels
        and np.array_equal(ours.time, theirs.time)
        and np.array_equal(ours.values, theirs.values)
    )


def require_one_wheel(runs: Sequence[PreparedRun]) -> GatheredRuns:
    """The runs of the wheel and carriage that most have, and why the others are left out.

    Raises:
        InputError: where two kinds have as many runs each.
    """
    kinds: dict[str, list[PreparedRun]] = {}
    for each in runs:
        kinds.setdefault(describe_rig(each.setup), []).append(each)
    ranked = sorted(kinds.items(), key=lambda kind: -len(kind[1]))
    kind, kept = ranked[0]
    if len(ranked) > 1 and len(ranked[1][1]) == len(kept):
        both = "; ".join(f"{', '.join(c.name for c in some)}: {kind}" for kind, some in ranked[:2])
        raise InputError(
            f"the runs are of different wheels or carriages ({both}); diagnose each apart"
        )
    others = {
        each.name: f"{each.name}: has {other}, where the {len(kept)} runs kept have {kind}"
        for other, some in ranked[1:]
        for each in some
    }
    return GatheredRuns(kept, others)


def with_common_origin(
    runs: Sequence[PreparedRun], origin: float | None = None
) -> list[PreparedRun]:
    """Runs whose x counts from one place, which their set-ups then hold as `start.origin`.

    All are moved by the same distance, as x may be of one bed with a patch at one place. Effects
    count places from x = 0; those that set-ups hold already have places of the recorded x, and then
    nothing is moved. A run without x is taken to start at x = 0.

    Args:
        runs: The runs.
        origin: Recorded x that x = 0 is to stand for [m], as a model was found with; where none is
            given, the start nearest to zero, or zero where that is as good as there.
    """
    known = any(each.setup.effects for each in runs)
    starts = [each.setup.start.x for each in runs if _has_x(each)]
    if known or not starts:
        return list(runs)
    if origin is None:
        nearest = min(starts, key=abs)
        origin = 0.0 if abs(nearest) <= ORIGIN_TOLERANCE else nearest
    return [_with_origin(each, origin) for each in runs]


def _with_origin(each: PreparedRun, origin: float) -> PreparedRun:
    setup, observation = copy.deepcopy(each.setup), each.observation
    setup.start.origin = origin
    if origin == 0.0 or not _has_x(each):
        return dataclasses.replace(each, setup=setup)
    setup.start.x -= origin
    values = observation.values.copy()
    if "x" in observation.channels:
        values[observation.channels.index("x")] -= origin
    return dataclasses.replace(
        each,
        setup=setup,
        trial=setup.trial(interval=0),
        observation=dataclasses.replace(observation, values=values),
    )


def _has_x(each: PreparedRun) -> bool:
    """Tell whether x was recorded; that of a driven carriage is not compared."""
    return "x" in (*each.observation.channels, *each.observation.unused)


def describe_rig(setup: SetUp) -> str:
    """Wheel and carriage in words, the same for all runs of one rig."""
    wheel = setup.wheel
    words = f"a wheel of radius {_mm(wheel.radius)}, width {_mm(wheel.width)}, "
    if wheel.shape == "grouser":
        tip = f"{_mm(wheel.grouser_height)} x {_mm(wheel.grouser_thickness)}"
        words += f"{wheel.grouser_count} grousers of {tip}"
        words += "" if wheel.grouser_fraction == 1 else f" (fraction {wheel.grouser_fraction:g})"
    elif wheel.shape == "outline":
        corners = np.round(1e3 * np.asarray(wheel.points), LENGTH_DECIMALS) + 0.0  # no minus zero
        words += f"an outline of {len(corners)} corners ({crc32(corners.tobytes()):08x})"
    else:
        words += "no grousers"
    return f"{words}, on a {setup.rig.carriage} carriage"


def _mm(length: float) -> str:
    return f"{round(1e3 * length, LENGTH_DECIMALS):g} mm"
