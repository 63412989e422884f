"""Trial of a rig: each rule in turn, and again where it seems broken."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

from drftjax.common.errors import InputError
from hils.conformance.probe import NotPrepared, Probe, WheelTurns
from hils.conformance.rule import Rule, RuleFinding, RuleVerdict, finding, no_verdict
from hils.link.messages import Bye, EmergencyStop


class Judgement(NamedTuple):
    """A rule and what was found."""

    rule: Rule
    finding: RuleFinding


def judge(
    probe: Probe, rules: Iterable[Rule], tell: Callable[[Judgement], None] = lambda _: None
) -> list[Judgement]:
    """Try a rig against rules. The caller has `probe.leave` behind it in any case.

    Once the wheel turns when it must not, it gets an ESTOP, and nothing more is tried.

    Args:
        probe: The host.
        rules: In this order.
        tell: Called with each judgement as it is made.

    Raises:
        InputError: no rig answers, or somebody pressed its own emergency stop.
        LinkLost: the line broke.
    """
    try:
        probe.connect()
    except NotPrepared as silent:
        raise InputError(
            f"no rig on {probe.name}: {silent}; is it on, and are port and baud rate its own?"
        ) from None
    made, turned = [], False
    for rule in rules:
        if turned:
            found = no_verdict("not tried: the wheel turned when it must not")
        else:
            try:
                found = _try(probe, rule)
            except WheelTurns as turning:
                turned, found = True, finding(False, str(turning))
                _halt(probe)
        made.append(Judgement(rule, found))
        tell(made[-1])
    return made


def _try(probe: Probe, rule: Rule) -> RuleFinding:
    settings = probe.settings
    probe.speed_limit = (
        2.0 * probe.omega + settings.rest_omega if rule.moving else 2.0 * settings.rest_omega
    )
    found, broken = no_verdict(""), None
    for _ in range(settings.rule_tries):
        probe.held_up = 0.0
        try:
            found = rule.check(probe)
        except NotPrepared as reason:
            found = no_verdict(str(reason))
        probe.send(Bye())
        probe.listen(settings.command_interval)
        if found.verdict is RuleVerdict.KEEPS:
            return found
        was_held_up = rule.timed and probe.held_up > settings.held_up_time
        if found.verdict is RuleVerdict.BREAKS and was_held_up:
            pause = f"this computer was held up for {probe.held_up * 1e3:.0f} ms"
            found = no_verdict(f"{pause}: {found.seen}")
        if found.verdict is RuleVerdict.BREAKS:
            broken = found
    return broken or found


def _halt(probe: Probe) -> None:
    probe.speed_limit = float("inf")
    for _ in range(probe.settings.tries):
        probe.send(EmergencyStop(1))
        probe.listen(probe.settings.try_interval)
