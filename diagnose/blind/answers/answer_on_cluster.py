"""Diagnose blind sets on a Dask cluster, a set at a time, into a store of answers."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from diagnose.blind.answers.answer import answer_one, runs_of_set
from drftjax import __version__
from drftjax.cluster.connection import ClusterSettings
from drftjax.cluster.pieces import Piece, digest_of, file_bytes, require_size, unchanged
from drftjax.cluster.store import FinishedWork, StoreKind, WorkStore
from drftjax.cluster.tasks import Report, Work, work_on
from drftjax.cluster.worker_process import set_up_worker

if TYPE_CHECKING:
    from distributed import Client

# A set takes minutes: each is a task of its own.
SET_TASKS = ClusterSettings(pieces_a_task=1)

ANSWER_STORE = StoreKind("drft-answer-store", "answers", "set")


class AnswerOptions(msgspec.Struct, frozen=True):
    """Settings that the answers of one store have in common.

    Attributes:
        software: Version of this package.
    """

    software: str = __version__


class AnswerReply(msgspec.Struct, frozen=True):
    """Outcome of one set.

    Attributes:
        answer: The answer, as a file of answers holds it; none where there is a failure.
        failure: Why there is none.
    """

    answer: dict | None
    failure: str


@dataclass(frozen=True)
class SetFiles:
    """Run logs of one set, the fresh ones beside them included.

    Attributes:
        path: The set's folder.
        digest: SHA-256 of their names and bytes, in hexadecimal.
    """

    path: Path
    digest: str

    @classmethod
    def at(cls, folder: Path) -> "SetFiles":
        """Return the set in a folder.

        Raises:
            InputError: where a file cannot be read, or all together are too large.
        """
        return cls(folder, digest_of(_contents(folder)))

    def read(self) -> bytes:
        """Return names and bytes of the files, if they are still those of the digest."""
        return unchanged(_contents(self.path), self)


def _contents(folder: Path) -> bytes:
    files = sorted([*runs_of_set(folder), *folder.glob("fresh/*.h5")])
    packed = {each.relative_to(folder).as_posix(): file_bytes(each) for each in files}
    require_size(sum(map(len, packed.values())), folder)
    return msgspec.msgpack.encode(packed)


def answer_on(
    client: "Client",
    sets: Mapping[str, SetFiles],
    store: WorkStore,
    report: Report,
    numbers: ClusterSettings = SET_TASKS,
) -> dict[str, str]:
    """Diagnose sets and keep every answer as it comes.

    Args:
        client: Of the cluster.
        sets: By name; those that the store has are not diagnosed again.
        store: Where answers are kept.
        report: Called with the number of sets that are dealt with, and of workers.
        numbers: Decision numbers.

    Returns:
        Digests of sets without an answer, and why.

    Raises:
        InputError: where the cluster is lost, or cannot answer at all. The store keeps what is
            done.
    """

    def keep(answers: Sequence[tuple[Piece, bytes]]) -> dict[str, str]:
        replies = [msgspec.msgpack.decode(each, type=AnswerReply) for _, each in answers]
        pairs = list(zip([piece for piece, _ in answers], replies, strict=True))
        store.append(
            FinishedWork(each.digest, str(each.path), {}, msgspec.json.encode(reply.answer))
            for each, reply in pairs
            if not reply.failure
        )
        return {each.digest: reply.failure for each, reply in pairs if reply.failure}

    def kept() -> str:
        return f"{store.path} keeps the {len(store)} answers that are done"

    todo = [each for each in sets.values() if each.digest not in store]
    work = Work(answer_packed, msgspec.msgpack.encode(AnswerOptions()), keep, kept)
    return work_on(client, todo, work, report, numbers)


def stored_answer(store: WorkStore, digest: str) -> dict:
    """Return a set's answer from the store."""
    return msgspec.json.decode(store.result(digest), type=dict)


def answer_packed(settings: bytes, sets: Sequence[tuple[str, bytes]]) -> list[bytes]:
    """Diagnose sets one after the other, as a worker of a cluster does.

    Args:
        settings: Encoded `AnswerOptions`.
        sets: Digest, and names and bytes of the files, of each.

    Returns:
        An encoded `AnswerReply` for each.

    Raises:
        InputError: where this is another version of the package.
    """
    set_up_worker(msgspec.msgpack.decode(settings, type=AnswerOptions).software)
    import jax

    replies = []
    for _, data in sets:
        replies.append(msgspec.msgpack.encode(_answer(data)))
        # The programs compiled for a set take hundreds of megabytes.
        jax.clear_caches()
    return replies


def _answer(data: bytes) -> AnswerReply:
    with tempfile.TemporaryDirectory(prefix="drft-") as folder:
        for name, content in msgspec.msgpack.decode(data, type=dict[str, bytes]).items():
            path = Path(folder) / name
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(content)
        try:
            found = answer_one(runs_of_set(Path(folder)))
        except Exception as problem:
            # One set among many must not take the others with it, whatever it meets.
            found = f"its diagnosis broke off: {type(problem).__name__}: {problem}"
    if isinstance(found, str):
        # Sentences name the log, not where a copy of it lay.
        return AnswerReply(None, found.replace(f"{folder}/", ""))
    return AnswerReply(found, "")
