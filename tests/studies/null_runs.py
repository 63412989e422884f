"""Runs of rigs with nothing wrong, each fitted with one zeta: what is left beside the noise floor.

    python -m tests.studies.null_runs [FOLDER ...]

Some of these wheels rise as they begin to turn. The last columns say how fast, and which share of
its weight the model's sand gives a wheel that rises so: with far less than all of it, none can.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from drftjax.recorded.prepared_run import PreparedRun, prepare_runs
from identify.fit_constant import fit
from identify.parameters.parameter import parameter
from identify.results.noise_floor import noise_floor
from identify.results.values import RunFit

FOLDERS = ("../shared/blind/single_practice/set_11", "../shared/blind/single_practice/set_12")
# After the wheel begins to turn: what "at the start" is the mean of, and where a rise is looked
# for, by straight lines through so many samples [s], [s], [-].
JUMP, BEGINNING, SAMPLES = 0.1, 0.2, 5
# Wheel angles within one grouser's pitch, and carriage speeds up to the rim's, that are tried.
ANGLES, SPEEDS = 60, 5
# What is left counts as the noise floor where it is no more than this over it.
NEAR = 1.1


@dataclass(frozen=True)
class Left:
    """What a fit of one zeta leaves of a run's sinkage.

    Attributes:
        name: The run.
        zeta, error: The scaling factor that meets the sinkage, and its standard error.
        noise: White noise of the recorded sinkage [mm].
        with_travel: Simulated less recorded sinkage, RMS over the samples compared, where zeta
            meets travel and sinkage [mm].
        rmse: The same where zeta meets the sinkage alone.
        jump: Its mean just after the wheel begins to turn.
        rise: Fastest that the recorded wheel rises there [mm/s].
        support: Most of its weight that the sand gives a wheel that rises so [-].
    """

    name: str
    zeta: float
    error: float
    noise: float
    with_travel: float
    rmse: float
    jump: float
    rise: float
    support: float


def left(paths: list[Path]) -> Iterator[Left]:
    """Each run fitted alone with one zeta, by its sinkage and by all that was recorded."""
    for run, candidate, fitted in _by_sinkage(paths):
        (both,) = fit(prepare_runs([run]), [parameter("zeta", shared=False)]).runs
        residual = 1e3 * fitted.residuals["z"]
        begins = _begins(candidate)
        early = (fitted.time >= begins) & (fitted.time < begins + JUMP)
        (zeta,) = fitted.values.values()
        rise, support = _rise(candidate, zeta.value)
        yield Left(
            fitted.name,
            zeta.value,
            zeta.error,
            1e3 * float(candidate.observation.noise[0]),
            1e3 * float(np.sqrt(np.mean(both.residuals["z"][both.counts] ** 2))),
            float(np.sqrt(np.mean(residual[fitted.counts] ** 2))),
            float(residual[early].mean()),
            1e3 * rise,
            support,
        )


def floor_of_repeats(paths: list[Path]) -> float:
    """What the repeats among these runs differ by in sinkage, each with its own zeta [mm]."""
    return 1e3 * noise_floor([fitted for _, _, fitted in _by_sinkage(paths)])["z"]


def _by_sinkage(paths: list[Path]) -> Iterator[tuple[Path, PreparedRun, RunFit]]:
    for path in paths:
        (candidate,) = prepare_runs([path], compare=("z",))
        (fitted,) = fit([candidate], [parameter("zeta", shared=False)]).runs
        yield path, candidate, fitted


def _begins(candidate: PreparedRun) -> float:
    """When the wheel is first asked to turn, from the run's start [s]."""
    command = candidate.setup.command
    return command.time[int(np.flatnonzero(command.omega)[0])] - command.time[0]


def _rise(candidate: PreparedRun, zeta: float) -> tuple[float, float]:
    """The fastest rise after the start [m/s], and the sand's support there over the weight [-]."""
    observation, begins = candidate.observation, _begins(candidate)
    time, z = observation.time, observation.values[0]
    places = np.flatnonzero((time >= begins) & (time < begins + BEGINNING))
    lines = [np.polyfit(time[k : k + SAMPLES], z[k : k + SAMPLES], 1)[0] for k in places]
    steepest = int(np.argmax(lines))
    middle = places[steepest] + SAMPLES // 2
    simulator = candidate.trial.simulator.prepared()
    omega = jnp.interp(time[middle], candidate.trial.time, candidate.trial.omega)
    angles, speeds = jnp.meshgrid(
        jnp.linspace(0, 2 * jnp.pi / candidate.setup.wheel.grouser_count, ANGLES),
        jnp.linspace(0, candidate.setup.wheel.radius * omega, SPEEDS),
    )

    def support(angle: jax.Array, speed: jax.Array) -> jax.Array:
        place = jnp.array([0.0, z[middle]])
        velocity = jnp.stack([speed, jnp.asarray(lines[steepest])])
        return simulator.wrench(place, velocity, angle, omega, jnp.asarray(zeta))[1]

    most = float(jax.vmap(support)(angles.ravel(), speeds.ravel()).max())
    weight = candidate.setup.rig.mass_z * candidate.setup.rig.gravity
    return float(lines[steepest]), most / weight


def main() -> None:
    from drftjax.common.jax_config import configure_jax

    configure_jax()
    print(
        "| runs | zeta | noise of z [mm] | z RMSE, x and z compared [mm] | z alone [mm] | "
        "over the floor | at the start [mm] | rises by [mm/s] | support |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    told = []
    for folder in sys.argv[1:] or FOLDERS:
        paths = sorted(Path(folder).glob("*.h5"))
        floor = floor_of_repeats(paths)
        for each in left(paths):
            over = each.rmse / floor
            told.append(over)
            print(
                f"| {Path(folder).name} {each.name} | {each.zeta:.4f} ± {each.error:.4f} "
                f"| {each.noise:.4f} | {each.with_travel:.4f} | {each.rmse:.4f} | {over:.2f} "
                f"| {each.jump:+.3f} | {each.rise:.1f} | {100 * each.support:.0f} % |"
            )
        print(f"{Path(folder).name}: repeats differ by {floor:.4f} mm, the noise floor")
    print(f"{sum(each <= NEAR for each in told)} of {len(told)} within 10 % of it")


if __name__ == "__main__":
    main()
