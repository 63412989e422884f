"""Rules that turn the wheel or move the carriage, or that a broken rig might answer by motion."""

from hils.conformance.probe import HOLD, Probe
from hils.conformance.received_frame import (
    ReceivedFrame,
    is_safe,
    measurements,
    omegas,
    state_names,
)
from hils.conformance.rule import Rule, RuleFinding, finding, no_verdict
from hils.conformance.safety_rules import refusal_finding, watchdog
from hils.link.messages import Arm, Drive, EmergencyStop, Hello, RigState, Stop
from hils.link.timing import watchdog_ms

REST_TIME = 1.0  # for a ramp to rest, within which every rule's must end [s]


def _omega_follows(probe: Probe) -> RuleFinding:
    probe.make_ready()
    seen, keeps = [], True
    for sign in (1.0, -1.0):
        probe.stream(probe.turn(sign), probe.settings.turn_time)
        speeds = omegas(probe.stream(probe.turn(sign), 0.2))
        if not speeds:
            return no_verdict("omega is not measured")
        asked, mean = sign * probe.omega, sum(speeds) / len(speeds)
        keeps = keeps and abs(mean - asked) <= probe.settings.follow_share * abs(asked)
        seen.append(f"{mean:+.3f} for {asked:+.3f} rad/s")
    return finding(keeps, ", ".join(seen))


def _carriage_follows(probe: Probe) -> RuleFinding:
    ack = probe.make_idle()
    speed = min(probe.settings.vx, 0.5 * ack.vx_max)
    if ack.x_scale == 0.0 or not speed > 0.0:
        return no_verdict("x is not measured" if ack.x_scale == 0.0 else "vx_max is 0")
    probe.make_ready()
    # Not driven, a stated speed means nothing.
    free = _travel(probe, Drive(0.0, speed, False, HOLD.valid_ms))
    there = _travel(probe, Drive(0.0, speed, True, HOLD.valid_ms))
    back = _travel(probe, Drive(0.0, -speed, True, HOLD.valid_ms))
    way = speed * probe.settings.turn_time
    keeps = abs(free) < 0.2 * way and all(0.5 * way < each < 1.5 * way for each in (there, -back))
    seen = f"{there * 1e3:+.1f} and {back * 1e3:+.1f} mm for {way * 1e3:.1f} mm each way, "
    return finding(keeps, f"{seen}{free * 1e3:+.1f} mm not driven")


def _travel(probe: Probe, command: Drive) -> float:
    """Way [m] in the time of a turn, a first fifth of it left to the slew limit."""
    whole = probe.settings.turn_time
    probe.stream(command, 0.2 * whole)
    counts = [meas.x for _, meas in measurements(probe.stream(command, whole))]
    return (counts[-1] - counts[0]) * probe.ack.x_scale if counts else 0.0


def _too_large(probe: Probe) -> RuleFinding:
    probe.make_ready()
    return refusal_finding(probe, Drive(1.25 * probe.ack.omega_max, 0.0, False, HOLD.valid_ms))


def _stop_ramps(probe: Probe) -> RuleFinding:
    probe.make_turn(probe.settings.long_tick_us)
    begun = probe.now()
    probe.send(Stop())
    heard = probe.listen(0.9 * watchdog(probe))  # which would stop the wheel, too
    armed = bool(heard) and heard[-1].state is RigState.ARMED
    return _rest(probe, heard, begun, armed, state_names(heard))


def _stop_feeds(probe: Probe) -> RuleFinding:
    probe.make_turn(probe.settings.short_tick_us)
    begun = probe.now()
    probe.send(Stop())
    heard = probe.listen(REST_TIME)
    turning = [
        each for each, meas in measurements(heard) if abs(meas.omega) > probe.settings.rest_omega
    ]
    early = [each for each in turning if is_safe(each)]
    if early:
        return finding(False, "SAFE while the wheel still ramps")
    ramp = (turning[-1].time - begun) if turning else 0.0
    if ramp <= watchdog(probe):
        return no_verdict(f"the ramp ends within the watchdog of {watchdog(probe) * 1e3:.0f} ms")
    return finding(True, f"turned for {ramp * 1e3:.0f} ms, SAFE only after")


def _estop_stops(probe: Probe) -> RuleFinding:
    probe.make_turn()
    begun = probe.now()
    probe.send(EmergencyStop(1))
    heard = probe.listen(REST_TIME)
    return _rest(probe, heard, begun, any(map(is_safe, heard)), state_names(heard))


def _watchdog_stops(probe: Probe) -> RuleFinding:
    probe.make_turn()
    begun = probe.now()
    heard = probe.listen(2.0 * watchdog(probe) + REST_TIME)
    return _rest(probe, heard, begun, any(map(is_safe, heard)), state_names(heard))


def _foreign_stops(probe: Probe) -> RuleFinding:
    probe.make_turn()
    begun = probe.now()
    probe.send(Arm(), probe.session % 0xFFFF + 1)
    heard = probe.stream(probe.turn(), REST_TIME)
    return _rest(probe, heard, begun, bool(heard) and is_safe(heard[-1]), state_names(heard))


def _hello_stops(probe: Probe) -> RuleFinding:
    probe.make_turn()
    begun, fresh = probe.now(), len(probe.frames)
    probe.ask(Hello(probe.settings.tick_us, watchdog_ms(probe.settings.tick_us)))
    probe.stream(probe.turn(), REST_TIME)
    heard = probe.frames[fresh:]
    return _rest(probe, heard, begun, any(map(is_safe, heard)), state_names(heard))


def _rest(
    probe: Probe, heard: list[ReceivedFrame], begun: float, keeps: bool, states: str
) -> RuleFinding:
    """Finding on a wheel that must have come to rest since `begun`, where the states are right."""
    limit = probe.settings.rest_omega
    turning = [each.time for each, meas in measurements(heard) if abs(meas.omega) > limit]
    last = omegas(heard)[-1:]
    rests = bool(last) and abs(last[0]) <= limit
    took = (max(turning) - begun) if turning else 0.0
    seen = f"turned for another {took * 1e3:.0f} ms" if rests else "it does not come to rest"
    return finding(keeps and rests, f"{states}, {seen}")


MOVING_RULES = tuple(
    Rule(name, sentence, check, moving=True)
    for name, sentence, check in (
        ("omega follows", "omega and vx positive forward; CMD: omega f32 [rad/s].", _omega_follows),
        ("carriage follows", "x grows forward; vx counts only with bit 0.", _carriage_follows),
        (
            "command beyond omega_max",
            "A non-finite or larger command is refused, not clipped in silence.",
            _too_large,
        ),
        ("STOP ramps to rest", "STOP: ramp to rest, stay armed.", _stop_ramps),
        ("STOP feeds the watchdog", "STOP feeds it for the time of one ramp.", _stop_feeds),
        ("ESTOP stops the wheel", "ESTOP: rest at once, latched.", _estop_stops),
        ("watchdog stops the wheel", "SAFE: omega ramps to 0, vx 0.", _watchdog_stops),
        (
            "another session stops the wheel",
            "A session mismatch ends the session: SAFE, and no motion until ARM.",
            _foreign_stops,
        ),
        (
            "HELLO stops the wheel",
            "A HELLO while running ends the session: SAFE, and no motion until ARM.",
            _hello_stops,
        ),
    )
)
