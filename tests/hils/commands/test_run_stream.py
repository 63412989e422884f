"""`drft hils run --stream` against a virtual rig, in processes of their own.

The control period is long, so that a busy machine, which lets processes wait, is no watchdog's
case.
"""

import json
import socket
import subprocess
import sys

import pytest

from drftjax.runlog.hdf5.api import read_run
from tests.helpers.rig_server import Rig

DRFT = [sys.executable, "-m", "drftjax.commands.entry"]
PATIENCE = 180.0  # four processes may share half a core [s]
# Some forty messages of 400 bytes; nobody reads them before the end [bytes].
ROOM = 2**20

PROFILE = """
[wheel]
plate_size = 0.008
[command]
time = [0, 0.5, 1.5, 2.0, 3.0]
omega = [0, 0, 30, 30, 0]
omega_unit = "deg/s"
[integrator]
step = 2e-3
"""


@pytest.fixture
def rig(tmp_path):
    made = Rig(tmp_path, "--link", tmp_path / "port")
    yield made
    made.process.kill()
    made.process.wait()


def test_every_recorded_tick_is_streamed(rig, tmp_path):
    (tmp_path / "profile.toml").write_text(PROFILE)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, ROOM)
        ear.bind(("127.0.0.1", 0))
        url = f"udp://127.0.0.1:{ear.getsockname()[1]}"
        command = [*DRFT, "hils", "run", "--port", tmp_path / "port", "--stream", url, "--yes"]
        command += ["--profile", tmp_path / "profile.toml", "-o", tmp_path / "run.h5"]
        command += ["--tick", "0.1", "--countdown", "0.3", "--no-ui", "--no-plot"]
        answer = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
        assert answer.returncode == 0, answer.stdout + answer.stderr
        ear.setblocking(False)
        messages = []
        while True:
            try:
                messages.append(json.loads(ear.recv(4096)))
            except BlockingIOError:
                break
    online = read_run(tmp_path / "run.h5").online
    assert online is not None
    assert [each["time"] for each in messages] == online.time.tolist()
    assert [each["zeta"] for each in messages] == online.zeta.tolist()
    assert f"Stream to {url}: {online.time.size} ticks sent." in answer.stdout
