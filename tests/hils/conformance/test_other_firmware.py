"""A firmware in C by another hand, at a pseudo-terminal in real time: what it breaks is named."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from hils.conformance.rule import RuleVerdict
from tests.helpers.conformance import broken, port_verdicts
from tests.helpers.other_firmware import build, running

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
def program(tmp_path_factory) -> Path:
    return build(tmp_path_factory.mktemp("other"))


@pytest.fixture
def start(program: Path, tmp_path: Path) -> Iterator[Start]:
    """Start it with options; the name of its port."""
    with ExitStack() as rigs:

        def started(**options: float) -> str:
            return str(rigs.enter_context(running(program, tmp_path, **options)).port)

        yield started


def test_it_keeps_the_rules_but_for_those_that_are_named(start):
    port = start()
    found, seen = port_verdicts(port, KEPT)
    assert not broken(found), seen
    judged = [name for name, verdict in found.items() if verdict is RuleVerdict.KEEPS]
    assert len(judged) > len(KEPT) / 2, seen  # a busy computer judges less
    found, seen = port_verdicts(port, BROKEN_AS_IT_IS, known_broken=True)
    assert broken(found) == set(BROKEN_AS_IT_IS), seen


@pytest.mark.parametrize(
    ("options", "rule"),
    [
        ({"zscale_nan": 1}, "HELLO_ACK"),
        ({"omax_inf": 1}, "HELLO_ACK"),
        ({"schema": 7}, "HELLO_ACK"),
        ({"drop_every": 3}, "MEAS for each CMD"),
        ({"no_wd": 1}, "watchdog"),
        ({"noarm": 1}, "ARM"),
        ({"ignore_stop": 1}, "STOP"),
        ({"hellokeepsafe": 1}, "HELLO leads from SAFE to IDLE"),
        ({"spin_boot": 1}, "CMD in IDLE"),
        ({"spin_arm": 1}, "at rest after ARM"),
        ({"omul": 57.3}, "omega follows"),
        ({"xmul": -1}, "carriage follows"),
    ],
)
def test_an_option_that_breaks_a_rule_is_named(start, options, rule):
    found, seen = port_verdicts(start(**options), (rule,), known_broken=True)
    assert broken(found) == {rule}, seen
