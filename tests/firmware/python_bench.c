/* The reference firmware behind plain functions, for ctypes: its wheel follows its demand at once.
 *
 * Memory is the caller's: `bench_size` bytes.
 */
#include "rig_protocol.h"

#include <string.h>

typedef struct {
    rig protocol;
    uint8_t out[1 << 16];
    size_t count;
    double x;
    int stands; /* the scales tell constants, whatever is demanded */
    int stops;  /* calls of emergency_stop */
} bench;

static void take(void *context, const uint8_t *bytes, size_t count) {
    bench *b = context;
    if (count > sizeof b->out - b->count) return;
    memcpy(b->out + b->count, bytes, count);
    b->count += count;
}

static rig_reading read_scales(void *context) {
    bench *b = context;
    if (b->stands) return (rig_reading){-1760, 3, 0.5f};
    return (rig_reading){-1760, (int32_t)(b->x / 1e-4), b->protocol.omega};
}

static void drive(void *context, float omega, float vx, int driven) {
    (void)context, (void)omega, (void)vx, (void)driven;
}

static void emergency_stop(void *context) { ((bench *)context)->stops++; }

size_t bench_size(void) { return sizeof(bench); }

void bench_power(bench *b, const rig_identity *identity, int stands, uint32_t now_us) {
    rig_bench functions = {b, take, read_scales, drive, emergency_stop};
    memset(b, 0, sizeof *b);
    b->stands = stands;
    rig_init(&b->protocol, identity, &functions, now_us);
}

/* Lives up to this time in steps of a millisecond, then takes bytes. */
void bench_advance(bench *b, uint32_t now_us, const uint8_t *bytes, size_t count) {
    while (b->protocol.now != now_us) {
        uint32_t left = now_us - b->protocol.now, step = left < 1000u ? left : 1000u;
        rig_poll(&b->protocol, b->protocol.now + step);
        b->x += (b->protocol.driven ? b->protocol.vx : 0.1 * b->protocol.omega) * step * 1e-6;
    }
    if (count) rig_receive(&b->protocol, bytes, count, now_us);
}

void bench_press(bench *b, uint16_t reason, uint32_t now_us) {
    rig_stop(&b->protocol, reason, now_us);
}

void bench_break(bench *b, uint16_t reason, uint16_t fault, uint32_t now_us) {
    rig_fail(&b->protocol, reason, fault, now_us);
}

size_t bench_take(bench *b, uint8_t *out) {
    size_t count = b->count;
    memcpy(out, b->out, count);
    b->count = 0;
    return count;
}

int bench_state(const bench *b) { return b->protocol.state; }

float bench_omega(const bench *b) { return b->protocol.omega; }

float bench_vx(const bench *b) { return b->protocol.vx; }

int bench_stops(const bench *b) { return b->stops; }

uint32_t bench_drops(const bench *b, int cause) { return b->protocol.drops[cause]; }

void bench_late(bench *b, uint32_t now_us) { rig_poll(&b->protocol, now_us); }
