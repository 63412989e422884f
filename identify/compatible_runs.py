"""Sets of runs that one compiled program simulates, and the runs that do not fit in."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from drftjax.common.errors import InputError, RunError
from drftjax.recorded.batch import OTHER_KIND, share_program
from drftjax.recorded.prepared_run import PreparedRun

Made = TypeVar("Made")


def largest_compatible_set(
    candidates: Sequence[PreparedRun],
) -> tuple[list[PreparedRun], dict[str, str]]:
    """Largest set of runs that one compiled program simulates.

    Args:
        candidates: Runs with different names.

    Returns:
        The runs of the set, and the reason why each other run is not in it, by its name.

    Raises:
        InputError: two runs have one name, or the two largest sets are of one size.
    """
    names = [each.name for each in candidates]
    if len(set(names)) < len(names):
        raise InputError(f"two runs have one name among {', '.join(names)}; names must differ")
    kinds: list[list[PreparedRun]] = []
    for each in candidates:
        for kind in kinds:
            if share_program(each.trial, kind[0].trial):
                kind.append(each)
                break
        else:
            kinds.append([each])
    ranked = sorted(kinds, key=len, reverse=True)
    largest = ranked[0] if ranked else []
    if len(ranked) > 1 and len(ranked[1]) == len(largest):
        listed = "; ".join(", ".join(each.name for each in kind) for kind in ranked[:2])
        raise InputError(
            f"the runs are of different wheels, terrains, carriages or integrators ({listed}); fit "
            "each apart"
        )
    others = (each for kind in kinds if kind is not largest for each in kind)
    return largest, {
        each.name: f"it {OTHER_KIND} than {largest[0].name}; fit it apart" for each in others
    }


def retry_without_failures(
    candidates: Sequence[PreparedRun], make: Callable[[list[PreparedRun]], Made]
) -> tuple[list[PreparedRun], Made, dict[str, str]]:
    """Call a function on the largest compatible set of runs, without those that fail.

    Each run that raises `RunError` is dropped, and the function is called again.

    Args:
        candidates: Runs with different names.
        make: Function of several runs, which raises `RunError` for one that it cannot use.

    Returns:
        The runs used, the function's result, and the reason why each other run was not used.

    Raises:
        InputError: no run can be used.
    """
    kept, skipped = largest_compatible_set(candidates)
    while True:
        try:
            return kept, make(kept), skipped
        except RunError as problem:
            if len(kept) == 1:
                raise
            skipped[problem.run] = problem.why
            kept = [each for each in kept if each.name != problem.run]
