#include "rig_protocol.h"

#include <string.h>

enum { HELLO = 1, HELLO_ACK, ARM, CMD, MEAS, STOP, ESTOP, STATE, BYE, TYPES };

static const uint8_t payload_length[TYPES] = {0, 12, 32, 0, 12, 20, 0, 2, 8, 0};

enum { VERSION = 1, HEADER = 12, CHECKSUM = 4, STOP_TRIES = 5 };

#define MEAS_INTERVAL_US 20000u
#define REPEAT_INTERVAL_US 50000u /* of the rig's ESTOP; also 1 s / 20 answers to other sessions */
#define LEAST_WATCHDOG_MS 20u
#define LONGEST_WATCHDOG_MS 65535u
#define LONGEST_STEP_US 20000u    /* a loop that was held up must not make the drive jump */

static uint16_t get16(const uint8_t *p) { return (uint16_t)(p[0] | (uint16_t)p[1] << 8); }

static uint32_t get32(const uint8_t *p) { return get16(p) | (uint32_t)get16(p + 2) << 16; }

static float get_float(const uint8_t *p) {
    uint32_t bits = get32(p);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static uint8_t *put16(uint8_t *p, uint16_t value) {
    p[0] = (uint8_t)value;
    p[1] = (uint8_t)(value >> 8);
    return p + 2;
}

static uint8_t *put32(uint8_t *p, uint32_t value) {
    return put16(put16(p, (uint16_t)value), (uint16_t)(value >> 16));
}

static uint8_t *put_float(uint8_t *p, float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return put32(p, bits);
}

static uint32_t crc32(const uint8_t *p, size_t count) {
    uint32_t crc = 0xFFFFFFFFu;
    while (count--) {
        crc ^= *p++;
        for (int bit = 0; bit < 8; bit++) crc = crc >> 1 ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

/* No packet reaches 254 bytes, so the long blocks of COBS do not occur. */
static size_t cobs_encode(const uint8_t *in, size_t count, uint8_t *out) {
    size_t code = 0, to = 1;
    for (size_t i = 0; i < count; i++) {
        if (in[i] == 0) {
            out[code] = (uint8_t)(to - code);
            code = to++;
        } else out[to++] = in[i];
    }
    out[code] = (uint8_t)(to - code);
    return to;
}

/* In place; -1 where the bytes are none of COBS. */
static int cobs_decode(uint8_t *bytes, size_t count) {
    size_t from = 0, to = 0;
    while (from < count) {
        size_t block = bytes[from++] - 1u;
        if (block > count - from) return -1;
        memmove(bytes + to, bytes + from, block);
        to += block;
        from += block;
        if (from < count) bytes[to++] = 0;
    }
    return (int)to;
}

/* Sending ------------------------------------------------------------------------------------ */

static void send(rig *r, uint8_t type, uint16_t session, const uint8_t *payload) {
    uint8_t body[HEADER + 32 + CHECKSUM], frame[RIG_LONGEST_FRAME];
    size_t count = payload_length[type];
    uint8_t *p = body;
    *p++ = VERSION;
    *p++ = type;
    p = put32(put32(put16(p, session), r->next_seq++), r->now);
    if (count) memcpy(p, payload, count);
    p = put32(p + count, crc32(body, HEADER + count));
    frame[0] = 0;
    count = cobs_encode(body, (size_t)(p - body), frame + 1);
    frame[count + 1] = 0;
    r->bench.send(r->bench.context, frame, count + 2);
}

static void send_state(rig *r, uint16_t session, uint16_t reason) {
    uint8_t payload[8];
    put32(put16(put16(payload, (uint16_t)r->state), reason), r->identity.boot_id);
    send(r, STATE, session, payload);
}

static void tell_state(rig *r) { if (r->open) send_state(r, r->session, r->reason); }

static void send_estop(rig *r) {
    uint8_t payload[2];
    put16(payload, r->stop_reason);
    if (r->open) send(r, ESTOP, r->session, payload);
}

static void send_meas(rig *r, const rig_reading *reading) {
    uint8_t payload[20], *p = put32(payload, r->ack_seq);
    p = put_float(put32(put32(p, (uint32_t)reading->z), (uint32_t)reading->x), reading->omega);
    put16(put16(p, (uint16_t)r->state), r->fault);
    send(r, MEAS, r->session, payload);
}

static void send_hello_ack(rig *r, uint16_t session, uint16_t watchdog_ms) {
    const rig_identity *me = &r->identity;
    uint8_t payload[32], *p = put32(put32(put32(payload, RIG_SCHEMA), me->rig_id), me->boot_id);
    p = put_float(put_float(p, me->z_scale), me->x_scale);
    p = put_float(put_float(p, me->omega_max), me->vx_max);
    put16(put16(p, watchdog_ms), (uint16_t)r->state);
    send(r, HELLO_ACK, session, payload);
}

static int is_ready(const rig *r) { return r->state == RIG_ARMED || r->state == RIG_RUNNING; }

static int is_due(uint32_t now, uint32_t time) { return (int32_t)(now - time) >= 0; }

static float size_of(float value) { return value < 0.0f ? -value : value; }

static void apply(rig *r) { r->bench.drive(r->bench.context, r->omega, r->vx, r->driven); }

static void set_state(rig *r, int state, uint16_t reason) {
    r->state = state;
    r->reason = reason;
}

static void ramp_to_rest(rig *r) {
    r->target_omega = r->target_vx = 0.0f;
    r->has_lapse = 0;
}

/* SAFE, latched: the wheel ramps to rest, or stops at once; the carriage always does. */
static void go_safe(rig *r, uint16_t reason, int at_once) {
    if (r->state != RIG_FAULT) set_state(r, RIG_SAFE, reason);
    ramp_to_rest(r);
    r->vx = 0.0f;
    r->greeted = 0;
    if (at_once) {
        r->omega = 0.0f;
        r->bench.emergency_stop(r->bench.context);
    }
    tell_state(r);
}

static void stop_at_once(rig *r, int state, uint16_t reason, uint32_t now_us) {
    rig_poll(r, now_us);
    r->stop_reason = reason;
    r->stops_left = STOP_TRIES - 1;
    r->stop_due = r->now + REPEAT_INTERVAL_US;
    send_estop(r);
    if (state == RIG_FAULT) set_state(r, state, reason);
    go_safe(r, reason, 1);
    apply(r);
}

/* What the host says ------------------------------------------------------------------------- */

static void hello(rig *r, uint16_t session, uint32_t seq, const uint8_t *payload) {
    uint32_t tick_us = get32(payload + 4);
    uint32_t watchdog_ms = tick_us / 200u + (tick_us % 200u != 0); /* five ticks, rounded up */
    int possible = tick_us > 0 && watchdog_ms <= LONGEST_WATCHDOG_MS, was_ready = is_ready(r);
    if (watchdog_ms < LEAST_WATCHDOG_MS) watchdog_ms = LEAST_WATCHDOG_MS;
    if (was_ready) go_safe(r, RIG_HELLO_WHILE_ARMED, 0);
    if (get32(payload) != RIG_SCHEMA) { /* opens nothing; the host sees this rig's schema */
        send_hello_ack(r, session, possible ? (uint16_t)watchdog_ms : 0);
        return;
    }
    if (!possible) {
        send_state(r, session, RIG_HELLO_REFUSED);
        return;
    }
    if (r->state == RIG_SAFE && !was_ready && r->omega == 0.0f)
        set_state(r, RIG_IDLE, RIG_NO_REASON);
    r->session = session;
    r->last_heard = seq;
    r->open = r->greeted = 1;
    r->watchdog_us = watchdog_ms * 1000u;
    r->measured = r->now;
    r->ack_seq = 0; r->stops_left = 0;
    send_hello_ack(r, session, (uint16_t)watchdog_ms);
}

static void arm(rig *r) {
    if (r->state == RIG_IDLE || r->state == RIG_SAFE) {
        if (!r->greeted) r->reason = RIG_HELLO_NEEDED;
        else if (r->omega == 0.0f) {
            ramp_to_rest(r);
            set_state(r, RIG_ARMED, RIG_NO_REASON);
            r->starves = r->now + r->watchdog_us;
        }
    }
    tell_state(r);
}

static void command(rig *r, uint32_t seq, const uint8_t *payload) {
    rig_reading reading = r->bench.read(r->bench.context); /* before the command acts */
    float omega = get_float(payload), vx = get_float(payload + 4);
    r->ack_seq = seq;
    if (is_ready(r)) { /* written so that NaN fails both */
        if (size_of(omega) <= r->identity.omega_max && size_of(vx) <= r->identity.vx_max) {
            r->driven = get16(payload + 8) & 1;
            if (!r->driven) r->vx = vx = 0.0f;
            r->target_omega = omega; r->target_vx = vx;
            r->starves = r->now + r->watchdog_us;
            r->lapses = r->now + (uint32_t)get16(payload + 10) * 1000u;
            r->has_lapse = 1;
            if (r->target_omega != 0.0f || r->target_vx != 0.0f)
                set_state(r, RIG_RUNNING, RIG_NO_REASON);
        } else {
            r->reason = RIG_COMMAND_REFUSED;
            tell_state(r);
        }
    }
    r->measured = r->now;
    send_meas(r, &reading);
}

static void stop(rig *r) {
    ramp_to_rest(r);
    if (r->state == RIG_RUNNING) { /* the watchdog is fed for the time of this ramp */
        float ramp_us = size_of(r->omega) / r->identity.omega_slew * 1e6f;
        r->starves = r->now + r->watchdog_us + (uint32_t)ramp_us;
        set_state(r, RIG_ARMED, RIG_HOST_STOPPED);
    }
    tell_state(r);
}

static void bye(rig *r) {
    if (is_ready(r)) set_state(r, RIG_IDLE, RIG_BYE);
    ramp_to_rest(r);
    r->stops_left = 0;
    tell_state(r);
    r->open = r->greeted = 0;
}

static void foreign(rig *r, uint16_t session, int type) {
    r->drops[RIG_DROP_SESSION]++;
    if (is_ready(r)) {
        go_safe(r, RIG_ANOTHER_SESSION, type == ESTOP);
        r->has_answered = 0;
    }
    if (!r->has_answered || r->now - r->answered >= REPEAT_INTERVAL_US) {
        r->answered = r->now; r->has_answered = 1;
        send_state(r, session, RIG_ANOTHER_SESSION);
    }
}

/* A cause of RIG_DROP_..., or RIG_DROP_CAUSES where the packet is a message to a rig. */
static int cause_of(const uint8_t *body, int count) {
    int type = body[1];
    if (count < 0) return RIG_DROP_COBS;
    if (count < HEADER + CHECKSUM) return RIG_DROP_SHORT;
    if (get32(body + count - CHECKSUM) != crc32(body, (size_t)(count - CHECKSUM)))
        return RIG_DROP_CRC;
    if (body[0] != VERSION) return RIG_DROP_VERSION;
    if (type < HELLO || type >= TYPES) return RIG_DROP_TYPE;
    if (count != HEADER + payload_length[type] + CHECKSUM) return RIG_DROP_LENGTH;
    if (type == HELLO_ACK || type == MEAS || type == STATE) return RIG_DROP_DIRECTION;
    return RIG_DROP_CAUSES;
}

static void judge_packet(rig *r) {
    uint8_t *body = r->packet, *payload = body + HEADER;
    int cause = cause_of(body, cobs_decode(body, r->length)), type = body[1];
    uint16_t session = get16(body + 2);
    uint32_t seq = get32(body + 4), newer = seq - r->last_heard;
    if (cause == RIG_DROP_CAUSES) {
        if (!r->open || session != r->session) {
            if (type == HELLO) hello(r, session, seq, payload);
            else foreign(r, session, type);
            return;
        }
        if (newer == 0 || newer >= 0x80000000u) cause = RIG_DROP_ORDER;
    }
    if (cause != RIG_DROP_CAUSES) {
        r->drops[cause]++;
        return;
    }
    r->last_heard = seq;
    switch (type) {
    case HELLO: hello(r, session, seq, payload); break;
    case ARM: arm(r); break;
    case CMD: command(r, seq, payload); break;
    case STOP: stop(r); break;
    case ESTOP: r->stops_left = 0; go_safe(r, RIG_HOST_STOPPED, 1); break;
    case BYE: bye(r); break;
    }
}

/* Calls of the bench ------------------------------------------------------------------------- */

static float approach(float value, float target, float most) {
    if (target - value > most) return value + most;
    if (value - target > most) return value - most;
    return target;
}

void rig_init(rig *r, const rig_identity *identity, const rig_bench *bench, uint32_t now_us) {
    memset(r, 0, sizeof *r);
    r->identity = *identity;
    r->bench = *bench;
    r->now = r->measured = now_us;
    r->next_seq = 1;
    apply(r);
}

void rig_receive(rig *r, const uint8_t *bytes, size_t count, uint32_t now_us) {
    rig_poll(r, now_us);
    for (size_t i = 0; i < count; i++) {
        if (bytes[i] == 0) {
            if (r->length && !r->overlong) judge_packet(r);
            r->length = 0; r->overlong = 0;
        } else if (r->length < RIG_LONGEST_PACKET) {
            r->packet[r->length++] = bytes[i];
        } else if (!r->overlong) {
            r->overlong = 1;
            r->drops[RIG_DROP_OVERLONG]++;
        }
    }
    apply(r);
}

void rig_poll(rig *r, uint32_t now_us) {
    uint32_t step = now_us - r->now;
    float elapsed = (float)(step < LONGEST_STEP_US ? step : LONGEST_STEP_US) * 1e-6f;
    r->now = now_us;
    if (is_ready(r) && r->has_lapse && is_due(now_us, r->lapses)) ramp_to_rest(r);
    if (is_ready(r) && is_due(now_us, r->starves)) go_safe(r, RIG_WATCHDOG, 0);
    r->omega = approach(r->omega, r->target_omega, r->identity.omega_slew * elapsed);
    r->vx = r->driven ? approach(r->vx, r->target_vx, r->identity.vx_slew * elapsed) : 0.0f;
    apply(r);
    if (r->stops_left && is_due(now_us, r->stop_due)) {
        r->stops_left--;
        r->stop_due += REPEAT_INTERVAL_US;
        send_estop(r);
    }
    if (r->open && now_us - r->measured >= MEAS_INTERVAL_US) {
        rig_reading reading = r->bench.read(r->bench.context);
        /* Who polls late sends one MEAS, not all that were due. */
        int late = now_us - r->measured >= 2 * MEAS_INTERVAL_US;
        r->measured = late ? now_us : r->measured + MEAS_INTERVAL_US;
        send_meas(r, &reading);
    }
}

void rig_stop(rig *r, uint16_t reason, uint32_t now_us) {
    stop_at_once(r, RIG_SAFE, reason, now_us);
}

void rig_fail(rig *r, uint16_t reason, uint16_t fault, uint32_t now_us) {
    r->fault = fault;
    stop_at_once(r, RIG_FAULT, reason, now_us);
}
