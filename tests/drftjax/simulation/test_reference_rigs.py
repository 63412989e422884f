"""The implicit step against twenty rigs and a table of derivatives by another implementation.

`../shared/reference_rigs` holds wheels of 30 to 500 mm, masses of 0.3 to 300 kg, sand from soft to
stiff, the Moon, a fall, a reversal, a crawl, a minute of standing, driven and locked carriages.
"""

import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.physics.rig import DrivenCarriage
from drftjax.runlog.hdf5.api import read_run
from drftjax.runlog.record import RunLog
from drftjax.setups.chosen_step import choose_setup_step
from drftjax.setups.from_run import setup_from_run
from drftjax.setups.setup import SetUp
from drftjax.simulation.trial import Trial, pad_to_shared_size
from drftjax.tuning.replay import replay_trial
from drftjax.tuning.step_tuner import StepTuner
from tests.helpers.shared_program import whole_run

# What a user may rely on: a tenth of a millimetre of sinkage, of wheels over 150 mm 0.3 % of the
# radius; two millimetres of travel.
SINKAGE_RMSE, OF_RADIUS, FINAL_PLACE = 1e-4, 3e-3, 2e-3
# No sand lifts a wheel that has stopped: a twentieth of a millimetre is what roundings may do.
CLIMB = 5e-5
# What eq. 7 may change zeta by in a minute beside a wheel that stands.
TUNED_STANDING = 0.005
# The table's slopes are of secants over 1 %, and average the corners that a plate passes there.
RELATIVE, OF_LARGEST = 0.05, 0.02
# Of the travel of a wheel that comes back [mm]: 3 % of the slope of one way, 22 mm.
REVERSED = 0.5

NAMES = (
    "crawl", "damped", "driven_locked", "driven_slip30", "drop_20mm", "fast_300deg", "fast_90deg",
    "heavy_200kg", "large_wheel", "light_30deg", "moon", "paper", "paper_quasistatic",
    "plain_wheel", "reversal", "rover_2kg", "small_wheel", "soft_30deg", "standing_60s",
    "stiff_sand",
)  # fmt: skip


@pytest.fixture(scope="session")
def rigs(shared: Path) -> Path:
    folder = shared / "reference_rigs"
    if not folder.is_dir():
        pytest.skip("the folder ../shared has no reference_rigs")
    return folder


def recorded(rigs: Path, name: str) -> tuple[SetUp, RunLog]:
    log = read_run(rigs / f"{name}.h5")
    setup = setup_from_run(log)
    if name == "damped":
        setup.rig.damping_x, setup.rig.damping_z = 30.0, 300.0
    if name == "drop_20mm":
        setup.start.sinkage = -0.02
    if name == "paper_quasistatic":
        setup.terrain.inertial_coefficient = setup.terrain.height_decrease = 0.0
    return setup, log


def trial_of(setup: SetUp) -> Trial:
    """At the step that is chosen by default."""
    assert choose_setup_step(setup) is not None
    return setup.trial()


@pytest.mark.parametrize("name", NAMES)
def test_the_run_is_that_of_the_other_implementation(rigs, name):
    setup, log = recorded(rigs, name)
    output = whole_run(trial_of(setup))
    time = log.measured.time
    z = np.interp(time, output.time, output.z)
    error, last = z - log.measured.z, np.interp(time[-1], output.time, output.x)
    allowed = SINKAGE_RMSE if setup.wheel.radius <= 0.15 else OF_RADIUS * setup.wheel.radius
    assert np.sqrt(np.mean(error**2)) < allowed
    assert abs(last - log.measured.x[-1]) < FINAL_PLACE
    after = np.asarray(output.z)[np.flatnonzero(np.abs(output.omega) > 0)[-1:].max(initial=0) + 1 :]
    assert after.max() - after[0] < CLIMB
    if name == "standing_60s":
        assert abs(float(output.z[-1]) + 0.0176) < SINKAGE_RMSE


def test_eq_7_beside_a_rig_that_stands_leaves_zeta_alone(rigs):
    trial = trial_of(recorded(rigs, "standing_60s")[0])
    tuner = StepTuner(tick=0.01, zeta_step=0.001, tolerance=1e-4)
    sinkage = jnp.full(6000, 0.0176)
    replay = eqx.filter_jit(replay_trial)
    ticks = replay(trial, jnp.asarray(0.7823), sinkage, tuner, 1)
    assert float(jnp.abs(ticks.zeta - 0.7823).max()) <= TUNED_STANDING


# Cases of the table of derivatives.
TABLE = (
    "rover_2kg", "stiff_sand", "moon", "large_wheel", "heavy_200kg", "small_wheel", "drop_20mm",
    "driven_slip30", "reversal",
)  # fmt: skip

LEAVES = {
    "zeta": lambda trial: trial.simulator.terrain.zeta.value,
    "radius": lambda trial: trial.simulator.wheel.radius,
    "grouser_height": lambda trial: trial.simulator.wheel.grouser_height,
}


@eqx.filter_jit
def slopes(trial: Trial, rows, table: tuple[str, ...]):
    """Derivatives of the mean of z and of fx, or of the way, by logarithms, shape (2, table)."""

    def outcome(logarithms):
        changed = trial
        for leaf, by in zip(map(LEAVES.get, table), logarithms, strict=True):
            changed = eqx.tree_at(leaf, changed, leaf(changed) * jnp.exp(by))
        x, z, fx = changed.run_to(rows, ("x", "z", "fx"))
        number = jnp.arange(len(z))
        second_half = (number >= (rows + 1) // 2) & (number <= rows)
        driven = isinstance(trial.simulator.rig.carriage, DrivenCarriage)
        second = jnp.mean(fx, where=second_half) if driven else 1e3 * x[rows]
        return jnp.stack([1e3 * jnp.mean(z, where=second_half), second])

    return jax.jacfwd(outcome)(jnp.zeros(len(table)))


@pytest.mark.parametrize("name", TABLE)
def test_derivatives_are_those_of_the_other_implementation(rigs, name):
    table = json.loads((rigs / "derivatives.json").read_text())[name]
    setup, _ = recorded(rigs, name)
    choice = choose_setup_step(setup)
    assert choice is not None
    # After a fall z still changes with the step, and the choice says so.
    assert choice.within == (name != "drop_20mm")
    trial = setup.trial()

    found = slopes(pad_to_shared_size(trial), jnp.asarray(trial.rows), tuple(table))
    expected = np.array(list(table.values())).T
    largest = np.abs(expected).max(axis=1, keepdims=True)
    allowed = np.maximum(RELATIVE * np.abs(expected), OF_LARGEST * largest)
    # The way back cancels the way there: what is left is a small difference of both.
    allowed[1] += REVERSED if name == "reversal" else 0
    assert np.all(np.abs(found - expected) < allowed)
