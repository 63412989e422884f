"""Matched conditions: the runs of one command, load and wheel that were made before and now."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnose.rig_runs import describe_rig, without_repeated_readings
from drftjax.common.errors import InputError
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.recorded.repeats import DEFAULT_TOLERANCES, RepeatTolerances, group_by_condition

# The zeta that a set-up believes in may differ between before and now: it may be what changed.
MATCH_TOLERANCES = replace(DEFAULT_TOLERANCES, log_zeta=np.inf)


@dataclass(frozen=True)
class MatchedCondition:
    """Runs of one condition, by their numbers in a dataset.

    Attributes:
        before, now: Those made before, and now; at least one of each.
    """

    before: tuple[int, ...]
    now: tuple[int, ...]

    @property
    def runs(self) -> tuple[int, ...]:
        """All of them, those before first."""
        return self.before + self.now


def matched_conditions(
    before: Sequence[PreparedRun],
    now: Sequence[PreparedRun],
    tolerances: RepeatTolerances = MATCH_TOLERANCES,
) -> list[MatchedCondition]:
    """Conditions that have runs before and now; runs are numbered through, those before first.

    Args:
        before, now: The runs.
        tolerances: Differences that runs of one condition may have.

    Raises:
        InputError: where no condition has both.
    """
    found = []
    for group in group_by_condition([*before, *now], tolerances):
        earlier = tuple(run for run in group if run < len(before))
        later = tuple(run for run in group if run >= len(before))
        if earlier and later:
            found.append(MatchedCondition(earlier, later))
    if not found:
        raise InputError(
            f"no run of now has the command and load of one before ({now[0].name} against "
            f"{before[0].name} among them); a change shows in runs of the same commands, with the "
            "same masses and loads in their set-ups"
        )
    return found


def require_one_rig_on_both_sides(
    before: Sequence[PreparedRun], now: Sequence[PreparedRun]
) -> tuple[list[PreparedRun], list[PreparedRun]]:
    """The runs of both sides, named after their side.

    Args:
        before, now: The runs, those of each side of one rig.

    Raises:
        InputError: where the rigs differ, or a run of now is a copy of one before.
    """
    earlier, later = (describe_rig(side[0].setup) for side in (before, now))
    if earlier != later:
        raise InputError(
            f"now has {later} ({now[0].name}), and before {earlier} ({before[0].name}); a change "
            "is sought in one rig, by the set-ups of its runs"
        )
    sides = tuple(
        [replace(each, name=f"{each.name} ({word})") for each in side]
        for word, side in (("before", before), ("now", now))
    )
    copies = without_repeated_readings([*sides[0], *sides[1]]).skipped
    if copies:
        raise InputError(
            f"{next(iter(copies.values()))}; give runs that were made now, and others that were "
            "made before"
        )
    return sides[0], sides[1]
