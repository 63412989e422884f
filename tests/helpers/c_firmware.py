"""The reference firmware of `firmware/`, built with the computer's own compiler."""

import ctypes
import functools
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

from hils.link.messages import Drop, RigState
from hils.rig_sim.firmware import RigIdentity

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE, TESTS = ROOT / "firmware", ROOT / "tests" / "firmware"
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror")
BENCH = "python_bench.c"

# In the order of the header's RIG_DROP_...
CAUSES = (
    *(Drop.OVERLONG, Drop.COBS, Drop.SHORT, Drop.CRC, Drop.VERSION),
    *(Drop.TYPE, Drop.LENGTH, Drop.DIRECTION, Drop.SESSION, Drop.ORDER),
)


def compile_c(output: Path, *arguments: str | Path) -> Path:
    """Compile C sources, without a warning where `WARNINGS` are among the arguments."""
    if (compiler := shutil.which("cc")) is None:
        pytest.skip("there is no C compiler `cc` on this computer")
    command = [compiler, *map(str, arguments), "-o", str(output)]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    return output


class _Identity(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_uint32) for name in ("rig_id", "boot_id")),
        *((name, ctypes.c_float) for name in ("z_scale", "x_scale", "omega_max", "vx_max")),
        *((name, ctypes.c_float) for name in ("omega_slew", "vx_slew")),
    )


@functools.cache
def library(change: tuple[str, str] | None = None) -> ctypes.CDLL:
    """The firmware with `python_bench.c`, ready to be called.

    Args:
        change: Text that stands once in either file, and what to put there: a broken rig.
    """
    sources = {path: path.read_text() for path in (FIRMWARE / "rig_protocol.c", TESTS / BENCH)}
    if change is not None:
        assert sum(text.count(change[0]) for text in sources.values()) == 1, change[0]
    with tempfile.TemporaryDirectory(prefix="firmware-") as folder:
        written = []
        for path, text in sources.items():
            written.append(Path(folder) / path.name)
            written[-1].write_text(text if change is None else text.replace(*change))
        options = ("-O0", "-shared", "-fPIC", f"-I{FIRMWARE}")
        built = ctypes.CDLL(str(compile_c(Path(folder) / "rig.so", *options, *written)))
    for name in ("bench_size", "bench_take"):
        getattr(built, name).restype = ctypes.c_size_t
    for name in ("bench_omega", "bench_vx"):
        getattr(built, name).restype = ctypes.c_float
    return built


class CFirmware:
    """The firmware in explicit time, as `SteppedRig`.

    Args:
        identity: Of the rig.
        stands: True for scales that tell constants.
        start: Time at power-up [s].
        change: Change of the sources that breaks it.
    """

    def __init__(
        self,
        identity: RigIdentity,
        stands: bool = False,
        start: float = 0.0,
        change: tuple[str, str] | None = None,
    ):
        self._library = library(change)
        self._bench = ctypes.create_string_buffer(self._library.bench_size())
        self._out = ctypes.create_string_buffer(1 << 16)
        values = (getattr(identity, name) for name, _ in _Identity._fields_)
        self._library.bench_power(
            self._bench, ctypes.byref(_Identity(*values)), int(stands), self._us(start)
        )

    def advance(self, now: float, data: bytes) -> bytes:
        self._library.bench_advance(self._bench, self._us(now), data, ctypes.c_size_t(len(data)))
        return self.said()

    def said(self) -> bytes:
        count = self._library.bench_take(self._bench, self._out)
        return bytes(self._out[:count])

    def press(self, reason: int, now: float) -> bytes:
        self._library.bench_press(self._bench, reason, self._us(now))
        return self.said()

    def fail(self, reason: int, fault: int, now: float) -> bytes:
        self._library.bench_break(self._bench, reason, fault, self._us(now))
        return self.said()

    @property
    def state(self) -> RigState:
        return RigState(self._library.bench_state(self._bench))

    @property
    def demand(self) -> tuple[float, float]:
        return self._library.bench_omega(self._bench), self._library.bench_vx(self._bench)

    @property
    def emergency_stops(self) -> int:
        return self._library.bench_stops(self._bench)

    @property
    def drops(self) -> dict[Drop, int]:
        counts = {
            cause: self._library.bench_drops(self._bench, place)
            for place, cause in enumerate(CAUSES)
        }
        return {cause: count for cause, count in counts.items() if count}

    @staticmethod
    def _us(seconds: float) -> ctypes.c_uint32:
        return ctypes.c_uint32(round(seconds * 1e6) & 0xFFFFFFFF)
