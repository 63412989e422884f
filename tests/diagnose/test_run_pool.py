"""Threads over the runs of a dataset: work that is done once, and the longest runs first."""

from concurrent.futures import ThreadPoolExecutor
from threading import Event, Lock

import pytest

from diagnose.dataset import RigDataset
from diagnose.run_pool import RunPool
from tests.helpers.synthetic_runs import coarse, recorded, setup_of


def test_work_of_one_key_is_done_once_whoever_asks():
    done, lock = [], Lock()

    def work() -> None:
        with lock:
            done.append(1)

    with RunPool() as pool:
        pool.map_outer(lambda _: pool.begin("program", work).result(), range(8))
        pool.begin("another", work).result()
    assert len(done) == 2


def test_work_that_is_begun_is_not_waited_for():
    may_end, done = Event(), []

    def work() -> None:
        may_end.wait()
        done.append(1)

    with RunPool() as pool:
        pool.begin("program", work)
        assert not done
        may_end.set()
        pool.begin("program", work).result()
        assert done == [1]


def test_everyone_who_waits_is_told_of_a_failure():
    def work() -> None:
        raise ValueError("does not compile")

    with RunPool() as pool:
        for _ in range(2):
            with pytest.raises(ValueError, match="does not compile"):
                pool.begin("program", work).result()


def test_the_longest_run_is_begun_first_and_each_result_is_its_runs():
    ends = (2.0, 6.0, 4.0)
    profiles = [([0.0, 0.3, 0.8, end], [0.0, 0.0, 0.8, 0.8]) for end in ends]
    dataset = RigDataset.of(
        [
            coarse(f"run {end:g}", recorded(setup_of(each)))
            for end, each in zip(ends, profiles, strict=True)
        ]
    )
    begun = []

    def work(run: int) -> str:
        begun.append(run)
        return dataset.runs[run].name

    # One thread takes the runs in the order in which they are handed over.
    with RunPool(inner=ThreadPoolExecutor(1)) as pool:
        assert dataset.map(pool, work) == ["run 2", "run 6", "run 4"]
    assert begun == [1, 2, 0]
