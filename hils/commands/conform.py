"""`drft hils conform`: hold a rig against the rules of the wire."""

import signal
from typing import Annotated

import typer

from drftjax.commands.printing import say
from drftjax.common.errors import InputError
from hils.commands.run import WITHOUT_BAUD
from hils.link.timing import USUAL_BAUD, require_baud

LONGEST_PATIENCE = 60.0  # [s]


EXAMPLES = """
Examples:

  drft hils conform --port /dev/ttyUSB0

  drft hils conform --port /dev/ttyUSB0 --moving

  drft hils conform --port /tmp/rig --moving --yes

Without --moving a sound rig does not move, but it is armed: hang the wheel in the air, as a broken
one may turn it. With --moving it turns at 0.3 rad/s at most and the carriage goes 2 cm forth and
back; a rig that lets pass a command beyond omega_max gets one, and an ESTOP once it turns. The exit
code is 0 where no rule is broken, 1 where one is, and 2 where no rig answers. A rule that this
computer was too slow to judge, or that the rig does not allow to judge, counts as neither.
"""


def conform(
    port: Annotated[str, typer.Option(help="Serial port, or a URL such as socket://HOST:PORT.")],
    baud: Annotated[int, typer.Option(help="Baud rate of the port.")] = USUAL_BAUD,
    moving: Annotated[
        bool, typer.Option("--moving", help="Also try the rules that turn the wheel.")
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Ask nothing: the wheel hangs in the air.")
    ] = False,
    patience: Annotated[
        float,
        typer.Option(help="Wait so long [s] for a board that restarts when its port is opened."),
    ] = 0.0,
) -> None:
    """Hold a rig against the rules of the wire."""
    if not port:
        raise InputError("--port is empty, must be a device or a URL; drft hils ports lists them")
    from drftjax.common.arrays import require_between
    from hils.clock import MonotonicClock
    from hils.conformance.catalogue import rules
    from hils.conformance.judging import judge
    from hils.conformance.probe import DEFAULT_CONFORMANCE, Probe
    from hils.conformance.report import line, summary
    from hils.conformance.rule import RuleVerdict
    from hils.link.ports import open_port
    from hils.procedure.operator_prompts import TerminalPrompts, UnattendedPrompts

    require_between("patience", patience, 0.0, LONGEST_PATIENCE, " s")
    if not port.lower().startswith(WITHOUT_BAUD):
        settings = DEFAULT_CONFORMANCE
        shortest = settings.short_tick_us * 1e-6 if moving else settings.command_interval
        require_baud(baud, shortest)
    if moving:
        prompts = UnattendedPrompts() if yes else TerminalPrompts()
        prompts.confirm(
            "Hang the wheel in the air, the carriage free for 3 cm each way, your hand at the "
            "rig's own emergency stop"
        )
    opened = open_port(port, baud)
    # The order to end is no reason to leave the rig armed.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    probe = Probe(opened, MonotonicClock(), patience=patience)
    try:
        judgements = judge(probe, rules(moving), lambda each: say(line(each)))
    finally:
        # A second Ctrl-C would leave the rig to its watchdog.
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            probe.leave()
        finally:
            opened.close()
            signal.signal(signal.SIGINT, before)
    say(summary(judgements))
    if any(each.finding.verdict is RuleVerdict.BREAKS for each in judgements):
        raise typer.Exit(1)
