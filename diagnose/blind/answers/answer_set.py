"""Answers to sets of runs whose faults are sealed."""

from collections.abc import Sequence
from pathlib import Path

from diagnose.api import diagnose
from diagnose.evaluation.evaluate import prediction_on


def answer_set(paths: Sequence[Path]) -> dict:
    """The diagnosis of one set, as it goes into a file of answers.

    Where runs of the same rig lie in a folder `fresh` beside, the shrinkage is measured on them
    too, after all else is settled.

    Args:
        paths: The runs of the set.
    """
    found = diagnose(paths)
    fresh = sorted((Path(paths[0]).parent / "fresh").glob("*.h5"))
    answer = found.document()
    if fresh and found.selected.effects:
        gaps = prediction_on(found, fresh)
        answer["fresh"] = {channel: gap.document() for channel, gap in gaps.items()}
    return answer
