"""A file of answers to blind sets."""

from pathlib import Path

import msgspec

from drftjax.common.errors import InputError
from drftjax.common.output_files import replace_file
from drftjax.common.structured_files import as_json, read_document, to_structure

SCHEMA = "drft-blind-answers"


class GapAnswer(msgspec.Struct):
    """What an answer says of one channel's misfit [mm], before and after its effects are added.

    Attributes:
        before_mm, after_mm: Misfit without and with them.
        floor_mm: What noise and scatter leave.
        shrinkage: Share of the misfit that goes on fresh runs, as promised [-].
        shrinkage_interval: Where it lies with 90 % probability; None where runs do not tell.
    """

    before_mm: float
    after_mm: float
    floor_mm: float
    shrinkage: float
    shrinkage_interval: tuple[float, float] | None


class FreshAnswer(msgspec.Struct):
    """One channel's misfit of fresh runs [mm], without and with the answer's effects.

    None with effects by which a run cannot be simulated.
    """

    before_mm: float
    after_mm: float | None


class Answer(msgspec.Struct):
    """The answer to one set.

    Attributes:
        verdict: Effects named, the likeliest first; "unknown", or "none".
        weights: Probability of each explanation that was weighed.
        groups: For each effect named, all that these runs cannot tell apart from it.
        gap, fresh: By channel.
    """

    verdict: list[str]
    weights: dict[str, float] = {}
    groups: list[list[str]] = []
    gap: dict[str, GapAnswer] = {}
    fresh: dict[str, FreshAnswer] = {}

    def named(self) -> list[str]:
        """The effects named; none where nothing is wrong."""
        return [each for each in self.verdict if each != "none"]


class Answers(msgspec.Struct):
    """A file of answers."""

    schema: str
    schema_version: int
    answers: dict[str, Answer]


def read_answers(path: Path) -> dict[str, Answer]:
    """Answers by set.

    Raises:
        InputError: names the file, the entry and what must hold.
    """
    if path.suffix.lower() != ".json":
        raise InputError(f"{path}: a file of answers must end in .json")
    document = read_document(path)
    if document.get("schema") != SCHEMA:
        raise InputError(f"{path}: holds no answers; its schema must be {SCHEMA!r}")
    if document.get("schema_version") != 1:
        raise InputError(
            f"{path}: schema_version {document.get('schema_version')} is not known here (1 is)"
        )
    return to_structure(document, Answers, path).answers


def answers_in(path: Path) -> dict[str, dict]:
    """Answers by set as they are written, with all that `Answer` leaves out.

    Raises:
        InputError: as `read_answers`.
    """
    read_answers(path)
    return dict(read_document(path)["answers"])


def write_answers(path: Path, answers: dict[str, dict]) -> None:
    """Write answers by set as a file."""
    document = {"schema": SCHEMA, "schema_version": 1, "answers": dict(sorted(answers.items()))}
    replace_file(path, as_json(document))
