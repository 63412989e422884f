"""Diagnosis of one blind set."""

from collections.abc import Sequence
from pathlib import Path

from diagnose.api import diagnose
from diagnose.blind.answers.answer import BEFORE, NOW
from diagnose.evaluation.evaluate import prediction_on


def answer_set(paths: Sequence[Path]) -> dict:
    """Diagnose one set.

    If runs of the same rig lie in a folder `fresh` beside, the gap is measured on them too, after
    the diagnosis is complete. A set with runs in folders `now` and `before` is compared.

    Args:
        paths: Run logs of the set.

    Returns:
        The answer as a file of answers holds it.
    """
    sides = {side: [each for each in paths if each.parent.name == side] for side in (NOW, BEFORE)}
    if all(sides.values()):
        return diagnose(sides[NOW], against=sides[BEFORE]).document()
    found = diagnose(paths)
    fresh = sorted((Path(paths[0]).parent / "fresh").glob("*.h5"))
    answer = found.document()
    if fresh and found.selected.effects:
        gaps = prediction_on(found, fresh)
        answer["fresh"] = {channel: gap.document() for channel, gap in gaps.items()}
    return answer
