"""File of answers to blind sets."""

from pathlib import Path

import msgspec

from drftjax.common.errors import InputError
from drftjax.common.output_files import replace_file
from drftjax.common.structured_files import as_json, read_document, to_structure

SCHEMA = "drft-blind-answers"


class GapAnswer(msgspec.Struct):
    """Gap of one channel in an answer, without and with the effects that it names.

    Attributes:
        before_mm, after_mm: Gap without and with the effects [mm].
        floor_mm: Noise floor [mm].
        shrinkage: Predicted share of the gap that the effects remove on fresh runs [-].
        shrinkage_interval: Its 90 % interval; None if the runs do not determine it.
    """

    before_mm: float
    after_mm: float
    floor_mm: float
    shrinkage: float
    shrinkage_interval: tuple[float, float] | None


class FreshAnswer(msgspec.Struct):
    """Gap of one channel on fresh runs.

    Attributes:
        before_mm: Gap without the effects of the answer [mm].
        after_mm: Gap with them [mm]; None if a run cannot be simulated with them.
    """

    before_mm: float
    after_mm: float | None


class NumberAnswer(msgspec.Struct):
    """Number of an effect.

    Attributes:
        value: In `unit`.
        unit: SI unit, "-" for none.
    """

    value: float
    unit: str = ""


class ShareAnswer(msgspec.Struct):
    """Share of an effect in the gap of one channel above the noise floor [-]."""

    share: float


class ChannelBudgetAnswer(msgspec.Struct):
    """Shares of effects in the gap of one channel.

    Attributes:
        floor: Noise floor [mm].
        effects: Shares by effect.
    """

    floor: float
    effects: dict[str, ShareAnswer] = {}


class BudgetAnswer(msgspec.Struct):
    """Budget of the gap.

    Attributes:
        channels: Shares by channel.
    """

    channels: dict[str, ChannelBudgetAnswer] = {}


class Answer(msgspec.Struct):
    """Answer to one set.

    Attributes:
        verdict: Effects named, the most probable first; "unknown", or "none".
        weights: Probability of each hypothesis.
        groups: For each effect named, all effects that these runs cannot distinguish from it.
        gap: Gap of the runs of the set, by channel.
        fresh: Gap of its fresh runs, by channel.
        parameters: Numbers of the effects named, by effect and number.
        budget: Shares of the effects in the gap; None without a budget.
    """

    verdict: list[str]
    weights: dict[str, float] = {}
    groups: list[list[str]] = []
    gap: dict[str, GapAnswer] = {}
    fresh: dict[str, FreshAnswer] = {}
    parameters: dict[str, dict[str, NumberAnswer]] = {}
    budget: BudgetAnswer | None = None

    def named(self) -> list[str]:
        """Effects named; empty for the verdict "none"."""
        return [each for each in self.verdict if each != "none"]


class Answers(msgspec.Struct):
    """Contents of a file of answers."""

    schema: str
    schema_version: int
    answers: dict[str, Answer]


def read_answers(path: Path) -> dict[str, Answer]:
    """Read answers, by the name of the set.

    Raises:
        InputError: The file is not a valid file of answers; names the entry and the rule.
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


def read_raw_answers(path: Path) -> dict[str, dict]:
    """Read answers as they are written, with all that `Answer` leaves out, by set.

    Raises:
        InputError: As `read_answers`.
    """
    read_answers(path)
    return dict(read_document(path)["answers"])


def write_answers(path: Path, answers: dict[str, dict]) -> None:
    """Write answers, by the name of the set."""
    document = {"schema": SCHEMA, "schema_version": 1, "answers": dict(sorted(answers.items()))}
    replace_file(path, as_json(document))
