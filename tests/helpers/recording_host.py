"""A control program that records known rows until it is killed, and what a kill left of them.

    python recording_host.py RUN.h5 RATE

hands over rows at the rate [Hz], and prints how many it has handed over.
"""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from drftjax.common.errors import InputError
from drftjax.runlog.check import read_run_guarded
from drftjax.runlog.header import Head, OnlineHead
from drftjax.runlog.record import RecordedSetup, RunLog
from drftjax.runlog.recording_lock import is_held, part_path
from drftjax.runlog.repair import repair
from hils.events import EVENT_MEANINGS, FLAG_MEANINGS, Event, TickFlag
from hils.recording.recorder import DEFAULT_RECORDER, Recorder, RecorderSettings
from hils.recording.row_stream import OnlineRow

DEADLINE = 60.0
"""In which an outcome must come, however busy the machine [s]."""


def example_head(**changes) -> Head:
    """A head with everything in it."""
    given = {
        "setup": RecordedSetup(wheel_radius=0.15, mass_z=18.837, sinkage_static=0.0176),
        "source": "virtual rig",
        "title": "Prüfstand 7",
        "driven": True,
        "online": OnlineHead(
            tick=0.001,
            zeta_step=0.001,
            tolerance=1e-4,
            loop='{"tuner": "step"}',
            flag_meanings=FLAG_MEANINGS,
        ),
        "event_meanings": EVENT_MEANINGS,
        "notes": "two\nlines",
    }
    return Head(**(given | changes))


def hand_over(recorder: Recorder, number: int) -> None:
    """One tick: a command, a reading and a row of the loop, all known from the number."""
    time, wave = number * 0.001, float(np.sin(number))
    recorder.command(time, 0.5 + wave, wave / 3)
    recorder.measured(time + 0.0003, number / 70, -0.02 + wave / 1000)
    recorder.online(
        OnlineRow(
            time=time,
            zeta=0.78 + wave / 9,
            x_sim=number / 3,
            z_sim=wave,
            vx_sim=wave / 7,
            fx_sim=wave * 11,
            fz_sim=wave * 13,
            tuned=number % 2,
            late=abs(wave) * 1e-4,
            age=0.01 + wave / 500,
            flags=number % 256 | TickFlag.FRESH,
            seq_sent=2**32 - 1 - number,
            seq_received=number,
            rig_time=number * 0.00101,
        )
    )


def recorded(
    path: Path, ticks: int, settings: RecorderSettings = DEFAULT_RECORDER, **changes
) -> Recorder:
    """A recorder that has been handed so many ticks."""
    recorder = Recorder(path, example_head(**changes), settings)
    for number in range(ticks):
        hand_over(recorder, number)
    return recorder


def wrong_rows(run: RunLog, rows: int | None = None) -> int:
    """How many of a run's ticks are not those that `hand_over` gives."""
    assert run.online is not None
    number = np.arange(run.online.time.size)
    wave = np.array([float(np.sin(each)) for each in number])
    expected = {
        "time": number * 0.001,
        "zeta": 0.78 + wave / 9,
        "x_sim": number / 3,
        "z_sim": wave,
        "vx_sim": wave / 7,
        "fx_sim": wave * 11,
        "fz_sim": wave * 13,
        "tuned": number % 2,
        "late": np.abs(wave) * 1e-4,
        "age": 0.01 + wave / 500,
        "flags": number % 256 | TickFlag.FRESH,
        "seq_sent": 2**32 - 1 - number,
        "seq_received": number,
        "rig_time": number * 0.00101,
    }
    wrong = sum(getattr(run.online, name) != values for name, values in expected.items())
    number = np.arange(run.measured.time.size)
    wave = np.array([float(np.sin(each)) for each in number])
    wrong = np.count_nonzero(wrong) + np.count_nonzero(run.measured.x != number / 70)
    wrong += np.count_nonzero(run.measured.z != -0.02 + wave / 1000)
    assert run.command.vx is not None
    number = np.arange(run.command.time.size)
    wave = np.array([float(np.sin(each)) for each in number])
    wrong += np.count_nonzero(run.command.vx != wave / 3)
    return int(wrong + np.count_nonzero(run.command.omega != 0.5 + wave))


def committed(part: Path) -> int:
    """Ticks that a reader sees as committed now, while the recording goes on."""
    with h5py.File(part, "r", swmr=True) as file:
        names = str(file["n_committed"].attrs["groups"]).split()
        return int(file["n_committed"][names.index("online")])


class Host:
    """The control program in a process of its own."""

    def __init__(self, path: Path, rate: float = 1000.0):
        self.path = path
        self.part = part_path(path)
        self.process = subprocess.Popen(
            [sys.executable, __file__, str(path), str(rate)], stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        self.recorder = int(self.process.stdout.readline())

    def wait_for_commits(self, ticks: int) -> None:
        """Until a reader sees that many ticks."""
        await_outcome(lambda: self.part.exists() and self._committed() >= ticks)

    def kill(self, *victims: str) -> tuple[int, int, str]:
        """End "host", "recorder" or both at once, as `kill -9` does.

        Returns:
            Ticks committed before the kill, ticks that the host had handed over before it, and
            what the host said at its end.
        """
        assert self.process.stdout is not None
        before = self._committed()
        for each in victims:
            os.kill(self.process.pid if each == "host" else self.recorder, signal.SIGKILL)
        said = self.process.stdout.read().splitlines()
        self.process.wait(DEADLINE)
        # A kill can fall into the printing of a number.
        counts = [int(each) for each in said[:-1] if each.isdigit()]
        return before, max(counts, default=0), said[-1] if said else ""

    def _committed(self) -> int:
        try:
            return committed(self.part)
        except (OSError, KeyError):  # it is being made
            return 0


def await_outcome(holds) -> None:
    """Wait until it holds; an AssertionError after the deadline."""
    deadline = time.monotonic() + DEADLINE
    while not holds():
        assert time.monotonic() < deadline, "the outcome did not come in time"
        time.sleep(0.01)


def trial(folder: Path, victims: tuple[str, ...], dice: random.Random) -> tuple[int, int, int]:
    """One kill at a random time.

    Returns:
        Ticks that had to be kept, ticks that were, and rows that are not as handed over.
    """
    host = Host(folder / "run.h5")
    host.wait_for_commits(1)
    time.sleep(dice.uniform(0.0, 1.2))
    before, handed, said = host.kill(*victims)
    if "recorder" in victims:
        if "host" not in victims:
            assert said.startswith("lost: "), said
        await_outcome(lambda: repaired(host.part))
        wanted = before
    else:
        await_outcome(lambda: host.path.exists() and not host.part.exists())
        wanted = max(before, handed)
    run = read_run_guarded(host.path)
    assert run.online is not None
    return wanted, run.online.time.size, wrong_rows(run)


def repaired(part: Path) -> bool:
    """Repair it once the system has let go of the lock."""
    if is_held(part):
        return False
    repair(part)
    return True


def main() -> None:
    """Record until the recorder is lost, or for ever."""
    recorder = Recorder(sys.argv[1], example_head())
    print(recorder.pid, flush=True)
    start, number = time.monotonic(), 0
    while recorder.alive:
        due = int((time.monotonic() - start) * float(sys.argv[2]))
        for each in range(number, due):
            hand_over(recorder, each)
        if due > number and recorder.alive:
            number = due
            print(number, flush=True)
        time.sleep(0.002)
    recorder.event(number * 0.001, Event.FAILED)
    try:
        recorder.close("lost")
    except InputError as error:
        print(f"lost: {error}", flush=True)


if __name__ == "__main__":
    main()
