/* The rig's side of the wire (docs/reference/wire.md), for any board with a C99 compiler.
 *
 * No heap, no operating system, no library but string.h. Fill in `rig_bench`, then call
 *
 *     rig_init     once at power-up,
 *     rig_receive  with the bytes that have come from the host, as soon as they come,
 *     rig_poll     each millisecond or oftener,
 *     rig_stop     when somebody presses the rig's own button,
 *     rig_fail     when the rig finds that it is broken,
 *
 * all from one thread of control, never from an interrupt beside another call. `now_us` is a clock
 * in microseconds that wraps at 2^32, such as Arduino's micros(). float must be IEEE 754 with 32
 * bits. Do not compile with -ffast-math: a command that is no number would be taken.
 */
#ifndef RIG_PROTOCOL_H
#define RIG_PROTOCOL_H

#include <stddef.h>
#include <stdint.h>

#define RIG_SCHEMA 0x44524654u
#define RIG_LONGEST_PACKET 49 /* of any message between two delimiters: HELLO_ACK */
#define RIG_LONGEST_FRAME (RIG_LONGEST_PACKET + 2)

enum { RIG_IDLE, RIG_ARMED, RIG_RUNNING, RIG_SAFE, RIG_FAULT };

/* Reasons of a STATE; numbers from 100 on are free for your bench. */
enum {
    RIG_NO_REASON, RIG_WATCHDOG, RIG_ANOTHER_SESSION, RIG_HELLO_WHILE_ARMED, RIG_HOST_STOPPED,
    RIG_COMMAND_REFUSED, RIG_HELLO_NEEDED, RIG_HELLO_REFUSED, RIG_BYE
};

/* Causes for which something received does not count. */
enum {
    RIG_DROP_OVERLONG, RIG_DROP_COBS, RIG_DROP_SHORT, RIG_DROP_CRC, RIG_DROP_VERSION,
    RIG_DROP_TYPE, RIG_DROP_LENGTH, RIG_DROP_DIRECTION, RIG_DROP_SESSION, RIG_DROP_ORDER,
    RIG_DROP_CAUSES
};

typedef struct {
    uint32_t rig_id;
    uint32_t boot_id;     /* another one at each power-up: a counter in flash, or random */
    float z_scale;        /* m a count, z up; negative where the counts run down */
    float x_scale;        /* m a count, x forward; 0 where x is not measured */
    float omega_max;      /* rad/s, above 0 */
    float vx_max;         /* m/s, 0 where the carriage cannot be driven */
    float omega_slew;     /* rad/s2, above 0, and omega_max / omega_slew below 60 s */
    float vx_slew;        /* m/s2, above 0 */
} rig_identity;

typedef struct {
    int32_t z, x;         /* counts; z is 0 at power-up */
    float omega;          /* rad/s, forward positive; NaN where it is not measured */
} rig_reading;

typedef struct {
    void *context;        /* given to each of these functions */
    void (*send)(void *context, const uint8_t *bytes, size_t count);
    rig_reading (*read)(void *context);
    /* Set-point of the drives, within limits and slew limits; where not driven, the carriage runs
     * free and vx is 0. Called at each poll, so a drive with a time-out of its own is fed. */
    void (*drive)(void *context, float omega, float vx, int driven);
    /* Rest at once, by brake or by power; a `drive` of zeros follows. */
    void (*emergency_stop)(void *context);
} rig_bench;

/* Read it as you like; only the functions below write to it. */
typedef struct {
    rig_identity identity;
    rig_bench bench;
    int state;
    uint16_t reason, fault;
    float omega, vx;                 /* set-point now */
    float target_omega, target_vx;   /* where it ramps to */
    int driven;
    int open, greeted;               /* a session is known; its HELLO has come since SAFE */
    uint16_t session;
    uint32_t last_heard, next_seq, ack_seq;
    uint32_t now, measured, starves, lapses, answered, watchdog_us;
    int has_lapse, has_answered;
    int stops_left;
    uint16_t stop_reason;
    uint32_t stop_due;
    uint8_t packet[RIG_LONGEST_PACKET];
    size_t length;
    int overlong;
    uint32_t drops[RIG_DROP_CAUSES];
} rig;

void rig_init(rig *r, const rig_identity *identity, const rig_bench *bench, uint32_t now_us);
void rig_receive(rig *r, const uint8_t *bytes, size_t count, uint32_t now_us);
void rig_poll(rig *r, uint32_t now_us);

/* The rig's own button: rest at once, SAFE, and tell the host until it answers. */
void rig_stop(rig *r, uint16_t reason, uint32_t now_us);

/* A fault of the rig's own: rest at once, FAULT until power-up. `fault` is sent in each MEAS. */
void rig_fail(rig *r, uint16_t reason, uint16_t fault, uint32_t now_us);

#endif
