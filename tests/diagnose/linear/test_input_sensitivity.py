"""Columns of effects along linearised runs, against the change of whole simulated runs."""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

from diagnose.dataset import RigDataset, with_zeta
from diagnose.linear.input_sensitivity import READINGS, effect_sensitivity, propagate
from diagnose.linear.linearized_runs import linearize_run
from diagnose.model.augmented_model import AugmentedModel
from drftjax.effects.catalogue import effect_class, field_metadata, shapes
from drftjax.recorded.prepared_run import PreparedRun
from tests.helpers.synthetic_runs import BELIEVED_ZETA, coarse, recorded, setup_of

# A step is differentiated once a node only, and plates cross corners in between: share of a
# column's largest value.
LINES_ERR = 0.25
# A force ripples as plates come and go: of what a leaning bed changes in it by half of the mean,
# of which so many samples leave a tenth. What two forms differ by ripples less.
RIPPLE, LEAN = 0.1, 0.03
# Share of the typical strength that a whole run is changed by: longer ones pass corners.
CHANGE = 1e-3
# The start is over, in which a wheel that stands begins to move [s].
MOVING = 0.5
ZETA = 0.75
LOG_ZETA = float(np.log(ZETA / BELIEVED_ZETA))


# Effects, and the channels of a free carriage that they show in.
SHOWN = {
    "surface_slope": ("x", "z"),
    "surface_incline": ("x", "z"),
    "surface_profile": ("x", "z"),
    "surface_undulation": ("x", "z"),
    "height_decrease": ("x", "z"),
    "height_decrease_arc": ("x", "z"),
    "travel_delay": ("x",),
    "sinkage_delay": ("z",),
}


def of_one_program(run: PreparedRun, *names: str) -> RigDataset:
    """The run, of which one program simulates each of these effects."""
    shared = AugmentedModel(tuple(map(effect_class, names)))
    return replace(RigDataset.of([run]), shared=shared)


@cache
def free() -> RigDataset:
    setup = setup_of(([0.0, 0.25, 1.25, 3.5, 4.5], [0.0, 0.0, 0.8, 0.8, 0.16]), ZETA)
    return of_one_program(coarse("free", recorded(setup)), *SHOWN)


@cache
def driven() -> RigDataset:
    profile = ([0.0, 0.25, 1.25, 3.5], [0.0, 0.0, 1.0, 1.0])
    setup = setup_of(profile, ZETA, vx=[0.0, 0.0, 0.1, 0.1])
    run = recorded(setup, channels=("z", "fx", "fz", "torque"), force_noise=0.1)
    names = ("surface_slope", "surface_incline", "channel_delay")
    return of_one_program(coarse("driven", run), *names)


@cache
def linearized(runs: RigDataset):
    return linearize_run(runs, 0, LOG_ZETA)


def column(runs: RigDataset, name: str, index: int) -> dict[str, np.ndarray]:
    """Change of each channel per unit of one strength at the sample times, by the lines."""
    effect, along = effect_class(name), linearized(runs)
    trial = with_zeta(runs.trials[0], LOG_ZETA)
    shaped = {field: jnp.asarray([float(getattr(effect(), field))]) for field in shapes(effect)}
    node = jnp.asarray(along.node_interval)
    response = propagate(along, effect_sensitivity(effect, trial, along, node, shaped, {}))
    nodes = int(along.nodes) + 1
    return {
        channel: np.interp(
            runs.time(0),
            np.asarray(along.time)[:nodes],
            np.asarray(response)[:nodes, READINGS.index(channel), index],
        )
        for channel in runs.channels
    }


def change(runs: RigDataset, name: str, index: int, share: float = CHANGE) -> dict[str, np.ndarray]:
    """The same by two whole runs that differ by a share of the strength's typical size."""
    model = AugmentedModel((effect_class(name),))
    scale = model.free[index].scale
    assert scale is not None
    there = model.null()
    there[index] = share
    changed, plain = (runs.prediction(model, 0, LOG_ZETA, at) for at in (there, model.null()))
    return dict(zip(runs.channels, (changed - plain) / (share * scale), strict=True))


@pytest.mark.parametrize(("name", "shown"), SHOWN.items())
def test_the_column_of_a_strength_is_the_change_of_a_whole_run(name, shown):
    about = field_metadata(effect_class(name))
    for index in range(sum("typical" in each for each in about.values())):
        line, exact = column(free(), name, index), change(free(), name, index)
        for channel in ("x", "z"):
            largest = np.abs(exact[channel]).max()
            assert (largest > 0) == (channel in shown)
            error = np.abs(line[channel] - exact[channel]).max()
            assert error <= LINES_ERR * largest, (index, channel)


def test_a_bed_that_leans_shows_so_in_the_forces_of_a_driven_carriage():
    """The sand bears the weight and leans back by the slope: by the weight per unit of it."""
    moving = driven().time(0) > MOVING
    weight = float(driven().trials[0].simulator.rig.mass_z) * 9.81
    beside_depth = []
    for of in (column, change):
        leaning, depth = (of(driven(), f"surface_{each}", 0) for each in ("incline", "slope"))
        assert np.mean(leaning["fx"][moving]) == pytest.approx(-weight, rel=RIPPLE), of
        beside_depth.append(np.mean((leaning["fx"] - depth["fx"])[moving]))
    assert beside_depth[0] == pytest.approx(beside_depth[1], rel=LEAN)
    line, exact = column(driven(), "surface_incline", 0), change(driven(), "surface_incline", 0)
    assert np.abs(line["z"] - exact["z"]).max() < LINES_ERR * np.abs(exact["z"]).max()


def test_a_late_logger_shows_in_the_mean_change_of_torque():
    """By a tenth of a second at once: over longer than that, means of both are alike."""
    late = change(driven(), "channel_delay", 0, share=1.0)["torque"]
    line = column(driven(), "channel_delay", 0)["torque"]
    window = np.ones(30) / 30
    moving = np.convolve(driven().time(0), window, "valid") > MOVING
    exact, found = (np.convolve(each, window, "valid")[moving] for each in (late, line))
    assert np.std(found - exact) < LINES_ERR * np.abs(exact).max()
    np.testing.assert_array_equal(change(driven(), "channel_delay", 0)["z"], 0)
