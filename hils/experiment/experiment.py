r"""The experiment of Fuke, Ishikawa & Ishigami 2024 again, on a virtual rig whose sand loosens.

The wheel's trajectory by three methods, each from beds prepared again:

- **free**: the rig's carriage runs free, nothing is simulated. It is the reference of the others.
- **HILS-DRFT**: the loop tunes zeta by eq. 7 and drives the carriage at the simulated speed.
- **DRFT**: the same simulation with zeta held at its value by statics before the wheel turns.

The rig's physics is not the loop's: finer steps, sand that loosens as the wheel turns, beds that
differ, scales with noise and counts. Everything runs in virtual time.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.tuning.registry import TunerSetUp
from hils.control.compiled_step import NO_READING
from hils.control.loop_config import LoopSetUp, Start, shared_physics
from hils.control.stop_request import StopRequest
from hils.experiment.spectrum import Spectrum, order, spectrum
from hils.procedure.operator_prompts import UnattendedPrompts
from hils.procedure.procedure import Procedure, RunReport, run
from hils.recording.sinks import InMemorySink
from hils.rig_sim.config import BedSetUp, VirtualSetUp
from hils.rig_sim.in_process import QUICK, soft_rig

SCHEMA, VERSION = "drft-hils-paper", 1


# What the paper reports: HILS-DRFT's and DRFT's mean trajectory against its experiment [m], and
# the frequency of the ripple that it calls the grousers' [Hz].
PAPER_HILS, PAPER_DRFT, PAPER_RIPPLE = 5.0e-3, 8.4e-3, 1.68


# Its claim for z of HILS (sim) and HILS (real) [m].
PAPER_RMSE = 1e-3


# Shortest stretch at the top speed in which a ripple can be measured [s].
LEAST_STEADY = 2.0


TICKS = (0.002, 0.005, 0.01, 0.02, 0.04, 0.08)


Values = NDArray[np.floating]


ReportProgress = Callable[[str], None]


def loosening_rig(loss: float = 0.3, decay: float = 2.0, scatter: float = 0.03) -> VirtualSetUp:
    """The paper's rig on sand that loosens with the wheel's turning.

    Args:
        loss: Share of zeta lost in the end [-].
        decay: Turning that loosens [rad].
        scatter: Of zeta from one bed to the next, as a share (standard deviation).
    """
    loosening = {"name": "loosening", "loss": loss, "decay": decay}
    return VirtualSetUp(
        title="a rig whose sand loosens",
        effects=[loosening],
        physics=QUICK,
        bed=BedSetUp(scatter),
    )


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Plan of the experiment.

    Attributes:
        loop: The loop and its profile.
        rig: The true sand and rig.
        runs: HILS runs, and as many free ones.
        seed: Of the first run; every run has noise and bed of its own.
    """

    loop: LoopSetUp
    rig: VirtualSetUp = field(default_factory=loosening_rig)
    runs: int = 10
    seed: int = 0

    def __post_init__(self):
        if self.runs < 1:
            raise InputError(f"runs is {self.runs}, must be at least 1")


class Trajectory(NamedTuple):
    """A trajectory, on the ticks.

    Attributes:
        x, z: Place of the axle [m], shape (ticks,).
    """

    x: Values
    z: Values


@dataclass(frozen=True)
class HilsRun:
    """A run with the rig in the loop.

    Attributes:
        seed: Of noise and bed.
        start: Sinkage at rest and zeta(0), as the procedure found them.
        simulated, measured: HILS (sim) and HILS (real).
        zeta: As tuned [-], shape (ticks,).
    """

    seed: int
    start: Start
    simulated: Trajectory
    measured: Trajectory
    zeta: Values

    @property
    def error(self) -> Values:
        """z of HILS (sim) minus that of HILS (real) [m]."""
        return self.simulated.z - self.measured.z

    @property
    def rmse(self) -> float:
        """Of z between HILS (sim) and HILS (real), over the whole run [m]."""
        return rms(self.error)


@dataclass(frozen=True)
class FreeRun:
    """A run with a free carriage, and what DRFT says of it beforehand.

    Attributes:
        seed, start: As for a `HilsRun`.
        measured: What the rig did.
        predicted: The simulation from the same start, zeta held at zeta(0).
    """

    seed: int
    start: Start
    measured: Trajectory
    predicted: Trajectory


class TrajectoryDistance(NamedTuple):
    """Distance of one trajectory from another, RMS [m], in four readings of the word.

    Attributes:
        plane: Between the two places in the x-z plane at the same time.
        z: Of the heights at the same time.
        x: Of the travels at the same time.
        course: Of the heights at the same travel: z(x), time left out.
    """

    plane: float
    z: float
    x: float
    course: float


@dataclass(frozen=True)
class ExperimentResult:
    """The experiment made.

    Attributes:
        experiment: What was asked.
        time: Of the ticks [s].
        omega: Commanded angular velocity there [rad/s].
        hils, free: The runs.
    """

    experiment: Experiment
    time: Values
    omega: Values
    hils: tuple[HilsRun, ...]
    free: tuple[FreeRun, ...]

    def means(self) -> dict[str, Trajectory]:
        """Mean trajectory over the runs: HILS (sim), HILS (real), DRFT and free."""
        return {
            "HILS (sim)": mean_trajectory([each.simulated for each in self.hils]),
            "HILS (real)": mean_trajectory([each.measured for each in self.hils]),
            "DRFT": mean_trajectory([each.predicted for each in self.free]),
            "free": mean_trajectory([each.measured for each in self.free]),
        }

    def distances(self) -> dict[str, TrajectoryDistance]:
        """Each mean trajectory's distance from the mean free one."""
        means = self.means()
        free = means.pop("free")
        return {name: trajectory_distance(path, free) for name, path in means.items()}

    def steady_stretch(self) -> tuple[slice, float]:
        """The ticks of the longest stretch at the top speed, and that speed [rad/s]."""
        return steady_stretch(self.omega, self.experiment.loop.tick)

    def spectra(self) -> dict[str, Spectrum]:
        """Mean amplitude spectra over the HILS runs, at the steady speed."""
        stretch, _ = self.steady_stretch()
        kinds: dict[str, Callable[[HilsRun], Values]] = {
            "z, HILS (sim)": lambda each: each.simulated.z,
            "z, HILS (real)": lambda each: each.measured.z,
            "z, sim - real": lambda each: each.error,
            "zeta": lambda each: each.zeta,
        }
        tick = self.experiment.loop.tick
        made = {}
        for name, kind in kinds.items():
            each = [spectrum(kind(one)[stretch], tick) for one in self.hils]
            amplitude = np.mean([one.amplitude for one in each], axis=0)
            made[name] = each[0]._replace(amplitude=amplitude)
        return made

    def document(self) -> dict[str, Any]:
        """All of it but the curves, for a file; lengths in mm, as their names say."""
        experiment, (_, top) = self.experiment, self.steady_stretch()
        loop = experiment.loop
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "runs": experiment.runs,
            "seed": experiment.seed,
            "tick": loop.tick,
            "tuner": msgspec.to_builtins(loop.tuner),
            "rig": msgspec.to_builtins(experiment.rig),
            "hils": [
                {
                    "seed": each.seed,
                    "sinkage_static_mm": each.start.sinkage * 1e3,
                    "zeta_0": each.start.zeta,
                    "zeta_end": float(each.zeta[-1]),
                    "rmse_z_mm": each.rmse * 1e3,
                    "largest_z_mm": float(np.abs(each.error).max()) * 1e3,
                }
                for each in self.hils
            ],
            "close": sum(each.rmse < PAPER_RMSE for each in self.hils),
            "from_free_mm": {
                name: {kind: value * 1e3 for kind, value in found._asdict().items()}
                for name, found in self.distances().items()
            },
            "paper_mm": {"HILS-DRFT": PAPER_HILS * 1e3, "DRFT": PAPER_DRFT * 1e3},
            "free_scatter_z_mm": self.scatter() * 1e3,
            "lines": {
                name: [
                    {
                        "frequency_hz": line.frequency,
                        "order": order(line.frequency, top),
                        "amplitude": line.amplitude,
                    }
                    for line in found.lines()
                ]
                for name, found in self.spectra().items()
            },
        }

    def scatter(self) -> float:
        """Standard deviation of z between free runs, RMS over time [m]; 0 for a single run."""
        if len(self.free) < 2:
            return 0.0
        return rms(np.std([each.measured.z for each in self.free], axis=0, ddof=1))


def run_experiment(
    experiment: Experiment, report_progress: ReportProgress = lambda said: None
) -> ExperimentResult:
    """Make the HILS runs and the free ones, one after the other, in virtual time.

    Args:
        experiment: What is to be done.
        report_progress: Takes a line on what comes next.

    Raises:
        InputError: where a run cannot be made or does not reach the end of its profile.
    """
    physics = shared_physics(experiment.loop)
    time = np.arange(physics.ticks) * experiment.loop.tick
    # What was asked at a tick's start is the end of the tick before.
    omega = np.r_[0.0, physics.omega[:-1, -1]]
    steady_stretch(omega, experiment.loop.tick)  # refuses a profile without one before the runs
    hils, free = [], []
    for number in range(experiment.runs):
        report_progress(f"HILS run {number + 1} of {experiment.runs}")
        hils.append(hils_run(experiment, experiment.seed + number))
    for number in range(experiment.runs):
        report_progress(f"free run {number + 1} of {experiment.runs}")
        # Other beds than the HILS runs had, as in a laboratory.
        free.append(free_run(experiment, experiment.seed + experiment.runs + number))
    return ExperimentResult(experiment, time, omega, tuple(hils), tuple(free))


def hils_run(experiment: Experiment, seed: int) -> HilsRun:
    """One run with the rig in the loop."""
    start, rows = _run_once(experiment, seed, free=False)
    online = np.array(rows.ticks)[: shared_physics(experiment.loop).ticks]
    time, zeta, x, z = online[:, :4].T
    return HilsRun(seed, start, Trajectory(x, z), _measured(rows, time), zeta)


def free_run(experiment: Experiment, seed: int) -> FreeRun:
    """One run with a free carriage, and DRFT from its start."""
    start, rows = _run_once(experiment, seed, free=True)
    predicted = predict_by_drft(experiment.loop, start)
    time = np.arange(len(predicted.x)) * experiment.loop.tick
    return FreeRun(seed, start, _measured(rows, time), predicted)


def predict_by_drft(loop: LoopSetUp, start: Start) -> Trajectory:
    """The loop's simulation over its profile with zeta held, on the ticks."""
    held = TunerSetUp("step", {"zeta_step": 0.0})
    physics = shared_physics(msgspec.structs.replace(loop, tuner=held))
    packed, places = physics.begin(start), []
    for omega in physics.omega:
        said = physics.step.compute(packed)
        places.append((said.x, said.z))
        packed = physics.step(packed, NO_READING, omega)
    return Trajectory(*np.array(places).T)


def runs_by_tick(
    experiment: Experiment,
    ticks: tuple[float, ...] = TICKS,
    report_progress: ReportProgress = lambda said: None,
) -> dict[float, HilsRun]:
    """One HILS run at each tick [s], on the first run's bed with its noise."""
    made = {}
    for tick in ticks:
        report_progress(f"a HILS run with a tick of {tick * 1e3:g} ms")
        loop = msgspec.structs.replace(experiment.loop, tick=tick)
        other = Experiment(loop=loop, rig=experiment.rig, runs=1, seed=experiment.seed)
        made[tick] = hils_run(other, experiment.seed)
    return made


# Measures -----------------------------------------------------------------------------------------


def steady_stretch(omega: Values, tick: float) -> tuple[slice, float]:
    """The ticks of the longest stretch at the top speed, and how fast that is [rad/s].

    Args:
        omega: Angular velocity at each tick, either way [rad/s].
        tick: Control period [s].

    Raises:
        InputError: there is no such stretch of two seconds.
    """
    top = omega[np.argmax(np.abs(omega))]
    held = np.abs(omega - top) < 1e-9
    edges = np.flatnonzero(np.diff(np.r_[False, held, False].astype(int))).reshape(-1, 2)
    first, last = edges[np.argmax(np.diff(edges, axis=1))]
    if top == 0 or (last - first) * tick < LEAST_STEADY:
        raise InputError(
            f"the profile holds its top speed for {(last - first) * tick:.3g} s, must turn and "
            f"hold it for {LEAST_STEADY:g} s at least, so that a ripple can be measured"
        )
    return slice(int(first), int(last)), abs(float(top))


def rms(values: Values) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def mean_trajectory(paths: list[Trajectory]) -> Trajectory:
    """The mean place at each time."""
    return Trajectory(
        *(np.mean([getattr(path, axis) for path in paths], axis=0) for axis in ("x", "z"))
    )


def trajectory_distance(path: Trajectory, other: Trajectory) -> TrajectoryDistance:
    """Distance of two trajectories from each other, RMS over the run [m]."""
    dx, dz = path.x - other.x, path.z - other.z
    # Travel the way that the wheel goes farther; what is taken twice, as noise at rest has it, or a
    # wheel that comes back, belongs to the first time.
    way = 1 if path.x.max() >= -path.x.min() else -1
    travel, others = (np.maximum.accumulate(way * each.x) for each in (path, other))
    place = np.linspace(0.0, min(travel[-1], others[-1]), 1000)
    course = np.interp(place, travel, path.z) - np.interp(place, others, other.z)
    return TrajectoryDistance(rms(np.hypot(dx, dz)), rms(dz), rms(dx), rms(course))


# Runs ---------------------------------------------------------------------------------------------


def _run_once(experiment: Experiment, seed: int, free: bool) -> tuple[Start, InMemorySink]:
    soft, rows = soft_rig(experiment.rig, seed=seed), InMemorySink()
    procedure = Procedure(loop=experiment.loop, free=free)
    report = run(
        procedure, soft.link, soft.clock, rows, UnattendedPrompts(quiet=True), StopRequest()
    )
    return _start_of(report, seed), rows


def _start_of(report: RunReport, seed: int) -> Start:
    if not report.completed or report.start is None:
        raise InputError(f"the run with seed {seed} did not reach its end: {report.reason}")
    return report.start


def _measured(rows: InMemorySink, time: Values) -> Trajectory:
    times, x, z, *_ = np.array(rows.readings).T
    return Trajectory(np.interp(time, times, x), np.interp(time, times, z))
