"""Which integrator, and which step: the study behind `docs/theory/integrator.md`.

    python -m tests.studies.integrator [-o docs/figures]

Errors are against this project's own fine solution (the exact derivative at 50 microseconds), over
three runs: the paper's profile, 300 deg/s, and a wheel that falls onto soft sand. Some minutes.
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

from drftjax.physics.integrator import (
    DEFAULT_STEP,
    AbstractIntegrator,
    Explicit,
    HeldPace,
    Rosenbrock,
)
from drftjax.physics.state import Output
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.physics.wheel import GrouserWheel
from drftjax.simulation.rollout import simulate
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.statics import REST
from tests.studies.runs import Run, profile, reference, roll

INTEGRATORS = (Rosenbrock(), HeldPace(), Explicit())
STEPS = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 4e-3)
FINE_STEP = 5e-5
FINE_GRADIENT_STEP = 1e-4
GRADIENT_STEPS = (2e-4, 5e-4, 1e-3, 2e-3, 4e-3)
PLATE_SIZES = (0.008, 0.004, 0.002, 0.001)
# Rows of all runs fall on whole multiples of every step.
INTERVAL = 0.02
REFERENCES = Path(__file__).resolve().parents[3] / "shared"

FAST_TIME, FAST_OMEGA = (0, 1, 4, 6, 9, 10), (0, 0, 300, 300, 0, 0)
LABELS = {"Rosenbrock": "exact derivative", "HeldPace": "held pace", "Explicit": "explicit"}
COLOURS = {"Rosenbrock": "tab:blue", "HeldPace": "tab:orange", "Explicit": "tab:gray"}


def cases() -> dict[str, Run]:
    soft = Simulator(terrain=Terrain(ConstantZeta(0.3)))
    return {
        "paper": profile(),
        "300 deg/s": profile(None, FAST_TIME, FAST_OMEGA),
        "drop": profile(soft, (0, 1), (0, 0), sinkage=-0.05),
    }


def name_of(integrator: AbstractIntegrator) -> str:
    return type(integrator).__name__


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


def study_steps(fine: dict[str, Output]) -> dict[tuple[str, str], list[float]]:
    """Print and return the error in z of each case and integrator, a value a step."""
    found: dict[tuple[str, str], list[float]] = {}
    lines = []
    for case, run in cases().items():
        for integrator in INTEGRATORS:
            cells = []
            for step in STEPS:
                rows = run.integrated_by(integrator).rows(step, INTERVAL)
                z, x = errors(rows, fine[case])
                found.setdefault((case, name_of(integrator)), []).append(z)
                cells.append(f"{z:.3f} / {x:+.2f}" if np.isfinite(z) else "diverges")
            lines.append([case, LABELS[name_of(integrator)], *cells])
    heads = ["run", "integrator", *(f"{milliseconds(step)} ms" for step in STEPS)]
    table("Error by step: RMS of z / final x, in mm", heads, lines)
    return found


def study_precision() -> None:
    lines = []
    for integrator in (Rosenbrock(), HeldPace()):
        for step in (5e-4, 1e-3, 2e-3, 4e-3):
            cells = []
            for run in cases().values():
                run = run.integrated_by(integrator)
                double = run.rows(step, INTERVAL)
                z, x = errors(in_single_precision(run, step), double)
                cells.append(f"{z:.4f} / {x:+.3f}")
            lines.append([LABELS[name_of(integrator)], milliseconds(step), *cells])
    heads = ["integrator", "step, ms", *cases()]
    table(
        "Single against double precision at the same step: RMS of z / final x, in mm", heads, lines
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


def study_gradients() -> dict[str, list[float]]:
    """Print and return the largest relative error of six derivatives, a value a step."""
    exact = gradient(profile(), FINE_GRADIENT_STEP)
    found: dict[str, list[float]] = {}
    lines = []
    for integrator in (Rosenbrock(), HeldPace()):
        for step in GRADIENT_STEPS:
            error = gradient(profile().integrated_by(integrator), step) / exact - 1
            found.setdefault(name_of(integrator), []).append(float(np.max(np.abs(error))))
            cells = [f"{100 * value:+.2f}" for value in error.ravel()]
            lines.append([LABELS[name_of(integrator)], milliseconds(step), *cells])
    outcomes = ("mean z", "final x")
    parameters = ("zeta", "radius", "grouser height")
    heads = [f"{outcome} by {parameter}" for outcome in outcomes for parameter in parameters]
    table(
        "Derivatives over the paper's profile: error in percent of the fine ones",
        ["integrator", "step, ms", *heads],
        lines,
    )
    return found


def study_references() -> None:
    if not REFERENCES.is_dir():
        print("\nNo folder ../shared with the reference runs: that table is left out.")
        return
    lines = []
    for case in ("paper", "soft_30deg", "plain_wheel", "fast_90deg", "fast_300deg"):
        run, z, x = reference(REFERENCES, case)
        cells = []
        for integrator, step in (
            (Rosenbrock(), 5e-4),
            (Rosenbrock(), 2e-3),
            (HeldPace(), 5e-4),
            (HeldPace(), 2e-3),
        ):
            rows = run.integrated_by(integrator).rows(step)
            error = float(np.sqrt(np.mean((np.asarray(rows.z) - z) ** 2)))
            cells.append(f"{1e3 * error:.3f} / {1e3 * float(rows.x[-1] - x[-1]):+.2f}")
        lines.append([case, *cells])
    table(
        "Against the reference runs: RMS of z / final x, in mm",
        ["run", "exact, 0.5 ms", "exact, 2 ms", "held pace, 0.5 ms", "held pace, 2 ms"],
        lines,
    )


def study_falls() -> None:
    """How far a wheel dropped from 50 mm climbs out of the sand again, which no sand can do."""
    lines = []
    for zeta in (0.3, 0.7823, 2.0):
        for integrator in INTEGRATORS:
            simulator = Simulator(terrain=Terrain(ConstantZeta(zeta)), integrator=integrator)
            run = profile(simulator, (0, 1), (0, 0), sinkage=-0.05)
            cells = []
            for step in STEPS:
                z = run.rows(step, 0.004).z
                cells.append(f"{1e3 * float(z[-1] - jnp.min(z)):.2f}")
            lines.append([f"{zeta:g}", LABELS[name_of(integrator)], *cells])
    heads = ["zeta", "integrator", *(f"{milliseconds(step)} ms" for step in STEPS)]
    table("Climb in the 0.8 s after a fall from 50 mm, in mm", heads, lines)


def support_at(sinkage: float, vx: np.ndarray, vz: np.ndarray) -> np.ndarray:
    """Vertical force [N] on the paper's wheel that does not turn, over axle velocities [m/s]."""
    simulator = Simulator().prepared()

    @jax.jit
    @jax.vmap
    def lift(velocity):
        place = jnp.array([0.0, -sinkage])
        nought = jnp.zeros(())
        return simulator.wrench(place, velocity, nought, nought, jnp.asarray(0.7823))[1]

    return np.asarray(lift(jnp.stack([jnp.asarray(vx), jnp.asarray(vz)], axis=1)))


def study_rest() -> None:
    """What the sand can give to a standing wheel that moves up, where a reference rises."""
    weight = 18.837 * 9.81
    up = np.array([REST, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2.3e-3])
    support = support_at(0.0290, np.zeros_like(up), up)
    lines = [
        [f"{1e3 * v:.2f}", f"{f:.1f}", f"{100 * f / weight:.0f}"]
        for v, f in zip(up, support, strict=True)
    ]
    table(
        "Support of a standing wheel, 29.0 mm deep, that moves up",
        ["speed up, mm/s", "support, N", "of the weight, %"],
        lines,
    )


def mark_steps(axis: Axes) -> None:
    axis.set_xlabel("step [ms]")
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_xticks([1e3 * step for step in STEPS], [milliseconds(step) for step in STEPS])
    axis.axvline(1e3 * DEFAULT_STEP, color="k", lw=0.5, ls=":")


def figure(
    folder: Path,
    by_step: dict[tuple[str, str], list[float]],
    by_gradient: dict[str, list[float]],
) -> None:
    panels, axes = plt.subplots(2, 3, figsize=(11, 6.2), layout="constrained")
    milli = 1e3 * np.asarray(STEPS)
    for axis, case in zip(axes[0], cases(), strict=True):
        for integrator in INTEGRATORS:
            name = name_of(integrator)
            axis.loglog(milli, by_step[case, name], "o-", color=COLOURS[name], label=LABELS[name])
        axis.set(title=case, ylabel="RMS error of z [mm]")
        mark_steps(axis)
    axes[0, 0].legend()

    stop, drop, slopes = axes[1]
    run = cases()["300 deg/s"]
    shown = (
        (Rosenbrock(), 1e-4, "exact, 0.1 ms", {"color": "tab:blue", "lw": 2.5, "alpha": 0.5}),
        (Rosenbrock(), DEFAULT_STEP, "exact, 0.5 ms", {"color": "tab:blue", "lw": 1}),
        (HeldPace(), 2e-3, "held pace, 2 ms", {"color": "tab:orange", "lw": 1}),
    )
    for integrator, step, label, style in shown:
        rows = run.integrated_by(integrator).rows(step, INTERVAL)
        stop.plot(rows.time, 1e3 * rows.z, label=label, **style)
    if REFERENCES.is_dir():
        _, z, _ = reference(REFERENCES, "fast_300deg")
        stop.plot(0.01 * np.arange(1, len(z) + 1), 1e3 * z, "k--", lw=1, label="reference")
    stop.set(xlim=(8.5, 10), ylim=(-30, -27.5), title="300 deg/s: the wheel stops at 9 s")
    stop.set(xlabel="time [s]", ylabel="z [mm]")
    stop.legend()

    run = cases()["drop"]
    shown = (
        (
            Rosenbrock(),
            FINE_STEP,
            "exact, 0.05 ms",
            {"color": "tab:blue", "lw": 2.5, "alpha": 0.5},
        ),
        (Rosenbrock(), DEFAULT_STEP, "exact, 0.5 ms", {"color": "tab:blue", "lw": 1}),
        (HeldPace(), 2e-3, "held pace, 2 ms", {"color": "tab:orange", "lw": 1}),
        (Explicit(), DEFAULT_STEP, "explicit, 0.5 ms", {"color": "tab:gray", "lw": 1}),
    )
    for integrator, step, label, style in shown:
        rows = run.integrated_by(integrator).rows(step, 0.004)
        drop.plot(rows.time, 1e3 * rows.z, label=label, **style)
    drop.set(ylim=(-86, -74), title="drop: the wheel lands at 0.2 s")
    drop.set(xlabel="time [s]", ylabel="z [mm]")
    drop.legend()

    for name, values in by_gradient.items():
        milli = 1e3 * np.asarray(GRADIENT_STEPS)
        slopes.loglog(
            milli, 100 * np.asarray(values), "o-", color=COLOURS[name], label=LABELS[name]
        )
    slopes.set(title="derivatives over the paper's profile", ylabel="largest error of six [%]")
    mark_steps(slopes)
    slopes.legend()
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
    study_references()
    study_falls()
    study_rest()
    by_gradient = study_gradients()
    study_precision()
    study_plates()
    if folder is not None:
        figure(folder, by_step, by_gradient)


if __name__ == "__main__":
    main()
