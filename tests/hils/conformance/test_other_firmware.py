"""A firmware in C by another hand, at a pseudo-terminal in real time: what it breaks is named."""

import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hils.conformance.rule import RuleVerdict
from tests.helpers.c_firmware import compile_c
from tests.helpers.conformance import broken, port_verdicts

PATIENCE = 30.0  # for a process to start on a busy machine [s]

# Rules that it breaks as it is: it takes the watchdog from HELLO as it stands there, it leaves SAFE
# by ARM alone and by BYE, and its STATE never carries the number of another session.
BROKEN_AS_IT_IS = (
    "length of the watchdog",
    "another session's frame",
    "SAFE is latched",
    "another session ends this one",
    "ESTOP",
)
KEPT = (
    *("HELLO_ACK", "repeated HELLO", "MEAS by itself", "MEAS for each CMD", "clock"),
    *("wrong CRC", "wrong version", "wrong type", "wrong length", "old sequence number"),
    *("broken COBS", "overlong packet", "CMD in IDLE", "ARM", "at rest after ARM", "watchdog"),
    *("HELLO leads from SAFE to IDLE", "command that is no number", "STOP"),
    *("HELLO ends the session", "BYE", "answers to the end", "boot_id", "the rig's own frames"),
)

Start = Callable[..., str]


@pytest.fixture(scope="module")
def program(shared: Path, tmp_path_factory) -> Path:
    source = shared / "firmware" / "rig.c"
    if not source.is_file():
        pytest.skip("there is no firmware/rig.c in the folder ../shared")
    output = tmp_path_factory.mktemp("other") / "rig"
    return compile_c(output, "-w", "-O2", source, "-lm", "-lutil")


@pytest.fixture
def start(program: Path, tmp_path: Path) -> Iterator[Start]:
    """Start it with options; the name of its port."""
    rigs: list[subprocess.Popen] = []

    def started(*options: str) -> str:
        link = tmp_path / "port"
        rigs.append(subprocess.Popen([program, link, tmp_path / "log", *options]))
        deadline = time.monotonic() + PATIENCE
        while not link.is_symlink():
            assert time.monotonic() < deadline
            time.sleep(0.01)
        return str(link)

    yield started
    for rig in rigs:
        rig.kill()
        rig.wait()


def test_it_keeps_the_rules_but_for_those_that_are_named(start):
    port = start()
    found, seen = port_verdicts(port, KEPT)
    assert not broken(found), seen
    judged = [name for name, verdict in found.items() if verdict is RuleVerdict.KEEPS]
    assert len(judged) > len(KEPT) / 2, seen  # a busy computer judges less
    found, seen = port_verdicts(port, BROKEN_AS_IT_IS, known_broken=True)
    assert broken(found) == set(BROKEN_AS_IT_IS), seen


@pytest.mark.parametrize(
    ("option", "rule"),
    [
        ("zscale_nan=1", "HELLO_ACK"),
        ("omax_inf=1", "HELLO_ACK"),
        ("schema=7", "HELLO_ACK"),
        ("drop_every=3", "MEAS for each CMD"),
        ("no_wd=1", "watchdog"),
        ("noarm=1", "ARM"),
        ("ignore_stop=1", "STOP"),
        ("hellokeepsafe=1", "HELLO leads from SAFE to IDLE"),
        ("spin_boot=1", "CMD in IDLE"),
        ("spin_arm=1", "at rest after ARM"),
        ("omul=57.3", "omega follows"),
        ("xmul=-1", "carriage follows"),
    ],
)
def test_an_option_that_breaks_a_rule_is_named(start, option, rule):
    found, seen = port_verdicts(start(option), (rule,), known_broken=True)
    assert broken(found) == {rule}, seen
