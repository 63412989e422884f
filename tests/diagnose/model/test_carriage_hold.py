"""What holds a free carriage, by its force and its motion."""

from dataclasses import replace

import numpy as np
import pytest

from diagnose.api import diagnose
from diagnose.dataset import DEFAULT_DATASET, DatasetSettings, RigDataset, step_errors
from diagnose.gap.noise_floor import noise_floors
from diagnose.model.augmented_model import AugmentedModel
from diagnose.model.carriage_hold import HALF_WINDOW, LET_GO
from drftjax.effects.rig import CableSpring, Drawbar, HorizontalCoulomb, VerticalLoad
from drftjax.effects.terrain import SlipSoftening
from tests.helpers.rig_datasets import WITH_REST
from tests.helpers.synthetic_runs import coarse, recorded, setup_of

PROFILE = ([0.0, 0.5, 1.5, 4.0], [0.0, 0.0, 0.6, 0.6])
CHANNELS = ("x", "z", "fx", "fz")
PULL = 6.0
LOAD_CELL = 0.5  # white noise of one reading [N]
# Of 50 readings a second some 20 are averaged, and second differences of x and z, read to 20 um,
# add 0.2 N at 14 and 19 kg; three of these.
AVERAGED = 0.7
# Grousers change the force within a row of 4 ms: 4 mN of it are left, and 12 mN where the last
# step's force stands for all.
OF_STEPS = 0.008
# A hundred runs with a dozen averages each tell a scatter to a few hundredths; the noise of 200
# readings is told to a tenth, and the wheel's own force adds to it.
DRAWS, READINGS = 0.06, 0.3


def rig(
    *effects: dict,
    vx: list[float] | None = None,
    channels=CHANNELS,
    settings: DatasetSettings = DEFAULT_DATASET,
) -> RigDataset:
    setup = setup_of(PROFILE, vx=vx)
    setup.effects = list(effects)
    run = recorded(setup, channels=channels, force_noise=LOAD_CELL)
    return RigDataset.of([coarse("run", run, carriage_forces=True)], settings)


def test_a_load_cell_tells_the_pull_at_the_carriage_and_the_weight():
    found = rig({"name": "drawbar", "force": PULL})
    weight = found.runs[0].setup.rig.build().mass_z * 9.81
    _, _, pull, borne = found.recording(0)
    moving = found.time(0) > HALF_WINDOW
    assert pull[moving].mean() == pytest.approx(PULL, abs=AVERAGED)
    assert np.abs(pull[moving] - PULL).max() < 3 * AVERAGED
    assert borne[moving].mean() == pytest.approx(float(weight), abs=AVERAGED)


@pytest.mark.parametrize(
    ("effect", "size", "pull", "load"),
    [
        (Drawbar, 7.0, 7.0, 0.0),
        (VerticalLoad, 7.0, 0.0, 7.0),
        (SlipSoftening, 0.3, 0.0, 0.0),
    ],
)
def test_a_simulation_tells_the_load_itself_on_any_sand(effect, size, pull, load):
    found, model = rig(), AugmentedModel((effect,))
    at = model.null()
    at[0] = model.free[0].coordinate(size)
    plain = found.prediction(AugmentedModel(), 0, 0.0, np.zeros(0))
    # In harder sand, as in softer the wheel falls at first.
    changed = found.prediction(model, 0, 0.3, at)
    # To what Newton's steps leave of a balance of 200 N.
    for place, expected in ((2, pull), (3, load)):
        change = np.abs(changed[place] - plain[place]).max()
        assert change == pytest.approx(expected, abs=0.02)


def test_a_row_of_several_steps_tells_the_same_load(pool):
    """The force of its last step is later than the mean that changed the speed."""
    found, model = rig(), AugmentedModel((Drawbar,))
    at = model.null()
    at[0] = model.free[0].coordinate(PULL)
    (errors,) = step_errors(found, model, np.zeros(1), at, pool)
    compared = found.holds[0].of_simulation(errors[:, found.counts(0)])
    after = found.time(0) > LET_GO
    assert np.sqrt(np.mean(compared[CHANNELS.index("fx"), after] ** 2)) < OF_STEPS


def test_the_floor_of_a_load_cell_is_what_an_average_leaves_of_its_noise():
    found, random = rig(), np.random.default_rng(2)
    hold, still = found.holds[0], np.zeros((len(CHANNELS), len(found.time(0)), 100))
    still[2] = random.normal(0.0, LOAD_CELL, still.shape[1:])
    averaged = float(np.std(hold.of_readings(still)[2]))
    assert hold.noise("fx", LOAD_CELL) == pytest.approx(averaged, rel=DRAWS)
    residual = [found.prediction(AugmentedModel(), 0, 0.0, np.zeros(0)) - found.recording(0)]
    own = dict.fromkeys(CHANNELS, 0.0)
    floors, _ = noise_floors(found, residual, residual, own, lambda run: np.zeros(0))
    assert floors["fx"] == pytest.approx(averaged, rel=READINGS)


def test_friction_acts_while_the_carriage_moves_and_a_spring_by_its_way():
    found = rig(settings=WITH_REST)
    moving = found.time(0) > 2.0
    friction, spring = AugmentedModel((HorizontalCoulomb,)), AugmentedModel((CableSpring,))
    newtons, stiffness = (float(each.free[0].value(1.0)) for each in (friction, spring))
    held = found.prediction(friction, 0, 0.0, np.array([1.0]))[2]
    assert held[moving] == pytest.approx(newtons, rel=0.01)
    assert abs(held[0]) < 0.1 * newtons
    x, _, pull, _ = found.prediction(spring, 0, 0.0, np.array([1.0]))
    # The way is nearly straight within an average, and near its end a run has no whole one.
    whole = moving & (found.time(0) < found.time(0)[-1] - 1.5 * HALF_WINDOW)
    assert pull[whole] == pytest.approx(stiffness * x[whole], rel=0.02)


def test_forces_on_a_driven_carriage_stay_as_they_are_read():
    driven = rig(vx=[0.0, 0.0, 0.06, 0.06], channels=("z", "fx", "fz"))
    assert driven.holds[0].masses == {}
    counts = driven.counts(0)
    assert driven.recording(0) == pytest.approx(driven.runs[0].observation.values[:, counts])


def test_a_run_shorter_than_two_averages_tells_no_force():
    setup = setup_of(([0.0, 0.1, 0.3, 0.5], [0.0, 0.0, 0.5, 0.5]))
    run = coarse("short", recorded(setup, channels=CHANNELS), carriage_forces=True)
    x, z, fx, fz = RigDataset.of([run]).recording(0)
    assert np.isfinite([x, z]).all()
    assert np.isnan([fx, fz]).all()


def test_irregular_readings_tell_the_same():
    even = rig({"name": "drawbar", "force": PULL})
    (run,) = even.runs
    time = run.observation.time
    kept = np.sort(np.random.default_rng(3).permutation(len(time))[: int(0.8 * len(time))])
    seen = run.observation
    fewer = replace(seen, time=time[kept], values=seen.values[:, kept], counts=seen.counts[kept])
    pull = RigDataset.of([replace(run, observation=fewer)]).recording(0)[2]
    assert np.nanmean(pull) == pytest.approx(PULL, abs=AVERAGED)


def test_a_pull_is_named_by_its_size_though_the_sand_follows_another_law():
    runs = {}
    for number, speed in enumerate((0.4, 0.4, 0.8)):
        setup = setup_of(([0.0, 0.5, 1.5, 3.5], [0.0, 0.0, speed, speed]))
        setup.effects = [{"name": "depth_power", "excess": 0.3}, {"name": "drawbar", "force": PULL}]
        runs[f"run_{number}"] = recorded(setup, number, channels=CHANNELS, force_noise=LOAD_CELL)
    found = diagnose(runs, ["drawbar", "slip_softening", "depth_hardening", "surface_slope"])
    assert "drawbar" in found.verdict
    assert found.parameters["drawbar"]["force"].value == pytest.approx(PULL, abs=AVERAGED)
