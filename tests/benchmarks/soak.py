"""A long run in the loop against the shared firmware in C: missed deadlines and memory.

    python -m tests.benchmarks.soak [--seconds 3600] [--tick 0.01] [-o FOLDER]

builds ../shared/firmware/rig.c and drives it with `drft hils run` through a pseudo-terminal. The
rig's watchdog is off: a virtual machine holds host and rig up together, for longer than its 50 ms.
The memory of the control program is read every half a minute once the profile runs.
"""

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2]))

from drftjax.runlog.hdf5.api import read_run
from tests.helpers.other_firmware import build, running

# The wheel turns at 10 deg/s, so that an hour is 50 m and not several hundred.
PROFILE = """
[command]
time = [0.0, 0.5, 1.5, {end}]
omega = [0.0, 0.0, 10.0, 10.0]
omega_unit = "deg/s"
"""
# Memory is compared from here on [s]: the first rows fill buffers that are then used again.
SETTLED = 60.0


def resident(process: int) -> int:
    """Memory of a process [kB]; 0 where it has ended."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in status.splitlines() if "VmRSS" in line), 0)


def main() -> None:
    """Make the run, and print what it took."""
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--seconds", type=float, default=3600.0)
    options.add_argument("--tick", type=float, default=0.01)
    options.add_argument("-o", "--output", type=Path)
    given = options.parse_args()
    folder = given.output or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    print(f"{platform.platform()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    profile, log = folder / "profile.toml", folder / "soak.h5"
    profile.write_text(PROFILE.format(end=given.seconds))
    with running(build(folder), folder / "rig_files", no_wd=1) as firmware:
        command = ["--port", firmware.port, "--profile", profile, "-o", log, "--tick", given.tick]
        host = subprocess.Popen(
            [sys.executable, "-m", "drftjax.commands.main", "hils", "run"]
            + [str(each) for each in [*command, "--yes", "--no-ui", "--no-plot"]]
        )
        memory, began = [], time.monotonic()
        while host.poll() is None:
            time.sleep(30.0 if given.seconds > 300 else 1.0)
            memory.append((time.monotonic() - began, resident(host.pid)))
    online = read_run(log).online
    assert online is not None
    late = online.late > 0
    print(f"exit code {host.returncode}; {len(late)} ticks, {int(late.sum())} deadlines missed")
    print(f"missed per million: {1e6 * late.mean():.0f}; latest {1e3 * online.late.max():.1f} ms")
    if online.work_time is not None:
        work = 1e3 * np.nanpercentile(online.work_time, [50, 99, 99.99])
        print("work of a tick, p50, p99, p99.99 [ms]: " + ", ".join(f"{v:.3f}" for v in work))
    size = [kilobytes for at, kilobytes in memory if at > SETTLED and kilobytes]
    if len(size) > 1:
        print(f"memory from {SETTLED:g} s on: {size[0]} to {size[-1]} kB, {size[-1] - size[0]:+d}")


if __name__ == "__main__":
    main()
