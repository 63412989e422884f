"""A rig held against rules of the wire, in virtual or in real time."""

import math

from hils.clock import MonotonicClock, VirtualClock
from hils.conformance.catalogue import rules
from hils.conformance.judging import judge
from hils.conformance.probe import DEFAULT_CONFORMANCE, ConformanceSettings, Probe
from hils.conformance.rule import RuleVerdict
from hils.link.ports import AbstractPort, open_port
from tests.helpers.stepped_port import SteppedPort

START = 1000.0

Verdicts = dict[str, RuleVerdict]


def verdicts(
    port: AbstractPort,
    clock: MonotonicClock | VirtualClock,
    names: tuple[str, ...] = (),
    settings: ConformanceSettings = DEFAULT_CONFORMANCE,
) -> tuple[Verdicts, dict[str, str]]:
    """Verdict on each rule, and what was seen; the rig is left at rest.

    Args:
        port: To the rig.
        clock: Of the port.
        names: Of the rules to try; all where none is given.
        settings: Times and speeds.
    """
    chosen = [rule for rule in rules(moving=True) if not names or rule.name in names]
    assert len(chosen) == len(names) or not names, names
    probe = Probe(port, clock, settings)
    try:
        made = judge(probe, chosen)
    finally:
        probe.leave()
    return (
        {each.rule.name: each.finding.verdict for each in made},
        {each.rule.name: each.finding.seen for each in made},
    )


def stepped_verdicts(rig, names: tuple[str, ...] = ()) -> tuple[Verdicts, dict[str, str]]:
    """Verdicts on a rig in virtual time, whose power came at `START`."""
    clock = VirtualClock(START)
    return verdicts(SteppedPort(rig, clock), clock, names)


def port_verdicts(
    name: str, names: tuple[str, ...], known_broken: bool = False
) -> tuple[Verdicts, dict[str, str]]:
    """Verdicts on a rig at a real port.

    Args:
        name: Of the port.
        names: Of the rules.
        known_broken: True where the rig breaks the rules, however busy this computer is: each is
            tried once, and judged.
    """
    settings = ConformanceSettings(held_up_time=math.inf, rule_tries=1)
    port = open_port(name, 921_600)
    try:
        return verdicts(
            *(port, MonotonicClock(), names),
            settings if known_broken else DEFAULT_CONFORMANCE,
        )
    finally:
        port.close()


def broken(found: Verdicts) -> set[str]:
    """Names of the broken rules."""
    return {name for name, verdict in found.items() if verdict is RuleVerdict.BREAKS}
