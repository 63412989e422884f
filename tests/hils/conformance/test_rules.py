"""Each rule passes at a sound rig and fails at one that breaks it, in virtual time."""

import pytest

from hils.conformance.catalogue import rules
from hils.conformance.judging import Judgement
from hils.conformance.report import line, summary
from hils.conformance.rule import Rule, RuleVerdict, finding, no_verdict
from hils.link.messages import RigState
from hils.rig_sim.config import VirtualSetUp
from hils.rig_sim.firmware import RigIdentity
from hils.rig_sim.in_process import QUICK, rig_physics
from hils.rig_sim.rig import VirtualRig
from tests.helpers.c_firmware import CFirmware
from tests.helpers.conformance import START, stepped_verdicts

ME = RigIdentity(boot_id=7)
# Rules of frames that other rules must bring about first.
BEFORE = {
    "boot_id": ("ARM",),
    "the rig's own frames": ("ARM",),
    "answers to the end": ("overlong packet",),
}
# The rule, and a change of the firmware in C that breaks it: text that stands there, and its
# substitute, in which {0} is that text.
BREAKAGES = {
    "HELLO_ACK": ("put_float(p, me->z_scale)", "put_float(p, 0.0f)"),
    "repeated HELLO": ("case HELLO: hello(r, session, seq, payload); break;", ""),
    "length of the watchdog": ("if (watchdog_ms < LEAST_WATCHDOG_MS)", "if (0)"),
    "MEAS by itself": ("#define MEAS_INTERVAL_US 20000u", "#define MEAS_INTERVAL_US 40000u"),
    "MEAS for each CMD": ("r->ack_seq = seq;", "r->ack_seq = seq & ~1u;"),
    "clock": ("r->next_seq++), r->now);", "r->next_seq++), r->now / 1000u);"),
    "wrong CRC": ("        return RIG_DROP_CRC;", "        (void)0;"),
    "wrong version": ("if (body[0] != VERSION)", "if (0)"),
    "wrong type": ("return RIG_DROP_TYPE;", "type = ((uint8_t *)(size_t)body)[1] = ARM;"),
    "wrong length": ("(count != HEADER", "(count < HEADER"),
    "old sequence number": ("newer >= 0x80000000u", "0"),
    "broken COBS": ("r->length = 0; r->overlong = 0;", "if (r->length > 12) { {0} }"),
    "overlong packet": ("r->length = 0; r->overlong = 0;", "r->length = 0;"),
    "CMD in IDLE": ("    send_meas(r, &reading);\n}\n\n", "if (is_ready(r)) {0}"),
    "another session's frame": (
        "send_state(r, session, RIG_ANOTHER_SESSION);",
        "send_state(r, r->session, RIG_ANOTHER_SESSION);",
    ),
    "ARM": ("set_state(r, RIG_ARMED, RIG_NO_REASON);", ""),
    "at rest after ARM": ("r->watchdog_us;\n            r->lapses", "0;\n            r->lapses"),
    "watchdog": ("go_safe(r, RIG_WATCHDOG, 0)", "(void)0"),
    "SAFE is latched": ("if (!r->greeted)", "if (0)"),
    "HELLO leads from SAFE to IDLE": ("!was_ready && r->omega", "was_ready && r->omega"),
    "command that is no number": (
        "size_of(omega) <= r->identity.omega_max",
        "!(size_of(omega) > r->identity.omega_max)",
    ),
    "another session ends this one": ("go_safe(r, RIG_ANOTHER_SESSION, type == ESTOP);", ""),
    "STOP": ("case STOP: stop(r); break;", "case STOP: go_safe(r, 4, 0); break;"),
    "ESTOP": ("go_safe(r, RIG_HOST_STOPPED, 1);", "stop(r);"),
    "HELLO ends the session": ("if (was_ready) go_safe", "if (0) go_safe"),
    "BYE": ("if (is_ready(r)) set_state(r, RIG_IDLE, RIG_BYE);", ""),
    "omega follows": ("b->protocol.omega};", "-b->protocol.omega};"),
    "carriage follows": ("? b->protocol.vx", "? -b->protocol.vx"),
    "command beyond omega_max": ("(omega) <= r->identity.omega_max", "(omega) < 9.0f"),
    "STOP ramps to rest": ("stop(rig *r) {\n    ramp_to_rest(r);", "stop(rig *r) {"),
    "STOP feeds the watchdog": ("r->watchdog_us + (uint32_t)ramp_us", "r->watchdog_us"),
    "ESTOP stops the wheel": (
        "go_safe(r, RIG_HOST_STOPPED, 1);",
        "set_state(r, RIG_SAFE, RIG_HOST_STOPPED);",
    ),
    "watchdog stops the wheel": ("    ramp_to_rest(r);\n    r->vx = 0.0f;", "    r->vx = 0.0f;"),
    "another session stops the wheel": ("go_safe(r, RIG_ANOTHER_SESSION, type == ESTOP);", ""),
    "HELLO stops the wheel": ("if (was_ready) go_safe", "if (0) go_safe"),
    "answers to the end": ("r->length = 0; r->overlong = 0;", "r->length = 0;"),
    "boot_id": ("reason), r->identity.boot_id)", "reason), r->next_seq)"),
    "the rig's own frames": ("put16(p, session), r->next_seq++)", "put16(p, session), 5u)"),
}  # fmt: skip


def test_the_reference_firmware_keeps_every_rule_and_is_left_idle():
    rig = CFirmware(ME, start=START)
    found, seen = stepped_verdicts(rig)
    assert set(found.values()) == {RuleVerdict.KEEPS}, seen
    assert len(found) == len(rules(moving=True))
    assert (rig.state, rig.demand) == (RigState.IDLE, (0.0, 0.0))


def test_the_virtual_rig_keeps_every_rule():
    setup = VirtualSetUp(physics=QUICK)
    rig = VirtualRig(setup, rig_physics(setup), None, 0, 0, 0.0, START)
    found, seen = stepped_verdicts(rig)
    assert set(found.values()) == {RuleVerdict.KEEPS}, seen
    assert rig.state is RigState.IDLE


@pytest.mark.parametrize("name", BREAKAGES)
def test_a_rig_that_breaks_a_rule_is_told_so(name):
    old, new = BREAKAGES[name]
    rig = CFirmware(ME, start=START, change=(old, new.replace("{0}", old)))
    found, seen = stepped_verdicts(rig, (*BEFORE.get(name, ()), name))
    assert found[name] is RuleVerdict.BREAKS, seen


def test_every_rule_is_broken_once():
    assert list(BREAKAGES) == [rule.name for rule in rules(moving=True)]


def test_a_wheel_that_turns_by_itself_gets_an_estop_and_ends_the_trial():
    change = ("set_state(r, RIG_ARMED, RIG_NO_REASON);", "{0} r->omega = 1.5f;")
    rig = CFirmware(ME, start=START, change=(change[0], change[1].replace("{0}", change[0])))
    found, seen = stepped_verdicts(rig, ("ARM", "at rest after ARM", "watchdog", "STOP"))
    assert found["at rest after ARM"] is RuleVerdict.BREAKS
    assert seen["at rest after ARM"] == "the wheel is measured to turn at 1.45 rad/s"
    assert {found["watchdog"], found["STOP"]} == {RuleVerdict.NOT_JUDGED}
    assert rig.emergency_stops >= 1
    assert rig.demand == (0.0, 0.0)


def test_what_the_rig_does_not_measure_is_not_judged():
    rig = CFirmware(RigIdentity(boot_id=7, x_scale=0.0), start=START)
    found, seen = stepped_verdicts(rig, ("carriage follows",))
    assert found == {"carriage follows": RuleVerdict.NOT_JUDGED}
    assert seen == {"carriage follows": "x is not measured"}


def test_the_table_quotes_the_wire_where_a_rule_is_broken():
    rule = Rule("clock", "t_us u32: the sender's clock.", lambda probe: no_verdict(""))
    kept = Judgement(rule, finding(True, "right"))
    assert line(kept).split() == ["pass", "clock", "right"]
    failed = Judgement(rule, finding(False, "it stands"))
    assert line(failed).endswith('it stands\n            "t_us u32: the sender\'s clock."')
    unknown = Judgement(rule, no_verdict("too few"))
    assert summary([kept, failed, failed, unknown]) == (
        "4 rules: 1 kept, 2 broken (clock, clock), 1 not judged."
    )
