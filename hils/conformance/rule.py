"""A rule of the wire, and what became of it at a rig."""

import enum
from collections.abc import Callable
from typing import NamedTuple

from hils.conformance.probe import Probe


class RuleVerdict(enum.Enum):
    """Outcome of a rule; the value is its wording for a person."""

    KEEPS = "pass"
    BREAKS = "FAIL"
    NOT_JUDGED = "not judged"


class RuleFinding(NamedTuple):
    """Verdict on a rule, with what was seen in a few words."""

    verdict: RuleVerdict
    seen: str


class Rule(NamedTuple):
    """One rule of the wire.

    Attributes:
        name: A few words.
        sentence: The wire's own (docs/reference/wire.md).
        check: Tries it; it begins and ends with the rig at rest.
        timed: True where a pause of this computer may make a sound rig seem to break it.
        moving: True where the wheel or the carriage of a sound rig moves, or that of a rig which
            breaks the rule might move fast.
    """

    name: str
    sentence: str
    check: Callable[[Probe], RuleFinding]
    timed: bool = True
    moving: bool = False


def finding(keeps: bool, seen: str) -> RuleFinding:
    """Verdict by whether the rule holds."""
    return RuleFinding(RuleVerdict.KEEPS if keeps else RuleVerdict.BREAKS, seen)


def no_verdict(reason: str) -> RuleFinding:
    """Finding of a rule that cannot be judged, with the reason."""
    return RuleFinding(RuleVerdict.NOT_JUDGED, reason)
