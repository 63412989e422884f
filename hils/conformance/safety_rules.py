"""Rules of arming, the watchdog and SAFE, tried with a wheel that is commanded to rest."""

import math

from hils.conformance.probe import HOLD, MEAS_INTERVAL, Probe
from hils.conformance.received_frame import (
    ReceivedFrame,
    is_ready,
    is_safe,
    measurements,
    omegas,
    state_names,
)
from hils.conformance.rule import Rule, RuleFinding, finding, no_verdict
from hils.link.messages import (
    READY,
    Arm,
    Bye,
    Drive,
    EmergencyStop,
    Hello,
    RigState,
    StateReport,
    Stop,
)
from hils.link.timing import watchdog_ms


def watchdog(probe: Probe) -> float:
    """Length of the rig's watchdog in the present session [s]."""
    return probe.ack.watchdog_ms * 1e-3


def _arm(probe: Probe) -> RuleFinding:
    probe.make_idle()
    heard: list[ReceivedFrame] = []
    for number in range(1, probe.settings.tries + 1):
        probe.send(Arm())
        heard = probe.listen(probe.settings.try_interval, is_ready)
        if heard and is_ready(heard[-1]):
            return finding(True, f"{state_names(heard[-1:])} at ARM number {number}")
    return finding(False, f"{probe.settings.tries} ARM, and it says {state_names(heard)}")


def _armed_at_rest(probe: Probe) -> RuleFinding:
    probe.make_ready()
    heard = probe.stream(HOLD, 0.5)
    speeds = omegas(heard)
    keeps = all(map(is_ready, (each for each, _ in measurements(heard))))
    turned = f"at most {max(map(abs, speeds)):.3g} rad/s" if speeds else "omega is not measured"
    return finding(keeps, f"{state_names(heard)}, {turned}")


def _watchdog(probe: Probe) -> RuleFinding:
    probe.make_ready()
    probe.stream(HOLD, 0.2)
    probe.send(HOLD)
    return silence_finding(probe)


def silence_finding(probe: Probe) -> RuleFinding:
    """Finding on the watchdog of a rig whose last command has just been sent."""
    # A MEAS tells of SAFE at the latest 20 ms after it began.
    rule, allowance = watchdog(probe), MEAS_INTERVAL + probe.settings.allowance
    begun = probe.now()
    heard = probe.listen(2.0 * rule + allowance, is_safe)
    if not heard or not is_safe(heard[-1]):
        waited = probe.now() - begun
        return finding(False, f"{state_names(heard)} for {waited * 1e3:.0f} ms without a command")
    time = heard[-1].time - begun
    # Half the time of an answer on the way back is not known, but never shortens it by a tick.
    keeps = rule - 1e-3 <= time <= rule + allowance
    return finding(keeps, f"SAFE after {time * 1e3:.0f} ms, the watchdog is {rule * 1e3:.0f} ms")


def _safe_is_latched(probe: Probe) -> RuleFinding:
    probe.make_ready()
    heard = probe.listen(2.0 * watchdog(probe) + MEAS_INTERVAL, is_safe)
    if not heard or not is_safe(heard[-1]):
        return no_verdict("its watchdog does not make it SAFE")
    ways = []
    if any(map(is_ready, probe.stream(HOLD, 0.1))):
        ways.append("CMD")
    for message, name in ((Arm(), "ARM without HELLO"), (Bye(), "BYE")):
        probe.send(message)
        heard = probe.listen(probe.settings.patience)
        left = dict.fromkeys(each.state for each in heard if each.state is not None)
        ways += [f"{name} leads to {state.name}" for state in left if state is not RigState.SAFE]
    return finding(not ways, "; ".join(ways) or "CMD, ARM alone and BYE leave it SAFE")


def _hello_leaves_safe(probe: Probe) -> RuleFinding:
    probe.make_ready()
    probe.listen(2.0 * watchdog(probe) + MEAS_INTERVAL, is_safe)
    probe.listen(probe.settings.patience)
    after_hello = probe.connect().state
    probe.send(Arm())
    heard = probe.listen(probe.settings.patience, is_ready)
    armed = bool(heard) and is_ready(heard[-1])
    last = state_names(heard[-1:])
    keeps = after_hello is RigState.IDLE and armed
    return finding(keeps, f"{after_hello.name} after HELLO, {last} after ARM")


def _not_finite(probe: Probe) -> RuleFinding:
    nan, infinite = math.nan, math.inf
    probe.make_ready()
    begun = len(probe.frames)
    for omega, vx in ((nan, 0.0), (infinite, 0.0), (-infinite, 0.0), (0.0, nan), (0.0, infinite)):
        probe.send(Drive(omega, vx, False, HOLD.valid_ms))
        probe.send(HOLD)  # what it would do by mistake ends here
        probe.listen(probe.settings.command_interval)
    if not probe.frames[begun:] or any(map(is_safe, probe.frames[begun:])):
        return finding(False, f"{state_names(probe.frames[begun:])} at a refused command")
    return refusal_finding(probe, Drive(nan, 0.0, False, HOLD.valid_ms))


def refusal_finding(probe: Probe, refused: Drive) -> RuleFinding:
    """Finding on commands that must be refused: the watchdog must act as if none came."""
    time = watchdog(probe) + MEAS_INTERVAL + 2.0 * probe.settings.allowance
    heard = probe.stream(refused, time)
    speeds = omegas(heard)
    turned = f", at most {max(map(abs, speeds)):.3g} rad/s" if speeds else ""
    seen = "refused, and the watchdog acts" if any(map(is_safe, heard)) else "feed the watchdog"
    return finding(any(map(is_safe, heard)), seen + turned)


def _foreign_while_armed(probe: Probe) -> RuleFinding:
    probe.make_ready()
    foreign, begun = probe.session % 0xFFFF + 1, len(probe.frames)
    probe.send(Stop(), foreign)
    probe.stream(HOLD, probe.settings.patience)
    return _ends_session(probe.frames[begun:], foreign)


def _ends_session(heard: list[ReceivedFrame], session: int) -> RuleFinding:
    """Finding on a rig that has got a frame of this other session."""
    told = any(
        isinstance(each.message, StateReport) and each.frame.session == session and is_safe(each)
        for each in heard
    )
    latched = bool(heard) and is_safe(heard[-1])
    answer = "a" if told else "no"
    seen = f"{state_names(heard)}; {answer} STATE of SAFE carries that session"
    return finding(latched and told, seen)


def _stop(probe: Probe) -> RuleFinding:
    probe.make_ready()
    probe.stream(HOLD, 0.1)
    probe.send(Stop())
    heard = probe.listen(0.4 * watchdog(probe))
    after = [each.state for each in heard if each.state is not None]
    if not after:
        return no_verdict("no frame tells its state")
    probe.send(HOLD)
    again = probe.listen(0.4 * watchdog(probe))
    keeps = after[-1] is RigState.ARMED and bool(again) and again[-1].state in READY
    return finding(keeps, f"{state_names(heard)} after STOP, {state_names(again)} after a CMD")


def _estop(probe: Probe) -> RuleFinding:
    probe.make_ready()
    begun = len(probe.frames)
    probe.send(EmergencyStop(1))
    # At once, and before the watchdog would.
    answered = probe.listen(0.5 * watchdog(probe), _is_stopped)
    after = len(probe.frames)
    probe.send(Arm())
    probe.stream(HOLD, 0.2)
    heard = probe.frames[after:]
    keeps = (
        any(map(_is_stopped, answered))
        and not any(map(is_ready, heard))
        and any(map(is_safe, heard))
    )
    return finding(keeps, f"{state_names(probe.frames[begun:])}, with ARM and CMD behind")


def _is_stopped(each: ReceivedFrame) -> bool:
    return is_safe(each) or isinstance(each.message, EmergencyStop)


def _hello_while_armed(probe: Probe) -> RuleFinding:
    probe.make_ready()
    heard = probe.stream(HOLD, 0.1)
    before = heard[-1].state if heard else None
    begun = len(probe.frames)
    settings = probe.settings
    ack = probe.ask(Hello(settings.tick_us, watchdog_ms(settings.tick_us)))
    if ack is None:
        return finding(False, "no HELLO_ACK")
    after = len(probe.frames)
    probe.stream(HOLD, 0.2)
    moves = any(map(is_ready, probe.frames[after:]))
    # The rule is of a rig that runs; one that was only armed may be IDLE at once.
    safe = any(map(is_safe, probe.frames[begun:])) or before is not RigState.RUNNING
    return finding(safe and not moves, f"{state_names(probe.frames[begun:])}, with CMD behind")


def _bye(probe: Probe) -> RuleFinding:
    probe.make_ready()
    probe.stream(HOLD, 0.1)
    probe.send(Bye())
    heard = probe.listen(0.5 * watchdog(probe))  # before it would make it SAFE
    after = probe.connect().state
    said = f"{state_names(heard)} after BYE, " if heard else ""
    return finding(after is RigState.IDLE, f"{said}{after.name} at the next HELLO")


SAFETY_RULES = (
    Rule("ARM", "ARM is repeated until a STATE or a MEAS that says ARMED or RUNNING.", _arm),
    Rule("at rest after ARM", "CMD: omega f32 [rad/s]; 0 stands.", _armed_at_rest),
    Rule(
        "watchdog",
        "It goes SAFE when `watchdog_ms` pass without a valid CMD; it runs from ARM.",
        _watchdog,
    ),
    Rule(
        "SAFE is latched",
        "SAFE is left only by a new HELLO (to IDLE, with the wheel at rest) and ARM.",
        _safe_is_latched,
        timed=False,
    ),
    Rule(
        "HELLO leads from SAFE to IDLE",
        "SAFE is left only by a new HELLO (to IDLE, with the wheel at rest) and ARM.",
        _hello_leaves_safe,
        timed=False,
    ),
    Rule(
        "command that is no number",
        "A non-finite or larger command is refused, not clipped in silence; without a valid CMD "
        "the watchdog acts.",
        _not_finite,
    ),
    Rule(
        "another session ends this one",
        "A session mismatch ends the session: SAFE, and a STATE that carries that session.",
        _foreign_while_armed,
        timed=False,
    ),
    Rule("STOP", "STOP: ramp to rest, stay armed.", _stop),
    Rule("ESTOP", "ESTOP: rest at once, latched.", _estop, timed=False),
    Rule(
        "HELLO ends the session",
        "A HELLO while running ends the session: SAFE, and no motion until ARM.",
        _hello_while_armed,
        timed=False,
    ),
    Rule("BYE", "BYE from a host; read here as the end of the session, IDLE.", _bye, timed=False),
)
