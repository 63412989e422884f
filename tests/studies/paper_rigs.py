"""What eq. 7 mends and what it does not: the paper's experiment on rigs that differ in one thing.

    python -m tests.studies.paper_rigs

Prints a table of `docs/results/hils-paper.md`. Beds are alike and there is one run of each kind, so
that
what is left comes from the rig. Two minutes.
"""

import copy
from typing import Any

from drftjax.common.jax_config import configure_jax
from hils.rig_sim.config import VirtualSetUp

RIGS: dict[str, dict[str, Any]] = {
    "nothing but loosening": {},
    "drawbar load of 10 N": {"rig": {"drawbar_load": 10.0}},
    "bulldozing, 10 N in the end": {"effect": {"name": "bulldozing", "force": 10.0}},
    "zeta lower by 20 % at fast slip": {"effect": {"name": "slip_softening", "loss": 0.2}},
    "soft patch, 10 % at 0.5 m": {"effect": {"name": "terrain_variation", "excess": -0.1}},
    "grousers of 0.8 of the height": {"wheel": {"grouser_fraction": 0.8}},
    "grousers of 1/3 of the height": {"wheel": {"grouser_fraction": 1 / 3}},
    "rim larger by 2 mm": {"wheel": {"radius": 0.152}},
}
MM = 1e3


def rig_of(differs: dict[str, Any]) -> VirtualSetUp:
    """The loosening rig, its beds alike, that differs so."""
    from hils.experiment.experiment import loosening_rig

    rig = copy.deepcopy(loosening_rig(scatter=0.0))
    for part in ("rig", "wheel"):
        for name, value in differs.get(part, {}).items():
            setattr(getattr(rig, part), name, value)
    if "effect" in differs:
        rig.effects = [*rig.effects, differs["effect"]]
    return rig


def main() -> None:
    configure_jax()
    from hils.realtime import answer_at_once

    answer_at_once()
    from drftjax.common.packages import data_file
    from drftjax.setups.setup import read_setup
    from hils.control.limits import CommandLimits
    from hils.control.loop_config import LoopSetUp
    from hils.experiment.experiment import Experiment, run_experiment
    from hils.experiment.report import markdown_table

    loop = LoopSetUp(setup=read_setup(data_file("paper.toml")), commands=CommandLimits(2.0, 0.3))
    rows = []
    for name, differs in RIGS.items():
        result = run_experiment(Experiment(loop=loop, rig=rig_of(differs), runs=1))
        apart, first = result.distances(), result.hils[0]
        rows.append(
            (
                name,
                f"{first.start.zeta:.3f}",
                f"{MM * first.rmse:.3f}",
                *(
                    f"{MM * getattr(apart[path], kind):.2f}"
                    for kind in ("plane", "z", "x")
                    for path in ("HILS (sim)", "DRFT")
                ),
            )
        )
        print(f"{name}: RMSE of z {MM * first.rmse:.3f} mm", flush=True)
    head = ["the rig differs by", "ζ(0)", "RMSE of z, mm"]
    head += [f"{path}, {kind}" for kind in ("plane", "z", "x") for path in ("HILS-DRFT", "DRFT")]
    print(f"\n{markdown_table(head, rows)}")


if __name__ == "__main__":
    main()
