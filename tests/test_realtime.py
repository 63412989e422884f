"""What the system grants a program that must be timely is given back afterwards."""

import os
import subprocess
import sys

import pytest

# Is given its priority as root and gives it back as a user without privileges.
UNPRIVILEGED = """
import os
from hils.realtime import timely
with timely() as granted:
    print(any("SCHED_FIFO" in each for each in granted))
    os.setgid(65534)
    os.setuid(65534)
print(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER)
"""


@pytest.mark.skipif(not hasattr(os, "SCHED_RESET_ON_FORK"), reason="Linux only")
def test_an_unprivileged_program_gives_its_priority_back():
    done = subprocess.run(
        [sys.executable, "-c", UNPRIVILEGED], capture_output=True, text=True, check=False
    )
    if not done.stdout.startswith("True") or "PermissionError" in done.stderr:
        pytest.skip("only root may have SCHED_FIFO and become another user")
    assert done.stdout.split() == ["True", "True"], done.stderr
