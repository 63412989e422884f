"""What the system grants a program that must be timely is given back afterwards."""

import os
import subprocess
import sys
import threading

import pytest

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
    assert within == [{max(before[0])}] * 2
    assert f"SCHED_FIFO 50 on core {max(before[0])}" in granted
    assert after == before
