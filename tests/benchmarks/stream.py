"""Cost of a stream to the loop: a tick's step and rows without it, by UDP, and to Foxglove.

    python -m tests.benchmarks.stream

The step is that of the paper's run, the rows go to the real recorder, and nothing listens to the
stream but a socket that is not read, or Foxglove's server without a viewer. The ways take turns
every hundred ticks, so that the machine's other work meets them alike.
"""

import socket
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from drftjax.common.jax_config import configure_jax
from tests.benchmarks.loop import PROFILE, machine

TURNS, TICKS = 40, 100
TICK = 0.01


def main() -> None:
    configure_jax()
    from hils.realtime import answer_at_once

    answer_at_once()
    from drftjax.setups.chosen_step import choose_setup_step
    from drftjax.setups.setup import read_setup
    from hils.control.limits import CommandLimits
    from hils.control.loop_config import LoopSetUp, Start, shared_physics
    from hils.control.tick import TunedTick
    from hils.monitor.stream_address import read_stream_address
    from hils.monitor.tick_stream import FoxgloveLine, TickStream, UdpLine
    from hils.recording.recorder import Recorder

    setup = read_setup(PROFILE)
    choose_setup_step(setup)
    loop = LoopSetUp(setup=setup, commands=CommandLimits(2.0, 0.3), tick=TICK)
    tick = TunedTick(shared_physics(loop))
    start = Start(setup.start.sinkage, 1.0)
    with ExitStack() as opened:
        folder = Path(opened.enter_context(tempfile.TemporaryDirectory()))
        ear = opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        ear.bind(("127.0.0.1", 0))
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        udp = UdpLine(read_stream_address(f"udp://127.0.0.1:{ear.getsockname()[1]}"))
        opened.callback(udp.close)
        foxglove = FoxgloveLine(read_stream_address(f"foxglove://127.0.0.1:{port}"))
        opened.callback(foxglove.close)
        recorder = Recorder(folder / "run.h5", _head(loop, start))
        opened.callback(recorder.close, "completed")
        ways = {
            "no stream": recorder,
            "udp": TickStream(udp).rows(recorder),
            "foxglove": TickStream(foxglove).rows(recorder),
        }
        found: dict[str, list[float]] = {name: [] for name in ways}
        state, number = tick.begin(start), 0
        for _ in range(TURNS):
            for name, rows in ways.items():
                for _ in range(TICKS):
                    begun = time.perf_counter()
                    state = _make_tick(tick, state, rows, number)
                    found[name].append(time.perf_counter() - begun)
                    number += 1
                    time.sleep(1e-3)
        print(machine())
        plain = np.median(found["no stream"])
        print(f"{'':10}  a tick: median, 99 % [us]   ratio of the medians")
        for name, seconds in found.items():
            median, high = np.percentile(seconds, [50, 99])
            print(f"{name:10}  {median * 1e6:14.1f}  {high * 1e6:8.1f}   {median / plain:.3f}")


def _make_tick(tick, state, rows, number: int):
    """The step and the rows of one tick; the state after it."""
    from hils.control.limits import Reading
    from hils.control.tick import TickInput
    from hils.recording.row_stream import OnlineRow

    time, sinkage = number * TICK, tick.loop.setup.start.sinkage
    reading = Reading(time + 1e-6, number * 1e-5, -sinkage, 0.0)
    state, output = tick.step(state, TickInput(reading))
    before, after = output.before, output.after
    rows.command(time + TICK, output.asked.omega, output.asked.vx)
    rows.measured(time + 1e-6, reading.x, reading.z, 0.0)
    numbers = (before.x, before.z, before.vx, before.fx, before.fz)
    rows.online(OnlineRow(time, after.zeta, *numbers, 0, 0.0, 1e-3, 1, number, number, time))
    return state


def _head(loop, start):
    from hils.link.messages import HelloAck, RigState
    from hils.procedure.initial_state import run_log_head

    ack = HelloAck(9, 7, 1e-5, 1e-5, 2.0, 0.3, 50, RigState.IDLE)
    return run_log_head(loop, start, ack, "stream", False, True)


if __name__ == "__main__":
    main()
