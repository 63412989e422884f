/* Random frames into the reference firmware, with its invariants asserted after each.
 *
 *     cc -std=c99 -O1 -g -fsanitize=address,undefined -fno-sanitize-recover=all -Ifirmware \
 *         firmware/rig_protocol.c tests/firmware/fuzz.c -o fuzz -lm && ./fuzz 10000000 1
 *
 * Arguments: how many frames, and the seed. COBS and CRC are written here anew.
 */
#include "rig_protocol.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { HELLO = 1, ARM = 3, CMD = 4, STOP = 6, ESTOP = 7, BYE = 9 };

static const int payload_length[10] = {0, 12, 32, 0, 12, 20, 0, 2, 8, 0};
static const rig_identity identity = {1, 2, 1e-5f, 1e-4f, 2.0f, 0.3f, 5.0f, 2.0f};

static uint64_t random_state;
static rig r;
static uint32_t now, sent;
static float driven_omega, driven_vx;
static long frames, damaged, armed, ran, refused;

#define MUST(condition) if (!(condition)) fail(#condition, __LINE__)

static void fail(const char *condition, int line) {
    fprintf(stderr, "frame %ld, line %d: not %s (state %d, omega %g, vx %g)\n", frames, line,
            condition, r.state, (double)r.omega, (double)r.vx);
    abort();
}

static uint32_t random32(void) {
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)(random_state >> 32);
}

static uint32_t below(uint32_t limit) { return random32() % limit; }

static void put(uint8_t *p, uint32_t value, int bytes) {
    for (; bytes--; value >>= 8) *p++ = (uint8_t)value;
}

static float random_float(float limit) {
    uint32_t bits = random32();
    float value;
    memcpy(&value, &bits, sizeof value);
    switch (below(8)) {
    case 0: return value; /* any bits: NaN, infinities, denormals */
    case 1: return limit;
    case 2: return -limit;
    case 3: return 0.0f;
    case 4: return limit * 1.001f;
    default: return limit * ((float)below(2001) / 1000.0f - 1.0f);
    }
}

/* A frame with the right CRC; its length. `wrong`: 1 the version, 2 the type, 3 the length. */
static size_t frame_of(uint8_t *out, int type, int wrong, uint16_t session, uint32_t seq,
                       const uint8_t *payload) {
    uint8_t body[64];
    size_t count = 12 + (size_t)payload_length[type] + (wrong == 3), code = 1, to = 2;
    uint32_t crc = ~0u;
    body[0] = wrong == 1 ? 2 : 1;
    body[1] = (uint8_t)(wrong == 2 ? 10 + below(246) : (uint32_t)type);
    put(body + 2, session, 2);
    put(body + 4, seq, 4);
    put(body + 8, random32(), 4);
    memcpy(body + 12, payload, count - 12);
    for (size_t i = 0; i < count; i++)
        for (int bit = 0; bit < 8; bit++) {
            uint32_t differs = (crc ^ (uint32_t)body[i] >> bit) & 1;
            crc = crc >> 1 ^ (differs ? 0xEDB88320u : 0);
        }
    put(body + count, ~crc, 4);
    out[0] = 0;
    out[1] = 1;
    for (size_t i = 0; i < count + 4; i++) {
        if (body[i]) out[to++] = body[i], out[code]++;
        else code = to, out[to++] = 1;
    }
    out[to++] = 0;
    return to;
}

/* Spoils what lies between the delimiters, so that no whole frame is left. */
static size_t spoil(uint8_t *p, size_t count) {
    size_t place = 2 + below((uint32_t)count - 4), cut = 1 + below(6);
    switch (below(4)) {
    case 0: p[place] ^= (uint8_t)(1 + below(255)); break;
    case 1: memmove(p + place, p + place + 1, count - place - 1); return count - 1;
    case 2:
        memmove(p + place + 1, p + place, count - place);
        p[place] = (uint8_t)(p[place] ^ (1 + below(255)));
        return count + 1;
    default:
        if (place + cut > count - 2) cut = 1;
        for (size_t i = 0; i < cut; i++) p[place + i] ^= (uint8_t)(1 + below(255));
    }
    return count;
}

static void take(void *context, const uint8_t *bytes, size_t count) {
    (void)context;
    MUST(count >= 19 && count <= RIG_LONGEST_FRAME && bytes[0] == 0 && bytes[count - 1] == 0);
    for (size_t i = 1; i < count - 1; i++) MUST(bytes[i] != 0);
    sent++;
}

static rig_reading read_scales(void *context) {
    (void)context;
    return (rig_reading){(int32_t)random32(), (int32_t)random32(), random_float(2.0f)};
}

static void drive(void *context, float omega, float vx, int driven) {
    (void)context;
    MUST(isfinite(omega) && fabsf(omega) <= identity.omega_max);
    MUST(isfinite(vx) && fabsf(vx) <= identity.vx_max);
    MUST(driven || vx == 0.0f);
    driven_omega = omega;
    driven_vx = vx;
}

static void emergency_stop(void *context) {
    (void)context;
    driven_omega = driven_vx = 0.0f;
}

static int is_ready(int state) { return state == RIG_ARMED || state == RIG_RUNNING; }

/* Feeds bytes, and holds the rig to its rules. `type` is 0 where no whole frame is among them. */
static void feed(const uint8_t *bytes, size_t count, int type, const uint8_t *payload) {
    rig before;
    float size = fabsf(driven_omega), carriage = fabsf(driven_vx), most;
    uint32_t step = below(4) ? below(3000) : below(30000);
    now += step;
    rig_poll(&r, now);
    most = identity.omega_slew * (float)(step < 20000 ? step : 20000) * 1e-6f + 1e-6f;
    MUST(fabsf(driven_omega) <= size + most);
    if (!is_ready(r.state)) MUST(fabsf(driven_omega) <= size && fabsf(driven_vx) <= carriage);
    before = r;
    size = fabsf(driven_omega);
    rig_receive(&r, bytes, count, now);
    frames++;
    MUST(r.state >= RIG_IDLE && r.state <= RIG_FAULT);
    MUST(r.state != RIG_RUNNING || before.state == RIG_RUNNING || type == CMD);
    MUST(is_ready(before.state) || !is_ready(r.state) || (type == ARM && before.greeted));
    MUST(r.greeted <= before.greeted || type == HELLO);
    MUST(!is_ready(r.state) || is_ready(before.state) || driven_omega == 0.0f);
    MUST(before.state != RIG_SAFE || r.state == RIG_SAFE || type == HELLO || type == ARM);
    MUST(fabsf(driven_omega) <= size); /* no time has passed since the poll */
    MUST(r.state < RIG_SAFE || driven_vx == 0.0f);
    MUST(is_ready(r.state) || (r.target_omega == 0.0f && r.target_vx == 0.0f));
    if (type == 0) {
        MUST(r.state == before.state && r.target_omega == before.target_omega);
        MUST(r.starves == before.starves && r.session == before.session);
    } else damaged--;
    damaged++;
    if (type == CMD && is_ready(before.state) && r.ack_seq != before.ack_seq) {
        float omega, vx;
        memcpy(&omega, payload, 4);
        memcpy(&vx, payload + 4, 4);
        if (isfinite(omega) && isfinite(vx) && fabsf(omega) <= 2.0f && fabsf(vx) <= 0.3f) {
            MUST(r.target_omega == omega);
        } else {
            MUST(r.target_omega == before.target_omega && r.starves == before.starves);
            refused++;
        }
    }
    armed += r.state == RIG_ARMED;
    ran += r.state == RIG_RUNNING && driven_omega != 0.0f;
}

int main(int count, char **arguments) {
    long wanted = count > 1 ? atol(arguments[1]) : 10000000;
    rig_bench functions = {NULL, take, read_scales, drive, emergency_stop};
    uint16_t sessions[4] = {1, 2, 77, 65535}, session = 1;
    uint32_t seq = 1;
    random_state = 0x9E3779B97F4A7C15u ^ (uint64_t)(count > 2 ? atol(arguments[2]) : 1) << 20;
    rig_init(&r, &identity, &functions, now);
    while (frames < wanted) {
        static const int usual[] = {ARM, ARM, CMD, CMD, CMD, CMD, CMD, CMD, CMD, STOP, HELLO,
                                    HELLO};
        uint8_t bytes[128], payload[33];
        size_t length;
        int type = below(40) ? usual[below(12)] : 1 + (int)below(9), whole = 1, wrong = 0;
        for (int i = 0; i < 33; i++) payload[i] = (uint8_t)random32();
        if (type == HELLO) {
            if (below(50)) put(payload, RIG_SCHEMA, 4);
            if (below(50)) put(payload + 4, 1 + below(20000), 4);
            if (is_ready(r.state) && below(20)) type = CMD; /* let it run for a while */
            else if (below(2)) session = sessions[below(4)];
        }
        if (type == CMD) {
            float omega = random_float(2.0f), vx = random_float(0.3f);
            memcpy(payload, &omega, 4);
            memcpy(payload + 4, &vx, 4);
        }
        seq = below(30) ? seq + 1 + below(3) : seq - below(5);
        if (!below(1000)) seq = random32();
        if (!below(20)) wrong = 1 + (int)below(3), whole = 0;
        length = frame_of(bytes, type, wrong, below(100) ? session : (uint16_t)random32(), seq,
                          payload);
        switch (below(8)) {
        case 0: case 1: length = spoil(bytes, length); whole = 0; break;
        case 2:
            length = 1 + below(sizeof bytes);
            for (size_t i = 0; i < length; i++) bytes[i] = (uint8_t)random32();
            whole = 0;
            break;
        }
        if (!whole) bytes[length - 1] = 0;
        feed(bytes, length, whole ? type : 0, payload);
        if (!below(5000)) rig_stop(&r, 100, now);
        if (!below(1000000)) rig_fail(&r, 101, 1, now);
        if (r.state == RIG_FAULT && !below(100)) rig_init(&r, &identity, &functions, now);
    }
    MUST(armed > wanted / 100 && ran > wanted / 100 && refused > wanted / 1000);
    printf("%ld frames, %ld of them damaged: ARMED after %ld, turning after %ld, %ld commands "
           "refused, %u frames answered\n", frames, damaged, armed, ran, refused, sent);
    for (int cause = 0; cause < RIG_DROP_CAUSES; cause++) printf("%u ", r.drops[cause]);
    puts("dropped by cause since the last power-up");
    return 0;
}
