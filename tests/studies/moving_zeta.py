"""zeta(t) where something that the model leaves out moves it a lot: offline, and by the tuner.

    python -m tests.studies.moving_zeta

Prints the table of `docs/guide/crosscheck.md`: the paper's profile on sand of 0.75
with one mechanism,
read at 50 Hz with 20 um of noise, and fitted with a reference model that has none. Some minutes.
"""

import numpy as np

from drftjax.common.jax_config import configure_jax
from tests.studies.crosscheck import known_run, known_setup

SEED = 3
ZETA = 0.75
TIME, OMEGA = (0.0, 2.0, 7.0, 17.0, 22.0, 24.0), (0.0, 0.0, 30.0, 30.0, 0.0, 0.0)
MECHANISMS = {
    "level": [],
    "rising bed": [{"name": "surface_slope", "slope": 0.012}],
    "falling bed": [{"name": "surface_slope", "slope": -0.012}],
    "loosening": [{"name": "loosening", "loss": 0.15, "decay": 2.0}],
    "soft patch": [{"name": "terrain_variation", "excess": -0.2, "centre": 0.5, "width": 0.15}],
}
SPACINGS = (1.0, 0.5, 0.25)


def main() -> None:
    configure_jax()
    from drftjax.recorded.prepared_run import prepare_run
    from identify.crosscheck.crosscheck import crosscheck
    from identify.crosscheck.replays import TunerSetting

    random = np.random.default_rng(SEED)
    runs = []
    for name, effects in MECHANISMS.items():
        setup = known_setup(name, lambda t: ZETA + 0 * t, np.array([0.0, TIME[-1]]), TIME, OMEGA)
        setup.effects = effects
        runs.append(prepare_run(name, known_run(setup, random)))
    print("| run | knots, s | steps | ζ(t) | z offline, mm | x offline, mm | z tuner, mm |")
    print("|---|---|---|---|---|---|---|")
    for spacing in SPACINGS:
        picked = [r for r in runs if spacing == 1.0 or r.name == "rising bed"]
        found = crosscheck(
            picked, TunerSetting(0.01, 1e-3, 1e-4), knot_spacing=spacing, sweep=False
        )
        for run in found.runs:
            path, inside = run.offline, run.offline.value[run.offline.identified]
            steps = f"{path.steps}" if path.converged else f"{path.steps}, not settled"
            mm = [1e3 * each for each in (path.rmse["z"], path.rmse["x"], run.rmse["tuner"]["z"])]
            print(
                f"| {run.name} | {spacing:g} | {steps} | {inside[0]:.3f} to {inside[-1]:.3f} "
                f"| {mm[0]:.3f} | {mm[1]:.3f} | {mm[2]:.3f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
