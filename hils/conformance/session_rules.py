"""Rules of frames and sessions, tried with a rig that stays IDLE."""

import math
import statistics
from collections.abc import Callable
from itertools import pairwise

from hils.conformance.damage import (
    Damage,
    broken_stuffing,
    old_number,
    overlong_packet,
    wrong_checksum,
    wrong_length,
    wrong_type,
    wrong_version,
)
from hils.conformance.probe import HOLD, MEAS_INTERVAL, NotPrepared, Probe
from hils.conformance.received_frame import (
    ReceivedFrame,
    is_ready,
    measurements,
    omegas,
    state_names,
)
from hils.conformance.rule import Rule, RuleFinding, finding, no_verdict
from hils.link.messages import (
    SCHEMA,
    U32,
    Arm,
    EmergencyStop,
    Hello,
    HelloAck,
    Measurement,
    StateReport,
    is_newer,
)
from hils.link.timing import watchdog_ms

FOREIGN_ANSWERS = 20  # a second, docs/reference/wire.md


def _hello_ack(probe: Probe) -> RuleFinding:
    ack = probe.connect()
    numbers = {
        "z_scale": math.isfinite(ack.z_scale) and 0.0 < abs(ack.z_scale) < 1.0,
        "x_scale": math.isfinite(ack.x_scale) and abs(ack.x_scale) < 1.0,
        "omega_max": math.isfinite(ack.omega_max) and ack.omega_max > 0.0,
        "vx_max": math.isfinite(ack.vx_max) and ack.vx_max >= 0.0,
    }
    wrong = [f"{name} {getattr(ack, name):g}" for name, right in numbers.items() if not right]
    if ack.schema != SCHEMA:
        wrong.append(f"schema 0x{ack.schema:08x}")
    seen = f"rig {ack.rig_id}, boot {ack.boot_id:08x}, omega up to {ack.omega_max:.4g} rad/s"
    return finding(not wrong, ", ".join(wrong) or seen)


def _repeated_hello(probe: Probe) -> RuleFinding:
    probe.connect()
    hello = Hello(probe.settings.tick_us, watchdog_ms(probe.settings.tick_us))
    answers = sum(probe.ask(hello) is not None for _ in range(3))
    return finding(answers == 3, f"{answers} of 3 answered")


def _watchdog_length(probe: Probe) -> RuleFinding:
    seen, keeps = [], True
    for tick_us, asked_ms in ((1_000, 20), (20_000, 100), (20_000, 0), (20_000, 0xFFFF)):
        told, rule = probe.connect(tick_us, asked_ms).watchdog_ms, watchdog_ms(tick_us)
        # Up to twice the rule's is a rig's own caution about its clock.
        if not rule <= told <= 2 * rule:
            keeps = False
            seen.append(f"{told} ms for {rule} ms (tick {tick_us} us, {asked_ms} ms asked)")
    return finding(keeps, "; ".join(seen) or "20 ms for 1 ms, 100 ms for 20 ms, whatever is asked")


def _measurement_pace(probe: Probe) -> RuleFinding:
    probe.make_idle()
    probe.listen(2 * MEAS_INTERVAL)
    times = [each.time for each, _ in measurements(probe.listen(0.6))]
    if len(times) < 2:
        return finding(False, f"{len(times)} MEAS in 0.6 s")
    mean = (times[-1] - times[0]) / (len(times) - 1)
    longest = max(later - earlier for earlier, later in pairwise(times))
    keeps = 0.75 * MEAS_INTERVAL < mean < 1.25 * MEAS_INTERVAL and longest < 3 * MEAS_INTERVAL
    return finding(keeps, f"each {mean * 1e3:.1f} ms, longest gap {longest * 1e3:.0f} ms")


def _answer_per_command(probe: Probe) -> RuleFinding:
    probe.make_idle()
    begun, seqs = len(probe.frames), []
    for _ in range(20):
        seqs.append(probe.send(HOLD))
        probe.listen(probe.settings.command_interval)
    probe.listen(probe.settings.patience)
    acks = {meas.ack_seq for _, meas in measurements(probe.frames[begun:])}
    answered = sum(seq in acks for seq in seqs)
    return finding(answered == len(seqs), f"{answered} of {len(seqs)} acknowledged by number")


def _clock(probe: Probe) -> RuleFinding:
    probe.make_idle()
    heard = [each for each, _ in measurements(probe.listen(1.0))]
    if len(heard) < 2:
        return no_verdict("too few MEAS come")
    if any(is_newer(a.frame.t_us, b.frame.t_us) for a, b in pairwise(heard)):
        return finding(False, "t_us goes back")
    # The median: a pause of either side falls into few intervals.
    rate = statistics.median(
        ((b.frame.t_us - a.frame.t_us) & U32) * 1e-6 / max(b.time - a.time, 1e-6)
        for a, b in pairwise(heard)
    )
    return finding(
        abs(rate - 1.0) < probe.settings.clock_share, f"{rate:.4f} of this computer's clock"
    )


def _drops(damage: Damage) -> Callable[[Probe], RuleFinding]:
    """Rule that frames with this damage do nothing, and that the next intact one counts."""

    def check(probe: Probe) -> RuleFinding:
        state = probe.make_idle().state
        probe.send(HOLD)
        probe.listen(2 * MEAS_INTERVAL)
        before = probe.seq
        for data in damage(probe):
            probe.transmit(data)
            probe.listen(MEAS_INTERVAL)
        heard = probe.listen(2 * MEAS_INTERVAL)
        answers = [
            each
            for each in heard
            if isinstance(each.message, StateReport | HelloAck | EmergencyStop)
            or each.state is not state
            or (isinstance(each.message, Measurement) and is_newer(each.message.ack_seq, before))
        ]
        if answers:
            return finding(False, f"it answers: {_worded(answers[0])}")
        seq = probe.send(HOLD)
        heard = probe.listen(probe.settings.patience)
        counts = any(meas.ack_seq == seq for _, meas in measurements(heard))
        return finding(counts, "no change" if counts else "the CMD behind them is not answered")

    return check


def _command_in_idle(probe: Probe) -> RuleFinding:
    probe.make_idle()
    begun, seqs = len(probe.frames), []
    for _ in range(10):
        seqs.append(probe.send(probe.turn()))
        probe.listen(probe.settings.command_interval)
    probe.listen(probe.settings.patience)
    heard = probe.frames[begun:]
    acks = {meas.ack_seq for _, meas in measurements(heard)}
    answered = sum(seq in acks for seq in seqs)
    keeps = answered == len(seqs) and not any(map(is_ready, heard))
    speeds = omegas(heard)
    turned = f"at most {max(map(abs, speeds)):.3g} rad/s" if speeds else "omega is not measured"
    return finding(keeps, f"{answered} of {len(seqs)} answered, {state_names(heard)}, {turned}")


def _foreign_frames(probe: Probe) -> RuleFinding:
    probe.make_idle()
    foreign, begun = probe.session % 0xFFFF + 1, len(probe.frames)
    for _ in range(50):
        probe.send(Arm(), foreign)
        probe.listen(MEAS_INTERVAL)
    heard = probe.frames[begun:]
    states = [each for each in heard if isinstance(each.message, StateReport)]
    right = [each for each in states if each.frame.session == foreign]
    if any(map(is_ready, heard)):
        return finding(False, f"ARM of another session is obeyed: {state_names(heard)}")
    # The second has two ends, and the computer may gather two answers.
    keeps = 0 < len(right) <= FOREIGN_ANSWERS + 2
    own = len(states) - len(right)
    return finding(keeps, f"{len(right)} STATE in a second carry it, {own} another number")


def _answers(probe: Probe) -> RuleFinding:
    try:
        probe.connect()
    except NotPrepared as silent:
        return finding(False, str(silent))
    return finding(True, "HELLO is answered after all this")


def _boot_id(probe: Probe) -> RuleFinding:
    told = {
        each.message.boot_id
        for each in probe.frames
        if isinstance(each.message, HelloAck | StateReport)
    }
    return finding(len(told) == 1, "boot " + ", ".join(f"{each:08x}" for each in sorted(told)))


def _frames(probe: Probe) -> RuleFinding:
    disordered = 0
    last: dict[int, int] = {}
    for each in probe.frames:
        session, seq = each.frame.session, each.frame.seq
        disordered += session in last and not is_newer(seq, last[session])
        last[session] = seq
    causes = [f"{count} {cause.value}" for cause, count in probe.drops.items()]
    if disordered:
        causes.append(f"{disordered} not newer than the one before")
    return finding(not causes, ", ".join(causes) or f"all {len(probe.frames)} intact and in order")


def _worded(each: ReceivedFrame) -> str:
    state = "" if each.state is None else f" that says {each.state.name}"
    return f"{type(each.message).__name__}{state}"


ALL_ELSE = "All else is dropped and counted by cause."


HELLO_RULES = (
    Rule(
        "HELLO_ACK",
        "HELLO_ACK: schema u32, rig_id u32, boot_id u32, z_scale f32 and x_scale f32, omega_max "
        "f32, vx_max f32, watchdog_ms u16, state u16; schema is 0x44524654",
        _hello_ack,
        timed=False,
    ),
    Rule(
        "repeated HELLO",
        "HELLO is repeated until a HELLO_ACK; a repeated HELLO keeps its session number.",
        _repeated_hello,
    ),
    Rule(
        "length of the watchdog",
        "watchdog = max(20 ms, 5 ticks), and cannot be turned off.",
        _watchdog_length,
        timed=False,
    ),
    Rule("MEAS by itself", "The rig sends one MEAS each 20 ms without any CMD.", _measurement_pace),
    Rule("MEAS for each CMD", "The rig sends a MEAS for each CMD.", _answer_per_command),
    Rule("clock", "t_us u32: the sender's clock in microseconds, which wraps.", _clock),
    Rule("wrong CRC", f"The CRC holds. {ALL_ELSE}", _drops(wrong_checksum)),
    Rule("wrong version", f"The version is right. {ALL_ELSE}", _drops(wrong_version)),
    Rule("wrong type", f"A type of the table, from a host. {ALL_ELSE}", _drops(wrong_type)),
    Rule("wrong length", f"The length is exactly its type's. {ALL_ELSE}", _drops(wrong_length)),
    Rule("old sequence number", f"0 < new - last < 2^31. {ALL_ELSE}", _drops(old_number)),
    Rule("broken COBS", f"COBS decodes. {ALL_ELSE}", _drops(broken_stuffing)),
    Rule("overlong packet", "The receive buffer is bounded.", _drops(overlong_packet)),
    Rule(
        "CMD in IDLE",
        "A CMD in IDLE or SAFE moves nothing and is answered by a MEAS.",
        _command_in_idle,
    ),
    Rule(
        "another session's frame",
        "A rig answers a frame of a session it does not know by a STATE that carries that session, "
        "at most 20 a second.",
        _foreign_frames,
        timed=False,
    ),
)


CLOSING_RULES = (
    Rule("answers to the end", "HELLO is repeated until a HELLO_ACK.", _answers, timed=False),
    Rule("boot_id", "boot_id differs from one power-up to the next only.", _boot_id, timed=False),
    Rule(
        "the rig's own frames",
        "CRC-32 as in zlib; a sequence number is newer than the last.",
        _frames,
        timed=False,
    ),
)
