"""Runs that one program simulates side by side, and those that are left out of it."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from drftjax.common.errors import InputError, RunError
from drftjax.recorded.batch import OTHER_KIND, share_program
from drftjax.recorded.prepared_run import PreparedRun

Made = TypeVar("Made")


def largest_compatible_set(
    candidates: Sequence[PreparedRun],
) -> tuple[list[PreparedRun], dict[str, str]]:
    """The largest set of runs that one program simulates, and why the others are left out.

    Raises:
        InputError: where two runs have one name, or two kinds have as many runs.
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
        told = "; ".join(", ".join(each.name for each in kind) for kind in ranked[:2])
        raise InputError(
            f"the runs are of different wheels, terrains, carriages or integrators ({told}); fit "
            "each apart"
        )
    others = (each for kind in kinds if kind is not largest for each in kind)
    return largest, {
        each.name: f"it {OTHER_KIND} than {largest[0].name}; fit it apart" for each in others
    }


def retry_without_failures(
    candidates: Sequence[PreparedRun], make: Callable[[list[PreparedRun]], Made]
) -> tuple[list[PreparedRun], Made, dict[str, str]]:
    """What is made of all runs that can be used together.

    Args:
        candidates: Runs; those of another kind than most are left out.
        make: Makes something of several runs, or raises `RunError` for one that must be left out.

    Returns:
        The runs used, what was made of them, and why each other run was left out.

    Raises:
        InputError: where no run is left.
    """
    kept, left_out = largest_compatible_set(candidates)
    while True:
        try:
            return kept, make(kept), left_out
        except RunError as problem:
            if len(kept) == 1:
                raise
            left_out[problem.run] = problem.why
            kept = [each for each in kept if each.name != problem.run]
