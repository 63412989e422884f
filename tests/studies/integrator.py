"""Which step: the study behind `docs/theory/integrator.md`.

    python -m tests.studies.integrator [-o docs/figures]

Errors are against this project's own fine solution (steps of 0.1 ms), over three runs: the paper's
profile, 300 deg/s, and a wheel that falls onto soft sand. Some minutes.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from drftjax.physics.integrator import DEFAULT_STEP
from drftjax.physics.state import Output
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.physics.wheel import GrouserWheel
from drftjax.simulation.rollout import simulate
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.step_choice import choose_step
from drftjax.simulation.trial import Trial
from tests.studies.runs import REFERENCE_RUNS, Run, profile, reference, roll

STEPS = (5e-4, 1e-3, 2.5e-3, 5e-3, 1e-2)
FINE_STEP = 1e-4
PLATE_SIZES = (0.008, 0.004, 0.002, 0.001)
# Rows of all runs fall on whole multiples of every step.
INTERVAL = 0.02
REFERENCES = Path(__file__).resolve().parents[3] / "shared"

FAST_TIME, FAST_OMEGA = (0, 1, 4, 6, 9, 10), (0, 0, 300, 300, 0, 0)


def cases() -> dict[str, Run]:
    soft = Simulator(terrain=Terrain(ConstantZeta(0.3)))
    return {
        "paper": profile(),
        "300 deg/s": profile(None, FAST_TIME, FAST_OMEGA),
        "drop": profile(soft, (0, 1), (0, 0), sinkage=-0.05),
    }


def errors(rows: Output, fine: Output) -> tuple[float, float]:
    """Root mean square error of z and the error of the final x, both in mm."""
    z = np.asarray(rows.z, float) - np.asarray(fine.z, float)
    return 1e3 * float(np.sqrt(np.mean(z**2))), 1e3 * float(rows.x[-1] - fine.x[-1])


def in_single_precision(run: Run, step: float) -> Output:
    def single(leaf):
        return leaf.astype(jnp.float32) if eqx.is_inexact_array(leaf) else leaf

    given = (run.simulator, run.start(), run.commands(step))
    simulator, start, commands = jax.tree.map(single, given)
    with jax.enable_x64(False):
        _, rows = roll(simulator, start, commands, step, every=round(INTERVAL / step))
    return jax.tree.map(lambda leaf: np.asarray(leaf, float), rows)


def gradient(run: Run, step: float) -> np.ndarray:
    """Derivatives of mean z and final x by the logarithms of zeta, radius and grouser height."""

    def parameters(simulator):
        return (
            simulator.terrain.zeta.value,
            simulator.wheel.radius,
            simulator.wheel.grouser_height,
        )

    start, commands = run.start(), run.commands(step)

    @jax.jit
    @jax.jacfwd
    def derivative(factors):
        values = [factor * p for factor, p in zip(factors, parameters(run.simulator), strict=True)]
        simulator = eqx.tree_at(parameters, run.simulator, values)
        _, rows = simulate(simulator, start, commands, step, every=round(INTERVAL / step))
        return jnp.stack([jnp.mean(rows.z), rows.x[-1]])

    return np.asarray(derivative(jnp.ones(3)))


def table(title: str, heads: Sequence[str], lines: Sequence[Sequence[str]]) -> None:
    print(f"\n{title}\n")
    print("| " + " | ".join(heads) + " |")
    print("|" + "---|" * len(heads))
    for line in lines:
        print("| " + " | ".join(line) + " |")


def milliseconds(step: float) -> str:
    return f"{step * 1e3:g}"


def study_steps(fine: dict[str, Output]) -> dict[str, list[float]]:
    """Print and return the error in z of each case, a value a step."""
    found: dict[str, list[float]] = {}
    lines = []
    for case, run in cases().items():
        measured = [errors(run.rows(step, INTERVAL), fine[case]) for step in STEPS]
        found[case] = [z for z, _ in measured]
        lines.append([case, *(f"{z:.3f} / {x:+.2f}" for z, x in measured)])
    heads = ["run", *(f"{milliseconds(step)} ms" for step in STEPS)]
    table("Error by step: RMS of z / final x, in mm", heads, lines)
    return found


def study_choice() -> None:
    """The step that is chosen for each case, and its estimated error."""
    lines = []
    for case, run in cases().items():
        still = jnp.zeros_like(run.time)
        trial = Trial(
            run.simulator, run.start(), run.time, run.omega, still, jnp.asarray(0.0), 1, 1
        )
        lines.append([case, str(choose_step(trial))])
    table("Step chosen by the estimate of the error", ["run", "choice"], lines)


def study_precision() -> None:
    lines = []
    for step in STEPS:
        cells = []
        for run in cases().values():
            z, x = errors(in_single_precision(run, step), run.rows(step, INTERVAL))
            cells.append(f"{z:.4f} / {x:+.3f}")
        lines.append([milliseconds(step), *cells])
    table(
        "Single against double precision at the same step: RMS of z / final x, in mm",
        ["step, ms", *cases()],
        lines,
    )


def study_plates() -> None:
    """Plate size at the default step, against plates of a quarter of a millimetre."""
    runs = {size: profile(Simulator(wheel=GrouserWheel(plate_size=size))) for size in PLATE_SIZES}
    fine = profile(Simulator(wheel=GrouserWheel(plate_size=2.5e-4))).rows(DEFAULT_STEP, INTERVAL)
    lines = []
    for size, run in runs.items():
        z, x = errors(run.rows(DEFAULT_STEP, INTERVAL), fine)
        count = run.simulator.wheel.cut().plates(jnp.zeros(())).x.size
        lines.append([milliseconds(size), str(count), f"{z:.4f}", f"{x:+.3f}"])
    table(
        "Plate size over the paper's profile, against 0.25 mm",
        ["plate size, mm", "plates", "RMS of z, mm", "final x, mm"],
        lines,
    )


def study_gradients() -> list[float]:
    """Print and return the largest relative error of six derivatives, a value a step."""
    exact = gradient(profile(), FINE_STEP)
    found: list[float] = []
    lines = []
    for step in STEPS:
        error = gradient(profile(), step) / exact - 1
        found.append(float(np.max(np.abs(error))))
        lines.append([milliseconds(step), *(f"{100 * value:+.2f}" for value in error.ravel())])
    outcomes = ("mean z", "final x")
    parameters = ("zeta", "radius", "grouser height")
    heads = [f"{outcome} by {parameter}" for outcome in outcomes for parameter in parameters]
    table(
        "Derivatives over the paper's profile: error in percent of the fine ones",
        ["step, ms", *heads],
        lines,
    )
    return found


def study_references() -> None:
    if not REFERENCES.is_dir():
        print("\nNo folder ../shared with the reference runs: that table is left out.")
        return
    lines = []
    steps = (1e-3, 2.5e-3, 5e-3, 1e-2)
    for case in REFERENCE_RUNS:
        run, z, x = reference(REFERENCES, case)
        cells = []
        for step in steps:
            rows = run.rows(step)
            error = float(np.sqrt(np.mean((np.asarray(rows.z) - z) ** 2)))
            cells.append(f"{1e3 * error:.3f} / {1e3 * float(rows.x[-1] - x[-1]):+.2f}")
        lines.append([case, *cells])
    table(
        "Against the reference runs: RMS of z / final x, in mm",
        ["run", *(f"{milliseconds(step)} ms" for step in steps)],
        lines,
    )


def study_falls() -> None:
    """How far a wheel dropped from 50 mm climbs out of the sand again, which no sand can do."""
    lines = []
    for zeta in (0.3, 0.7823, 2.0):
        simulator = Simulator(terrain=Terrain(ConstantZeta(zeta)))
        run = profile(simulator, (0, 1), (0, 0), sinkage=-0.05)
        paths = [run.rows(step, INTERVAL).z for step in STEPS]
        lines.append([f"{zeta:g}", *(f"{1e3 * float(z[-1] - jnp.min(z)):.3f}" for z in paths)])
    heads = ["zeta", *(f"{milliseconds(step)} ms" for step in STEPS)]
    table("Climb in the 0.8 s after a fall from 50 mm, in mm", heads, lines)


def mark_steps(axis: Axes) -> None:
    axis.set_xlabel("step [ms]")
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_xticks([1e3 * step for step in STEPS], [milliseconds(step) for step in STEPS])
    axis.axvline(1e3 * DEFAULT_STEP, color="k", lw=0.5, ls=":")


def figure(folder: Path, by_step: dict[str, list[float]], by_gradient: list[float]) -> None:
    panels, (heights, drop, slopes) = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
    milli = 1e3 * np.asarray(STEPS)
    for case, values in by_step.items():
        heights.loglog(milli, values, "o-", label=case)
    heights.set(title="error by step", ylabel="RMS error of z [mm]")
    mark_steps(heights)
    heights.legend()

    run = cases()["drop"]
    for step in (FINE_STEP, DEFAULT_STEP, 1e-2):
        rows = run.rows(step, 0.01)
        drop.plot(rows.time, 1e3 * rows.z, label=f"{milliseconds(step)} ms")
    drop.set(ylim=(-86, -74), title="drop: the wheel lands at 0.2 s")
    drop.set(xlabel="time [s]", ylabel="z [mm]")
    drop.legend()

    slopes.loglog(milli, 100 * np.asarray(by_gradient), "o-")
    slopes.set(title="derivatives over the paper's profile", ylabel="largest error of six [%]")
    mark_steps(slopes)
    folder.mkdir(parents=True, exist_ok=True)
    panels.savefig(folder / "integrator.png", dpi=110)
    print(f"\n{folder / 'integrator.png'}")


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, help="folder for the figure")
    folder = parser.parse_args().output
    fine = {case: run.rows(FINE_STEP, INTERVAL) for case, run in cases().items()}
    by_step = study_steps(fine)
    study_choice()
    study_references()
    study_falls()
    by_gradient = study_gradients()
    study_precision()
    study_plates()
    if folder is not None:
        figure(folder, by_step, by_gradient)


if __name__ == "__main__":
    main()
