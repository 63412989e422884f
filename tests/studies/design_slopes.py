"""Slopes that a search for a better run could follow: exact ones, and differences over a width.

    python -m tests.studies.design_slopes

Prints the table of `docs/guide/design.md`: how the logarithm of lambda's standard error changes
with the
free numbers of trapezoids, on plates of 8 mm, with corners as the model has them and rounded.
"""

import math
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from drftjax.common.jax_config import configure_jax

PAPER = Path(__file__).resolve().parents[2] / "data" / "paper.toml"
PEAKS = (60.0, 150.0)  # [deg/s]
WIDTHS = (1e-3, 1e-1)
KNOTS = (1, 3, 4)  # counted from 0; the start angle is the last coordinate


def slopes(objective, at):
    """Exact gradient, and central differences over each width, by their names."""
    import equinox as eqx

    from drftjax.simulation.ensemble import map_runs
    from identify.design.fisher_information import value_and_gradient

    @eqx.filter_jit
    def differences(objective, at, width):
        steps = width * jnp.eye(len(at))
        points = jnp.concatenate([at + steps, at - steps])
        ahead, behind = jnp.split(map_runs(lambda c, o: o(c), points, objective), 2)
        return (ahead - behind) / (2 * width)

    found = {"exact": np.asarray(eqx.filter_jit(value_and_gradient)(objective, at)[1])}
    for width in WIDTHS:
        found[f"over {width:g}"] = np.asarray(differences(objective, at, width))
    return found


def main() -> None:
    configure_jax()
    import equinox as eqx

    from drftjax.physics.stress import Sharp
    from drftjax.setups.setup import read_setup
    from identify.design.design import search_objective, trapezoid
    from identify.design.limits import Limits

    limits = Limits()
    setup = read_setup(PAPER)
    rounded = search_objective(setup, "lambda", limits=limits)
    sharp = eqx.tree_at(lambda o: o.trial.simulator.terrain.law.corners, rounded, Sharp())
    names = [*(f"knot {knot + 1}" for knot in KNOTS), "start angle"]
    print(f"| to, deg/s | corners | slope | {' | '.join(names)} |")
    print("|---|---|---|" + "---|" * len(names))
    for peak in PEAKS:
        shape = trapezoid(limits, setup.wheel.radius, math.radians(peak))
        omega = np.interp(rounded.profile.time, shape.time, shape.omega)[2:-2]
        at = jnp.asarray(np.r_[rounded.profile.coordinates(omega), 0.0])
        for corners, objective in (("sharp", sharp), ("rounded", rounded)):
            for slope, values in slopes(objective, at).items():
                told = " | ".join(f"{values[place]:.2g}" for place in (*KNOTS, -1))
                print(f"| {peak:.0f} | {corners} | {slope} | {told} |", flush=True)


if __name__ == "__main__":
    main()
