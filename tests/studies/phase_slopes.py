"""Derivatives by what shifts the wheel's phase, beside differences over wide changes.

The force on a plate jumps where the plate begins to lead, and as it passes a corner. What moves
when that happens (a drive's error, a surface's slope) acts through the jumps too, of which a
derivative along the way between them knows nothing.

    python -m tests.studies.phase_slopes
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from drftjax.common.jax_config import configure_jax
from drftjax.effects.drive import SpeedGain
from drftjax.effects.rig import Drawbar
from drftjax.effects.surface import SurfaceSlope
from drftjax.setups.setup import read_setup

STEPS = (2e-3, 5e-4)
# Strengths, and the change that the wide difference spans to either side.
WIDE = {"speed_gain": 0.01, "surface_slope": 0.003, "drawbar": 1.0}
MM = 1e3
# Steady part of the paper's run [s].
STEADY = (10.0, 17.0)


def readings(strengths, step: float):
    """Travel at the end, and mean height while the wheel goes steadily, of the paper's run [mm]."""
    setup = read_setup("data/paper.toml")
    setup.integrator.step = step
    trial = setup.trial()
    gain, slope, force = strengths
    effects = (SpeedGain(gain=gain), SurfaceSlope(slope=slope), Drawbar(force=force))
    simulator = dataclasses.replace(trial.simulator, effects=effects)
    output = dataclasses.replace(trial, simulator=simulator).run()
    first, last = (round(t / (step * trial.every)) for t in STEADY)
    return MM * jnp.stack([output.x[-1], output.z[first:last].mean()])


def main() -> None:
    """Print the table of docs/theory/integrator.md."""
    configure_jax()
    print("| strength | step, ms | x, derivative | x, difference | z, derivative | z, difference |")
    print("|---|---|---|---|---|---|")
    for step in STEPS:
        null = jnp.zeros(len(WIDE))
        at = jax.jit(lambda strengths, step=step: readings(strengths, step))
        slopes = np.asarray(jax.jit(jax.jacfwd(at))(null))
        for number, (name, wide) in enumerate(WIDE.items()):
            moved = null.at[number].set(wide)
            over = np.asarray(at(moved) - at(-moved)) / (2 * wide)
            cells = [f"{v:.4g}" for pair in zip(slopes[:, number], over, strict=True) for v in pair]
            print(f"| {name} | {1e3 * step:g} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
