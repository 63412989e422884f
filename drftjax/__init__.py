"""Dynamic resistive force theory for rover wheels on sand, on JAX.

The public names below are imported on first use, so that `import drftjax` and `drft --help` stay
fast and a program can still set JAX up before it is loaded.
"""

from typing import TYPE_CHECKING

from drftjax.lazy import lazily

if TYPE_CHECKING:
    from drftjax.command import Command as Command
    from drftjax.errors import InputError as InputError
    from drftjax.outline import OutlineWheel as OutlineWheel
    from drftjax.rig import DrivenCarriage as DrivenCarriage
    from drftjax.rig import FreeCarriage as FreeCarriage
    from drftjax.rig import Rig as Rig
    from drftjax.rollout import simulate as simulate
    from drftjax.runlog.hdf5 import read_run as read_run
    from drftjax.runlog.hdf5 import write_run as write_run
    from drftjax.runlog.record import RunLog as RunLog
    from drftjax.scaling import ConstantZeta as ConstantZeta
    from drftjax.scaling import KnotZeta as KnotZeta
    from drftjax.scaling import PerStepZeta as PerStepZeta
    from drftjax.simulator import Output as Output
    from drftjax.simulator import Simulator as Simulator
    from drftjax.simulator import State as State
    from drftjax.stress import Dynamic as Dynamic
    from drftjax.stress import QuasiStatic as QuasiStatic
    from drftjax.stress import StressCoefficients as StressCoefficients
    from drftjax.terrain import Terrain as Terrain
    from drftjax.wheel import GrouserWheel as GrouserWheel
    from drftjax.wheel import PlainWheel as PlainWheel
    from drftjax.wheel import Plates as Plates

__version__ = "0.1.0"

_HOMES = {
    "Command": "drftjax.command",
    "ConstantZeta": "drftjax.scaling",
    "DrivenCarriage": "drftjax.rig",
    "Dynamic": "drftjax.stress",
    "FreeCarriage": "drftjax.rig",
    "GrouserWheel": "drftjax.wheel",
    "InputError": "drftjax.errors",
    "KnotZeta": "drftjax.scaling",
    "OutlineWheel": "drftjax.outline",
    "Output": "drftjax.simulator",
    "PerStepZeta": "drftjax.scaling",
    "PlainWheel": "drftjax.wheel",
    "Plates": "drftjax.wheel",
    "QuasiStatic": "drftjax.stress",
    "Rig": "drftjax.rig",
    "RunLog": "drftjax.runlog.record",
    "Simulator": "drftjax.simulator",
    "State": "drftjax.simulator",
    "StressCoefficients": "drftjax.stress",
    "Terrain": "drftjax.terrain",
    "read_run": "drftjax.runlog.hdf5",
    "simulate": "drftjax.rollout",
    "write_run": "drftjax.runlog.hdf5",
}

__all__ = [*_HOMES]  # pyright: ignore[reportUnsupportedDunderAll]

__getattr__, __dir__ = lazily(globals(), _HOMES)
