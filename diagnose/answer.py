"""Answers to sets of runs whose faults are sealed."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from diagnose.case import Case, threads
from diagnose.diagnosis import diagnose
from diagnose.promise import measured_on
from drftjax.effects.catalogue import catalogue
from identify.candidate import candidates_of


def answer_set(paths: Sequence[Path]) -> dict:
    """The diagnosis of one set, as it goes into a file of answers.

    Where runs of the same rig lie in a folder `fresh` beside, the shrinkage is measured on them
    too, after all else is settled.

    Args:
        paths: The runs of the set.
    """
    with threads() as pool:
        found = diagnose(case_of(paths, pool), tuple(catalogue().values()))
        fresh = sorted((Path(paths[0]).parent / "fresh").glob("*.h5"))
        answer = found.document()
        if fresh and found.chosen.names:
            answer["fresh"] = {
                channel: gap.document() for channel, gap in measured_on(found, fresh, pool).items()
            }
        return answer


def case_of(paths: Sequence[Path], pool: ThreadPoolExecutor) -> Case:
    """Run logs made ready for a diagnosis.

    Raises:
        InputError: where one cannot be read, simulated or compared with the others.
    """
    return Case.of(candidates_of(list(paths)), pool)
