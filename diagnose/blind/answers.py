"""Answers to blind sets: what a diagnosis says of each from its runs alone. Never opens a label."""

import json
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import msgspec

from drftjax.errors import InputError
from drftjax.runlog.replace import replace_file
from drftjax.structfile import read_document, to_structure

SCHEMA = "drft-blind-answers"


class GapAnswer(msgspec.Struct):
    """What an answer says of one channel's misfit [mm], before and after its effects are added.

    Attributes:
        before_mm, after_mm: Misfit without and with them.
        floor_mm: What noise and scatter leave.
        shrinkage: Share of the misfit that goes on fresh runs, as promised [-].
        shrinkage_interval: Where it lies with 90 % probability.
    """

    before_mm: float
    after_mm: float
    floor_mm: float
    shrinkage: float
    shrinkage_interval: tuple[float, float]


class FreshAnswer(msgspec.Struct):
    """One channel's misfit of fresh runs [mm], without and with the answer's effects."""

    before_mm: float
    after_mm: float


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
    document = read_document(path)
    if document.get("schema") != SCHEMA:
        raise InputError(f"{path}: holds no answers; its schema must be {SCHEMA!r}")
    if document.get("schema_version") != 1:
        raise InputError(
            f"{path}: schema_version {document.get('schema_version')} is not known here (1 is)"
        )
    return to_structure(document, Answers, path).answers


def write_answers(path: Path, answers: dict[str, dict]) -> None:
    """Write answers by set as a file."""
    document = {"schema": SCHEMA, "schema_version": 1, "answers": dict(sorted(answers.items()))}
    replace_file(path, (json.dumps(document, indent=1) + "\n").encode())


def runs_of(folder: Path) -> dict[str, list[Path]]:
    """The run logs of every set in a folder; fresh runs lie deeper and are none of them.

    Raises:
        InputError: where there are no sets.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder of sets")
    sets = {
        each.name: sorted(each.glob("*.h5")) for each in sorted(folder.iterdir()) if each.is_dir()
    }
    sets = {name: runs for name, runs in sets.items() if runs}
    if not sets:
        raise InputError(f"{folder} holds no sets; a set is a folder of run logs")
    return sets


def answer_one(runs: list[Path]) -> dict | str:
    """The answer to one set, or why there is none."""
    from diagnose.answer import answer_set

    try:
        return answer_set(runs)
    except InputError as problem:
        return str(problem)


def answer_all(folder: Path, jobs: int = 1) -> Iterator[tuple[str, dict | str]]:
    """Every set's name and answer, as it is found, or why there is none.

    Args:
        folder: The sets.
        jobs: Processes to find them in.
    """
    sets = runs_of(folder)
    if jobs == 1:
        for name, runs in sets.items():
            yield name, answer_one(runs)
        return
    # A fresh process, as JAX's threads do not live through a fork.
    with ProcessPoolExecutor(jobs, get_context("spawn"), configure) as pool:
        waiting = {pool.submit(answer_one, runs): name for name, runs in sets.items()}
        for done in as_completed(waiting):
            yield waiting[done], done.result()


def configure() -> None:
    """Set a fresh process's JAX up as the command line's."""
    from drftjax.commands.runtime import configure_jax

    configure_jax()
