"""Public names, for type checkers."""

from diagnose.api import diagnose as diagnose
from diagnose.api import evaluate as evaluate
from diagnose.change.result import ChangeDiagnosis as ChangeDiagnosis
from diagnose.evaluation.result import Evaluation as Evaluation
from diagnose.result import Diagnosis as Diagnosis
from drftjax.common.errors import InputError as InputError
from drftjax.common.jax_config import configure_jax as configure_jax
from drftjax.physics.command import Command as Command
from drftjax.physics.outline_wheel import OutlineWheel as OutlineWheel
from drftjax.physics.rig import DrivenCarriage as DrivenCarriage
from drftjax.physics.rig import FreeCarriage as FreeCarriage
from drftjax.physics.rig import Rig as Rig
from drftjax.physics.state import Output as Output
from drftjax.physics.state import State as State
from drftjax.physics.stress import Dynamic as Dynamic
from drftjax.physics.stress import QuasiStatic as QuasiStatic
from drftjax.physics.stress import StressCoefficients as StressCoefficients
from drftjax.physics.terrain import ConstantZeta as ConstantZeta
from drftjax.physics.terrain import KnotZeta as KnotZeta
from drftjax.physics.terrain import PerStepZeta as PerStepZeta
from drftjax.physics.terrain import Terrain as Terrain
from drftjax.physics.wheel import GrouserWheel as GrouserWheel
from drftjax.physics.wheel import PlainWheel as PlainWheel
from drftjax.physics.wheel import Plates as Plates
from drftjax.runlog.hdf5.api import read_run as read_run
from drftjax.runlog.hdf5.api import write_run as write_run
from drftjax.runlog.record import RunLog as RunLog
from drftjax.simulation.rollout import simulate as simulate
from drftjax.simulation.simulator import Simulator as Simulator
from identify.api import fit as fit
from identify.parameters.parameter import Parameter as Parameter
from identify.parameters.parameter import own as own
from identify.parameters.parameter import shared as shared
from identify.results.result import FitResult as FitResult
from identify.uncertainty.markov_chains import PosteriorSettings as PosteriorSettings

__version__: str
