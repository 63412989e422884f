"""Several folders of sets, each with its own answers, scored as one."""

from collections.abc import Sequence
from pathlib import Path

from diagnose.blind.answers import Answer, read_answers
from diagnose.blind.sealing import open_labels
from drftjax.errors import InputError


def opened(
    folders: Sequence[Path], files: Sequence[Path]
) -> tuple[dict[str, dict], dict[str, Answer]]:
    """Labels and answers by the name of the set; of several folders, by folder and set.

    Args:
        folders: Folders of sets with their labels.
        files: The answers to each, in the same order.

    Raises:
        InputError: where a folder has no answers of its own, or one answers what it does not hold.
    """
    if len(folders) != len(files):
        raise InputError(
            f"{len(folders)} folders of sets and {len(files)} files of answers are given; each "
            "folder needs one --answers, in the same order"
        )
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise InputError("a folder of sets is given twice")
    labels: dict[str, dict] = {}
    answers: dict[str, Answer] = {}
    for folder, file in zip(folders, files, strict=True):
        before = f"{folder}/" if len(folders) > 1 else ""
        given, known = read_answers(file), open_labels(folder)
        strangers = sorted(set(given) - set(known))
        if strangers:
            raise InputError(f"{file}: answers {strangers[0]!r}, which {folder} has no label of")
        labels |= {before + name: label for name, label in known.items()}
        answers |= {before + name: answer for name, answer in given.items()}
    return labels, answers
