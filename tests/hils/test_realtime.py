"""What the system grants a program that must be timely is given back afterwards."""

import os
import subprocess
import sys
import threading

import pytest

import hils.realtime
from hils.realtime import timely

# Is given its priority as root and gives it back as a user without privileges.
UNPRIVILEGED = """
import os
from hils.realtime import timely
cores = os.sched_getaffinity(0)
with timely() as granted:
    print(any("SCHED_FIFO" in each for each in granted))
    os.setgid(65534)
    os.setuid(65534)
print(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER)
print(os.sched_getaffinity(0) == cores)
"""


@pytest.mark.skipif(not hasattr(os, "SCHED_RESET_ON_FORK"), reason="Linux only")
def test_an_unprivileged_program_gives_its_priority_back():
    done = subprocess.run(
        [sys.executable, "-c", UNPRIVILEGED], capture_output=True, text=True, check=False
    )
    if not done.stdout.startswith("True") or "PermissionError" in done.stderr:
        pytest.skip("only root may have SCHED_FIFO and become another user")
    assert done.stdout.split() == ["True", "True", "True"], done.stderr


@pytest.mark.skipif(not hasattr(os, "SCHED_RESET_ON_FORK"), reason="Linux only")
def test_threads_that_go_first_share_one_core_until_it_is_over():
    def cores() -> list[set[int]]:
        return [os.sched_getaffinity(thread) for thread in (0, other.native_id)]

    over = threading.Event()
    other = threading.Thread(target=over.wait, daemon=True)
    other.start()
    before = cores()
    with timely() as granted:
        within = cores()
    after = cores()
    over.set()
    if not any("SCHED_FIFO" in each for each in granted):
        pytest.skip("this user may not have SCHED_FIFO")
    (core,) = within[0]
    assert core in before[0]
    assert within[1] == {core}
    assert f"SCHED_FIFO 50 on core {core}" in granted
    assert after == before


@pytest.mark.skipif(not hasattr(os, "SCHED_RESET_ON_FORK"), reason="Linux only")
def test_the_core_is_the_fastest_and_the_last_of_equals(monkeypatch, tmp_path):
    cores = sorted(os.sched_getaffinity(0))
    monkeypatch.setattr(hils.realtime, "CLOCK_RATE", f"{tmp_path}/{{}}")

    def chosen() -> str:
        with timely() as granted:
            told = [each for each in granted if "SCHED_FIFO" in each]
        if not told:
            pytest.skip("this user may not have SCHED_FIFO")
        return told[0].rpartition(" ")[2]

    assert chosen() == str(cores[-1])
    for core in cores:
        (tmp_path / str(core)).write_text("3000000\n" if core == cores[0] else "2000000\n")
    assert chosen() == str(cores[0])
