"""The history of DRFT as a question: what does quasi-static theory lack, and from what speed on?

Runs of the dynamic theory (Agarwal et al. 2021; Fuke et al. 2024) are diagnosed against the
quasi-static theory of Li et al. 2013: lambda and the height decrease set to zero. At several
hundred degrees a second the two dynamic terms must be named; at the paper's 30 deg/s they must not.

    python -m tests.studies.history
"""

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np

from diagnose.api import effects_among, possible_effects
from diagnose.dataset import RigDataset
from diagnose.gap.cross_validation import at_mean_sinkage, predict_held_out
from diagnose.gap.zeta_matching import residuals_of
from diagnose.pipeline import diagnose
from diagnose.result import Diagnosis
from diagnose.run_pool import RunPool
from diagnose.settings import DEFAULT_SETTINGS, DiagnosisSettings
from drftjax.effects.base import AbstractEffect
from drftjax.recorded.prepared_run import prepare_run
from drftjax.runlog.record import Measured, RunLog
from drftjax.setups.setup import CommandSetUp, SetUp
from drftjax.setups.simulated_run import simulated_run

# Top speeds [deg/s] of the runs; two of each half a dataset share a command.
FAST = (60.0, 120.0, 120.0, 200.0, 300.0)
SLOW = (15.0, 22.0, 22.0, 30.0, 30.0)
TERMS = ("height_decrease", "momentum_flux")
NOISE = {"x": 50e-6, "z": 20e-6}
ZETA, SCATTER = 0.78, 0.01
# Time [s] standing, speeding up and running.
STANDS, SPEEDS_UP, RUNS = 1.0, 3.0, 5.0


def dynamic_runs(
    tops: Sequence[float], seed: int = 0, lasting: float = RUNS
) -> list[tuple[SetUp, RunLog]]:
    """Runs of the dynamic theory to these speeds [deg/s], with noise and scatter of zeta.

    Args:
        tops: Speed that each run reaches [deg/s].
        seed: Of noise and scatter.
        lasting: Time at that speed [s].
    """
    random = np.random.default_rng(seed)
    found = []
    for top in tops:
        time = [0.0, STANDS, STANDS + SPEEDS_UP, STANDS + SPEEDS_UP + lasting]
        omega = [0.0, 0.0, float(np.deg2rad(top)), float(np.deg2rad(top))]
        setup = SetUp(command=CommandSetUp(time, omega), title=f"{top:g} deg/s")
        setup.terrain.zeta = ZETA * float(np.exp(SCATTER * random.standard_normal()))
        run = simulated_run(setup)
        measured = {
            name: getattr(run.measured, name)
            + noise * random.standard_normal(len(run.measured.time))
            for name, noise in NOISE.items()
        }
        log = dataclasses.replace(run, measured=Measured(time=run.measured.time, **measured))
        found.append((setup, log))
    return found


def against_quasi_static(
    tops: Sequence[float],
    effects: Sequence[type[AbstractEffect]],
    lasting: float = RUNS,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
) -> Diagnosis:
    """The diagnosis of such runs, had nobody thought of the dynamic terms."""
    candidates = []
    for number, (setup, run) in enumerate(dynamic_runs(tops, lasting=lasting)):
        believed = copy.deepcopy(setup)
        believed.terrain.inertial_coefficient = 0.0
        believed.terrain.height_decrease = 0.0
        candidates.append(prepare_run(f"run {number}", run, model=believed))
    considered = possible_effects(candidates, effects)
    return diagnose(RigDataset.of(candidates), considered, settings=settings)


def unseen_floors(found: Diagnosis, names: Sequence[str], channel: str = "x") -> float:
    """What an explanation leaves of a channel on runs left out, in noise floors; NaN untried."""
    for each in (*found.screening.singles, *found.screening.pairs):
        if set(each.names) == set(names):
            regressors = found.screening.regressors
            with RunPool() as pool:
                held_out = predict_held_out(regressors, each, pool)
                unseen = residuals_of(at_mean_sinkage(held_out, pool))
            index = found.dataset.channels.index(channel)
            square = np.mean(np.concatenate([run[index] for run in unseen]) ** 2)
            return float(np.sqrt(square)) / found.floors[channel]
    return float("nan")


def main() -> None:
    """Print both diagnoses."""
    from drftjax.common.jax_config import configure_jax

    configure_jax()
    for name, tops in (("fast", FAST), ("slow", SLOW)):
        say(name, tops, against_quasi_static(tops, effects_among(None)))


def say(name: str, tops: Sequence[float], found: Diagnosis) -> None:
    """Print a diagnosis."""
    weights = {name: round(w, 3) for name, w in list(found.weights.items())[:4]}
    print(f"{name} runs, {tops} deg/s: verdict {', '.join(found.verdict)}; weights {weights}")
    for effect, fields in found.parameters.items():
        for field, n in fields.items():
            print(f"  {effect}.{field} = {n.value:.4g} ± {n.error:.2g} {n.unit}")
    for channel, gap in found.gap.items():
        print(
            f"  {channel}: {gap.before * 1e3:.3f} -> {gap.after * 1e3:.3f} mm on runs left "
            f"out, floor {gap.floor * 1e3:.3f} mm"
        )
    for names in (TERMS[:1], TERMS[1:], TERMS):
        floors = unseen_floors(found, names)
        print(f"  {' + '.join(names)} leaves x at {floors:.1f} floors on runs left out")


if __name__ == "__main__":
    main()
