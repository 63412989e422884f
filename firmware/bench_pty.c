/* A bench in software, at a pseudo-terminal: a simple wheel in place of motors and scales.
 *
 *     cc -std=c99 -O2 -o rig rig_protocol.c bench_pty.c
 *     ./rig /tmp/rig
 *
 * For POSIX systems. On a board, write your own file of these four functions and of this loop.
 * SIGUSR1 presses the rig's own emergency stop.
 */
#define _XOPEN_SOURCE 600
#include "rig_protocol.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#define Z_SCALE 1e-5f        /* m a count */
#define X_SCALE 1e-4f
#define ROLLING (0.85 * 0.15) /* m: 0.85 of the rim's speed, for a radius of 0.15 m */
#define SINKAGE_REST 0.0165  /* m, standing */
#define SINKAGE_TURNING 0.026
#define BUTTON 100           /* reason of the rig's own stop */
#define HELD_UP_US 5000u     /* a loop later than this was not let run: time stood still */

typedef struct {
    int port, driven;
    double demand_omega, demand_vx; /* what the protocol asks for */
    double omega, vx, x, sinkage;
    uint32_t noise;
} bench;

static volatile sig_atomic_t ended, pressed;

static void on_signal(int number) { *(number == SIGUSR1 ? &pressed : &ended) = 1; }

static void send(void *context, const uint8_t *bytes, size_t count) {
    bench *b = context; /* a host that does not read loses what it missed */
    if (write(b->port, bytes, count) < 0) return;
}

static rig_reading read_scales(void *context) {
    bench *b = context;
    b->noise = b->noise * 1664525u + 1013904223u;
    int32_t z = (int32_t)(-b->sinkage / Z_SCALE) + (int32_t)(b->noise >> 30) - 1;
    return (rig_reading){z, (int32_t)(b->x / X_SCALE), (float)b->omega};
}

static void drive(void *context, float omega, float vx, int driven) {
    bench *b = context;
    b->demand_omega = omega;
    b->demand_vx = vx;
    b->driven = driven;
}

static void emergency_stop(void *context) {
    bench *b = context;
    b->omega = b->vx = 0.0;
}

/* The wheel hangs at touch-down while IDLE, and stands in the sand from ARM on. */
static void move(bench *b, int state, double dt) {
    double carriage = b->driven ? b->demand_vx : ROLLING * b->omega;
    int turns = b->omega > 0.02 || b->omega < -0.02;
    double depth = turns ? SINKAGE_TURNING : SINKAGE_REST;
    b->omega += (b->demand_omega - b->omega) * dt / (dt + 0.01);
    b->vx += (carriage - b->vx) * dt / (dt + 0.02);
    b->x += b->vx * dt;
    if (state == RIG_IDLE) b->sinkage = 0.0;
    else if (turns || b->sinkage < SINKAGE_REST)
        b->sinkage += (depth - b->sinkage) * dt / (turns ? 2.0 : 0.1);
}

static uint32_t clock_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)((uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u);
}

/* A pseudo-terminal in raw mode; its other end is held open, so that a host may come and go. */
static int open_port(const char *link) {
    int port = posix_openpt(O_RDWR | O_NOCTTY), other;
    struct termios raw;
    if (port < 0 || grantpt(port) || unlockpt(port)
        || (other = open(ptsname(port), O_RDWR | O_NOCTTY)) < 0 || tcgetattr(other, &raw))
        return -1;
    raw.c_iflag = raw.c_oflag = raw.c_lflag = 0;
    raw.c_cflag = CS8 | CREAD | CLOCAL;
    if (tcsetattr(other, TCSANOW, &raw) || fcntl(port, F_SETFL, O_NONBLOCK)) return -1;
    return link && symlink(ptsname(port), link) ? -1 : port;
}

int main(int count, char **arguments) {
    static rig r;
    static bench b;
    const char *link = count > 1 ? arguments[1] : NULL;
    rig_identity identity = {0x42454E43u, 0, Z_SCALE, X_SCALE, 2.0f, 0.5f, 5.0f, 2.0f};
    rig_bench functions = {&b, send, read_scales, drive, emergency_stop};
    FILE *random = fopen("/dev/urandom", "rb");
    uint32_t last = clock_us(), stood = 0;
    int state = -1;
    if (!random || fread(&identity.boot_id, sizeof identity.boot_id, 1, random) != 1
        || (b.port = open_port(link)) < 0) {
        perror(link ? link : "pseudo-terminal");
        return 2;
    }
    fclose(random);
    signal(SIGINT, on_signal), signal(SIGTERM, on_signal), signal(SIGUSR1, on_signal);
    puts(ptsname(b.port)), fflush(stdout);
    rig_init(&r, &identity, &functions, last);
    while (!ended) {
        uint8_t bytes[256];
        struct pollfd port = {b.port, POLLIN, 0};
        poll(&port, 1, 1);
        uint32_t now = clock_us() - stood, late = now - last;
        if (late > HELD_UP_US) {
            stood += late - 1000u;
            now = last + 1000u;
        }
        ssize_t got = read(b.port, bytes, sizeof bytes);
        rig_receive(&r, bytes, got > 0 ? (size_t)got : 0, now);
        if (pressed) rig_stop(&r, BUTTON, now);
        pressed = 0;
        move(&b, r.state, (now - last) * 1e-6);
        last = now;
        if (r.state != state) fprintf(stderr, "state %d, reason %u\n", state = r.state, r.reason);
    }
    if (link) unlink(link);
    return 0;
}
