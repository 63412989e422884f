"""Diagnosis of one blind set."""

from collections.abc import Sequence
from pathlib import Path

from diagnose.api import diagnose
from diagnose.evaluation.evaluate import prediction_on


def answer_set(paths: Sequence[Path]) -> dict:
    """Diagnose one set.

    If runs of the same rig lie in a folder `fresh` beside, the gap is measured on them too, after
    the diagnosis is complete.

    Args:
        paths: Run logs of the set.

    Returns:
        The answer as a file of answers holds it.
    """
    found = diagnose(paths)
    fresh = sorted((Path(paths[0]).parent / "fresh").glob("*.h5"))
    answer = found.document()
    if fresh and found.selected.effects:
        gaps = prediction_on(found, fresh)
        answer["fresh"] = {channel: gap.document() for channel, gap in gaps.items()}
    return answer
