"""The other end of the loop's benchmark: a rig without physics, which plays a trajectory.

    python -m tests.benchmarks.loop_peer DESCRIPTOR TRAJECTORY.npy

It answers by `hils.rig_sim.firmware`, and nothing else: what is measured is the host.
"""

import os
import select
import sys
import time

import numpy as np

from hils.link.messages import RigState
from hils.rig_sim.firmware import RigIdentity, RigProtocol

# How long it waits for bytes before it looks at its own clock [s].
GLANCE = 2e-3
Z_SCALE, X_SCALE = 1e-5, 0.0  # x follows no command here, so it is not measured


def main(descriptor: int, trajectory: str) -> None:
    """Serve until the host hangs up."""
    when, z, _ = np.load(trajectory)
    rig = RigProtocol(RigIdentity(1, z_scale=Z_SCALE, x_scale=X_SCALE), time.monotonic())
    os.set_blocking(descriptor, False)
    running: float | None = None
    while True:
        readable, _, _ = select.select([descriptor], [], [], GLANCE)
        data = b""
        if readable:
            try:
                data = os.read(descriptor, 4096)
            except BlockingIOError:
                data = b""
            except OSError:
                return
            if not data:
                return
        now = time.monotonic()
        if rig.state is RigState.RUNNING and running is None:
            running = now
        at = 0.0 if running is None else now - running + 2.0  # the profile stands for 2 s
        held = rig.state is RigState.IDLE and running is None
        place = 0.0 if held else np.interp(at, when, z)
        rig.measure(round(place / Z_SCALE), 0, rig.demand.omega)
        out = rig.advance(now, data)
        if out:
            try:
                os.write(descriptor, out)
            except OSError:
                return


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
