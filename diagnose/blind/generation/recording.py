"""Records of the plant's runs: noise, resolution, run logs, and the folder of a set."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from diagnose.blind.answers.answer import UNFINISHED
from diagnose.blind.generation.settings import (
    DEFAULT_GENERATION,
    DEFAULT_NOISE,
    GenerationSettings,
    NoiseSettings,
)
from diagnose.blind.plant.plant import DEFAULT_PLANT
from diagnose.blind.plant.rig import DEFAULT_RIG, GRAVITY, PlantRig
from diagnose.blind.plant.run_plan import PlannedRun
from diagnose.blind.plant.sensors import PlantReading
from drftjax.runlog.hdf5.api import write_run
from drftjax.runlog.record import Measured, RecordedCommand, RecordedSetup, RunLog

# Interval at which the controller writes the command down, whatever the logger's rate [s].
COMMAND_INTERVAL = 0.01


@dataclass(frozen=True)
class Logger:
    """Recorder of a rig's runs.

    Attributes:
        rig: The rig.
        interval: Time between its rows [s].
        settings: Noise and resolution.
    """

    rig: PlantRig = DEFAULT_RIG
    interval: float = DEFAULT_PLANT.row_interval
    settings: GenerationSettings = DEFAULT_GENERATION

    @property
    def white(self) -> dict[str, float]:
        """Standard deviation of the white noise by channel [m, N, N m]."""
        noise, load = self.settings.noise, self.rig.mass_z * GRAVITY
        positions = {channel: noise.white(channel) for channel in ("x", "z")}
        if not self.rig.is_driven:
            return positions
        force = noise.white_force * load
        torque = noise.white_torque * load * self.rig.radius
        return {**positions, "fx": force, "fz": force, "torque": torque}

    def record(
        self, motion: PlantReading, planned: PlannedRun, random: np.random.Generator
    ) -> RunLog:
        """Record a run as its rig does: with noise, in whole counts, and the believed set-up."""
        settings, noise, rig = self.settings, self.settings.noise, self.rig

        def counted(channel: str, white: float) -> np.ndarray:
            added = add_noise(random, len(motion.time), white, noise, self.interval)
            count = noise.resolution if channel in ("x", "z") else 1e3 * noise.resolution
            return np.round((getattr(motion, channel) + added) / count) * count

        channels = {channel: counted(channel, white) for channel, white in self.white.items()}
        at_rest = motion.time < min(settings.static_reading_time, planned.rest)
        logged = motion.time >= planned.logged_from - 1e-9
        setup = RecordedSetup(
            wheel_radius=rig.radius,
            wheel_width=rig.width,
            grouser_count=rig.grouser_count,
            grouser_height=rig.grouser_height if rig.grouser_count else 0.0,
            grouser_thickness=rig.grouser_thickness if rig.grouser_count else 0.0,
            mass_x=rig.mass_x,
            mass_z=planned.mass,
            gravity=GRAVITY,
            bulk_density=1490.0,
            sinkage_static=float(-channels["z"][at_rest].mean()),
            scaling_factor_initial=settings.believed_zeta,
        )
        time = np.arange(round(planned.duration / COMMAND_INTERVAL) + 1, dtype=float)
        time *= COMMAND_INTERVAL
        carriage = planned.carriage_speed(time) if rig.is_driven else None
        return RunLog(
            setup=setup,
            command=RecordedCommand(time=time, omega=planned.omega(time), vx=carriage),
            measured=Measured(
                time=motion.time[logged],
                **{channel: values[logged] for channel, values in channels.items()},
            ),
            source="virtual rig",
            title="single-wheel run",
        )


def add_noise(
    random: np.random.Generator,
    rows: int,
    white: float,
    settings: NoiseSettings = DEFAULT_NOISE,
    interval: float = DEFAULT_PLANT.row_interval,
) -> np.ndarray:
    """Draw white noise plus correlated noise (AR(1)).

    Args:
        random: Source of the noise.
        rows: Number of rows.
        white: Standard deviation of the white part, in the unit of the result.
        settings: Size and time constant of the correlated part.
        interval: Interval of the rows [s].

    Returns:
        Noise, shape (rows,).
    """
    kept = np.exp(-interval / settings.correlation_time)
    spread = settings.correlated_share * white
    shocks = spread * np.sqrt(1 - kept**2) * random.standard_normal(rows)
    correlated = np.empty(rows)
    value = spread * random.standard_normal()
    for index, shock in enumerate(shocks):
        value = kept * value + shock
        correlated[index] = value
    return correlated + white * random.standard_normal(rows)


def write_set(folder: Path, logs: dict[str, RunLog]) -> None:
    """Write the runs of a set beside its folder, and give that its name when all are there.

    Args:
        folder: Folder of the set.
        logs: Run logs by their path in it, without the extension.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=UNFINISHED, dir=folder.parent) as scratch:
        draft = Path(scratch) / folder.name
        for name, log in logs.items():
            path = draft / f"{name}.h5"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_run(path, log)
        draft.rename(folder)
