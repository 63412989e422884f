"""The tuners compared on a virtual rig: error of the sinkage, ripple and lag of zeta.

    python -m tests.studies.tuners

prints the tables of `docs/theory/hils-tuners.md`, in a few minutes.
The rig's sand, plates, step and
carriage are its own (`hils.rig_sim.rig`); its scale counts in steps and is noisy; the loop sees a
reading a tick late. Everything is in virtual time, so the tables come out the same each time.
"""

import sys
from typing import NamedTuple

import numpy as np

from drftjax.common.jax_config import configure_jax
from drftjax.effects.serialization import Entry
from drftjax.setups.setup import read_setup
from drftjax.setups.terrain_setup import DynamicTerrain, ZetaKnots
from drftjax.tuning.registry import TunerSetUp
from hils.clock import VirtualClock
from hils.control.limits import CommandLimits
from hils.control.loop_config import LoopSetUp
from hils.control.stop_request import StopRequest
from hils.procedure.operator_prompts import UnattendedPrompts
from hils.procedure.procedure import Procedure, run
from hils.recording.sinks import InMemorySink
from hils.rig_sim.config import PhysicsSetUp, VirtualSetUp
from hils.rig_sim.in_process import soft_rig
from hils.rig_sim.rig import VirtualRig

PROFILE = "data/paper.toml"
PHYSICS = PhysicsSetUp(step=5e-4, plate_size=2e-3)
TICK = 0.01
MOVING, STEADY = (2.0, 22.0), (10.0, 17.0)
FIRM, SOFT = 0.7823, 0.66
# The soft patch lies between these times of the profile, and its edges take so long [s].
PATCH, EDGE = (10.0, 14.0), 0.5
# From the rig's release to the profile's start, less a little that varies [s].
BEFORE = 5.0

TUNERS = {
    "eq. 7, as in the paper": TunerSetUp("step"),
    "eq. 7, half the step": TunerSetUp("step", {"zeta_step": 5e-4}),
    "eq. 7, twice the step": TunerSetUp("step", {"zeta_step": 2e-3}),
    "proportional-integral": TunerSetUp("pi"),
    "Kalman": TunerSetUp("kalman"),
    "Kalman, slow (recovery 5 s)": TunerSetUp("kalman", {"recovery": 5.0}),
}


class Truth:
    """Looks at the rig as a clock moves it: time [s], height [m] and the sand's zeta [-]."""

    def __init__(self, rig: VirtualRig, clock: VirtualClock):
        self._rig = rig
        self.rows: list[tuple[float, float, float]] = []
        clock.attach(self)

    def advance(self, now: float) -> None:
        motion = self._rig.motion
        self.rows.append((now, motion.z, motion.zeta))


class Run(NamedTuple):
    """A run on the loop's ticks: time [s], simulated minus true height [m], both zetas [-]."""

    time: np.ndarray
    apart: np.ndarray
    zeta: np.ndarray
    truth: np.ndarray


def sands() -> dict[str, VirtualSetUp]:
    """The rigs: as the loop believes, loosening as the wheel turns, and with a soft patch."""
    loose: list[Entry] = [{"name": "loosening", "loss": 0.15, "decay": 2.0}]
    edges = [PATCH[0], PATCH[0] + EDGE, PATCH[1], PATCH[1] + EDGE]
    patch = ZetaKnots([BEFORE + edge for edge in edges], [FIRM, SOFT, SOFT, FIRM])
    return {
        "as believed": VirtualSetUp(physics=PHYSICS),
        "loosening": VirtualSetUp(physics=PHYSICS, effects=loose),
        "soft patch": VirtualSetUp(physics=PHYSICS, terrain=DynamicTerrain(zeta=patch)),
    }


def one(sand: VirtualSetUp, tuner: TunerSetUp, tick: float, seed: int) -> Run:
    """The paper's profile on this sand."""
    soft = soft_rig(sand, seed=seed)
    truth = Truth(soft.rig, soft.clock)
    loop = LoopSetUp(
        setup=read_setup(PROFILE), commands=CommandLimits(2.0, 0.3), tuner=tuner, tick=tick
    )
    rows = InMemorySink()
    report = run(
        Procedure(loop=loop), soft.link, soft.clock, rows, UnattendedPrompts(True), StopRequest()
    )
    assert report.completed, report.reason
    online = rows.run().online
    assert online is not None
    when, z, zeta = np.array(truth.rows).T
    start = _start(rows, soft.clock)
    time = online.time
    apart = online.z_sim - np.interp(time + start, when, z)
    return Run(time, apart, online.zeta, np.interp(time + start, when, zeta))


def _start(rows: InMemorySink, clock: VirtualClock) -> float:
    """The profile's start on the clock [s]: the session's end is the newest event."""
    return clock.now() - rows.events[-1][0]


def within(run: Run, span: tuple[float, float]) -> np.ndarray:
    return (run.time >= span[0]) & (run.time < span[1])


def rmse(run: Run) -> float:
    """Simulated minus true height while the wheel turns [m]."""
    return float(np.sqrt((run.apart[within(run, MOVING)] ** 2).mean()))


def ripple(run: Run) -> float:
    """Standard deviation of zeta about its straight line while the wheel turns evenly [-]."""
    time, zeta = run.time[within(run, STEADY)], run.zeta[within(run, STEADY)]
    return float((zeta - np.polyval(np.polyfit(time, zeta, 1), time)).std())


def off(run: Run) -> float:
    """Root mean square difference of zeta from the sand's while the wheel turns evenly [-]."""
    chosen = within(run, STEADY)
    return float(np.sqrt(((run.zeta - run.truth)[chosen] ** 2).mean()))


def lag(run: Run) -> float:
    """How much later than the sand's the tuned zeta falls past the middle of the patch's edge."""
    middle = (FIRM + SOFT) / 2
    chosen = (run.time > PATCH[0] - 1) & (run.time < PATCH[1])
    time = run.time[chosen]
    return float(
        time[np.argmax(run.zeta[chosen] < middle)] - time[np.argmax(run.truth[chosen] < middle)]
    )


def main() -> None:
    configure_jax()
    seeds = range(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
    rigs = sands()
    print(f"{len(seeds)} runs each, tick {TICK * 1e3:g} ms\n")
    print(
        "| tuner | RMSE of z, as believed [mm] | loosening | soft patch | most, soft patch "
        "| ripple of zeta | zeta from the sand's, loosening | lag [s] |"
    )
    print("|---|--:|--:|--:|--:|--:|--:|--:|")
    for name, tuner in TUNERS.items():
        made = {sand: [one(rig, tuner, TICK, seed) for seed in seeds] for sand, rig in rigs.items()}
        figures = [
            *(f"{np.mean([rmse(r) for r in runs]) * 1e3:.3f}" for runs in made.values()),
            f"{np.mean([np.abs(r.apart).max() for r in made['soft patch']]) * 1e3:.3f}",
            f"{np.mean([ripple(r) for r in made['as believed']]):.4f}",
            f"{np.mean([off(r) for r in made['loosening']]):.4f}",
            f"{np.mean([lag(r) for r in made['soft patch']]):.2f}",
        ]
        print(f"| {name} | {' | '.join(figures)} |", flush=True)
    tick_table(rigs["loosening"])


def tick_table(rig: VirtualSetUp) -> None:
    """Eq. 7 has no time in it: what another tick does to the same step, and to the same rate."""
    print("\n| tick [ms] | step of zeta | RMSE of z, loosening [mm] | zeta from the sand's |")
    print("|--:|--:|--:|--:|")
    for tick in (0.002, 0.005, 0.01, 0.02, 0.05):
        for step in dict.fromkeys((1e-3, 0.1 * tick)):
            made = one(rig, TunerSetUp("step", {"zeta_step": step}), tick, 0)
            print(
                f"| {tick * 1e3:g} | {step:g} | {rmse(made) * 1e3:.3f} | {off(made):.4f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
