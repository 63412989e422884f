"""Blind sets answered on a Dask cluster: as without one, each once, and none lost."""

import json
import sys
import threading
import types
from contextlib import contextmanager

import msgspec
import pytest

from diagnose.blind.answers.answer import answer_sets, runs_of
from diagnose.blind.answers.answer_on_cluster import (
    ANSWER_STORE,
    AnswerOptions,
    SetFiles,
    answer_on,
    answer_packed,
    stored_answer,
)
from drftjax.cluster import connection
from drftjax.cluster.store import FinishedWork, WorkStore
from drftjax.common.errors import InputError


@pytest.fixture
def sets(tmp_path):
    """A folder of two sets with a fresh run each, and one that cannot be diagnosed."""
    folder = tmp_path / "blind"
    for name in ("set_1", "set_2", "set_3"):
        (folder / name / "fresh").mkdir(parents=True)
        for run in ("run_a", "run_b", "fresh/fresh_a"):
            (folder / name / f"{run}.h5").write_text(f"{name} {run}")
    (folder / "set_3" / "run_b.h5").write_text("damaged")
    return folder


@pytest.fixture
def seen(monkeypatch):
    """Sets that a diagnosis was asked for; it answers with what it finds in their files."""
    asked = []

    def answer_set(paths):
        asked.append(paths)
        fresh = sorted((paths[0].parent / "fresh").glob("*.h5"))
        found = {each.name: each.read_text() for each in (*paths, *fresh)}
        if "damaged" in found.values():
            raise InputError(f"{paths[1]}: is damaged")
        return {"verdict": ["none"], "weights": {"none": 1.0}, "found": found}

    module = types.ModuleType("diagnose.blind.answers.answer_set")
    module.answer_set = answer_set  # pyright: ignore[reportAttributeAccessIssue]
    monkeypatch.setitem(sys.modules, "diagnose.blind.answers.answer_set", module)
    return asked


@pytest.fixture
def threads(monkeypatch):
    """Clusters of one thread of this process, which sees the diagnosis of the test."""
    from distributed import Client, LocalCluster

    @contextmanager
    def connect(where):
        with (
            LocalCluster(
                n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
            ) as started,
            Client(started) as client,
        ):
            yield client

    monkeypatch.setattr(connection, "connect", connect)


def test_answers_are_those_without_a_cluster_and_none_is_sought_twice(
    drft, sets, seen, threads, tmp_path
):
    plain = dict(answer_sets(runs_of(sets)))
    seen.clear()
    arguments = "blind", "answer", sets, "-o", tmp_path / "answers.json", "--cluster", "local:1"
    answer = drft(*arguments)
    assert answer.code == 0, answer
    assert "no answer to set_3: run_b.h5: is damaged" in answer.out
    answers = json.loads((tmp_path / "answers.json").read_text())["answers"]
    assert answers == {name: plain[name] for name in ("set_1", "set_2")}
    assert len(seen) == 3

    # A call that goes on asks for what has no answer yet, or has changed.
    (sets / "set_2" / "fresh" / "fresh_a.h5").write_text("another")
    answer = drft(*arguments)
    assert "has 1 of these 3 sets" in answer.out
    assert len(seen) == 5
    answers = json.loads((tmp_path / "answers.json").read_text())["answers"]
    assert answers["set_2"]["found"]["fresh_a.h5"] == "another"


def test_a_killed_call_keeps_its_answers(sets, seen, threads, tmp_path, monkeypatch):
    answers = sys.modules["diagnose.blind.answers.answer_set"]
    answer_set, interrupted = answers.answer_set, threading.Event()

    def answer_first_set_at_once(paths):
        # Two quick answers may both be in before the interrupt comes.
        assert not seen or interrupted.wait(60)
        return answer_set(paths)

    monkeypatch.setattr(answers, "answer_set", answer_first_set_at_once)
    files = {name: SetFiles.at(sets / name) for name in ("set_1", "set_2")}
    path = tmp_path / "answers.store"
    settings = {"software": AnswerOptions().software}

    def interrupt(done: int, workers: int) -> None:
        if done:
            raise KeyboardInterrupt

    with connection.connect(None) as client:  # pyright: ignore[reportArgumentType]
        with (
            pytest.raises(KeyboardInterrupt),
            WorkStore(path, ANSWER_STORE, settings) as store,
        ):
            answer_on(client, files, store, interrupt)
        interrupted.set()
    with WorkStore(path, ANSWER_STORE, settings) as store:
        (done,) = [each for each in files.values() if each.digest in store]
        assert stored_answer(store, done.digest)["verdict"] == ["none"]


def test_a_set_that_changes_meanwhile_is_not_answered(sets):
    files = SetFiles.at(sets / "set_1")
    (sets / "set_1" / "run_a.h5").write_text("another")
    with pytest.raises(InputError, match="has changed since"):
        files.read()


def test_stores_and_workers_of_other_versions_are_refused(sets, tmp_path):
    with pytest.raises(InputError, match=r"must have 0\.0\.0"):
        answer_packed(msgspec.msgpack.encode(AnswerOptions("0.0.0")), [])
    path = tmp_path / "answers.store"
    with WorkStore(path, ANSWER_STORE, {"software": "0.0.0"}) as store:
        store.append([FinishedWork("aa", "set_1", {}, b"{}")])
    with pytest.raises(InputError, match="holds answers with software"):
        WorkStore(path, ANSWER_STORE, {"software": AnswerOptions().software})


@pytest.mark.parametrize("more", [("--jobs", "2"), ("--resume",)])
def test_what_has_no_meaning_on_a_cluster_is_refused(drft, sets, tmp_path, more):
    arguments = "blind", "answer", sets, "-o", tmp_path / "answers.json", "--cluster", "local:1"
    assert "leave --jobs and --resume out" in drft(*arguments, *more).refusal
    address = "--cluster", "nowhere"
    assert "must be local" in drft(*arguments[:-2], *address).refusal
    assert [each.name for each in tmp_path.iterdir()] == ["blind"]
