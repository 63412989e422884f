"""The virtual rig: how fast its physics is, how soon it answers, how soon it is SAFE.

    python -m tests.benchmarks.rig
    python -m tests.benchmarks.rig --kills 50 --seconds 20

The rig is the default one (plates of 2 mm, steps of 0.2 ms), at a pseudo-terminal of its own,
without privileges. SAFE is timed twice: by the rig's clock from the last command that it heard, and
by this program's from the kill -9 of the host, with what it takes to tell.
"""

import argparse
import math
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from drftjax.common.jax_config import configure_jax
from hils.link.framing import Receiver
from hils.link.messages import FROM_RIG, Arm, Drive, Frame, Hello, Measurement, encode
from tests.benchmarks.loop import machine
from tests.helpers.rig_server import HOST, Rig, open_raw

TICK_MS, WATCHDOG_MS = 10, 50


def physics_speed(setup) -> tuple[float, float]:
    """Times real time at a tick of 10 ms, and a single step's call [us]."""
    from hils.rig_sim.physics import REST, MotorDemand

    physics = setup.build()
    packed, last, steps = physics.held(), REST, round(0.01 / setup.physics.step)
    begun = time.perf_counter()
    for tick in range(1000):
        demand = MotorDemand(math.radians(30) * min(1.0, tick / 300), 0.0, False)
        packed = physics.advance(packed, steps, last, demand, tick < 150)
        last, _ = demand, physics.motion(packed)
    speed = 10.0 / (time.perf_counter() - begun)
    begun = time.perf_counter()
    for _ in range(1000):
        packed = physics.advance(packed, 1, last, last)
        physics.motion(packed)
    return speed, (time.perf_counter() - begun) * 1e3


def answers(name: str, tick: float, seconds: float, session: int) -> np.ndarray:
    """Time from each command to the measurement that acknowledges it [s]; infinite where none."""
    port, receiver = open_raw(name), Receiver(FROM_RIG)
    receiver.expect(session)

    def send(message, seq: int) -> None:
        os.write(port, encode(Frame(message, session, seq, 0)))

    send(Hello(round(tick * 1e6), 50), 1)
    time.sleep(0.2)
    send(Arm(), 2)
    count, begun = round(seconds / tick), time.monotonic()
    sent, late = np.full(count + 3, np.nan), np.full(count + 3, np.inf)
    for number in range(3, count + 3):
        sent[number] = time.monotonic()
        omega = 0.3 * min(1.0, max(0.0, number * tick - 2.0))
        send(Drive(omega, 0.0, False, 50), number)
        due = begun + (number - 2) * tick
        while (left := due - time.monotonic()) > 0:
            if not select.select([port], [], [], left)[0]:
                break
            now = time.monotonic()
            for frame in receiver.feed(os.read(port, 4096)):
                message = frame.message
                if isinstance(message, Measurement) and message.ack_seq >= 3:
                    late[message.ack_seq] = min(late[message.ack_seq], now - sent[message.ack_seq])
    os.close(port)
    return late[3:]


def kills(rig: Rig, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Milliseconds to SAFE: by the rig's clock from the last command, by ours from the kill."""
    own, ours = [], []
    for number in range(count):
        while not rig.lines.empty():
            rig.lines.get()
        program = HOST.replace("message, 9,", f"message, {100 + number},")
        host = subprocess.Popen([sys.executable, "-c", program, rig.name])
        rig.says("RUNNING")
        time.sleep(0.2 + 0.01 * (number % 10) / 10)
        host.send_signal(signal.SIGKILL)
        killed = time.monotonic()
        told, silence = rig.says(r"SAFE \(watchdog, ([\d.]+) ms")
        host.wait()
        own.append(float(silence[1]))
        ours.append((told - killed) * 1e3)
    return np.array(own), np.array(ours)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=10.0)
    given = parser.parse_args()
    configure_jax()
    import jax

    jax.config.update("jax_cpu_enable_async_dispatch", False)
    from hils.rig_sim.config import VirtualSetUp
    from hils.rig_sim.in_process import QUICK

    print(machine())
    for name, setup in {"default": VirtualSetUp(), "quick": VirtualSetUp(physics=QUICK)}.items():
        speed, call = physics_speed(setup)
        print(f"physics, {name}: {speed:.0f} times real time, one step's call {call:.0f} us")
    with tempfile.TemporaryDirectory() as folder:
        rig = Rig(Path(folder), quick=False)
        try:
            for session, tick in enumerate((0.01, 0.001), start=3):
                late = np.sort(answers(rig.name, tick, given.seconds, session))
                print(
                    f"answers at {1 / tick:.0f} Hz: p50 {late[len(late) // 2] * 1e3:.2f} ms, "
                    f"p99 {late[int(0.99 * len(late))] * 1e3:.2f} ms, within a tick "
                    f"{np.mean(late <= tick) * 100:.2f} % of {len(late)}"
                )
                time.sleep(0.2)
            own, ours = kills(rig, given.kills)
        finally:
            rig.process.kill()
            rig.process.wait()
    print(
        f"SAFE after kill -9, tick {TICK_MS} ms, watchdog {WATCHDOG_MS} ms, {len(own)} kills: from "
        f"the last command {own.min():.1f} to {own.max():.1f} ms by the rig's clock; from the kill "
        f"to the line read p50 {np.median(ours):.1f}, most {ours.max():.1f} ms"
    )


if __name__ == "__main__":
    main()
