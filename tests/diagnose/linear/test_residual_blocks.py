"""Blocks of residuals, against sums that are done by hand."""

from pathlib import Path

import numpy as np
import pytest

from diagnose.dataset import RigDataset, without_step_errors
from diagnose.gap.zeta_matching import match_runs
from diagnose.linear.linear_fit import (
    DEFAULT_LINEAR_FIT,
    WITHOUT_LEVELS,
    block_names,
    floor_inflation,
    worth_by_block,
)
from diagnose.linear.residual_blocks import (
    BIN_TIME,
    CLOCK_ERROR,
    PLACE_ERROR,
    SlowFastSplit,
    level_share,
)
from diagnose.model.augmented_model import AugmentedModel
from diagnose.rig_runs import gather_runs

# Four bins of five samples each.
TIME = np.arange(20) * BIN_TIME / 5


def split(channel: str, values: np.ndarray) -> dict[str, np.ndarray]:
    return SlowFastSplit.of(TIME).split(channel, values[:, None])


def test_an_error_of_speed_is_small_in_every_bin_and_adds_up_in_the_level():
    speed = 12e-6  # m/s: 6 µm in a bin
    parts = split("x", speed * TIME)
    assert parts["slow"].ravel() == pytest.approx([6e-6] * 3)
    assert parts["level"].item() == pytest.approx(speed * TIME.mean())
    assert len(parts["fast"]) == len(TIME)


def test_a_late_clock_is_as_small_in_a_fast_run_as_where_the_wheel_stands():
    # In so fast a run the error of place adds half a hundredth to that of the clock.
    late, fast = 0.7 * CLOCK_ERROR, 0.5
    parts = SlowFastSplit.of(TIME, fast).split("x", np.full((len(TIME), 1), late * fast))
    assert parts["level"].item() == pytest.approx(0.7 * PLACE_ERROR, rel=0.01)
    assert level_share(0.0) == 1


def test_a_sinkage_is_split_into_bins_and_level():
    parts = split("z", np.where(TIME < 2 * BIN_TIME - 1e-9, 1.0, 3.0))
    assert parts["slow"].ravel() == pytest.approx([1, 1, 3, 3])
    assert parts["level"].item() == pytest.approx(2.0)


def test_forces_have_no_level():
    assert set(split("fz", TIME)) == {"slow", "fast"}
    kinds = {channel: kind for channel, kind in block_names(["x", "z", "fx"]) if kind == "level"}
    assert kinds == {"x": "level", "z": "level"}


def test_each_block_has_its_worth_and_what_has_none_raises_no_floor():
    blocks = block_names(["z"])
    assert worth_by_block(blocks, 0.1, 0.01, 1.0).tolist() == [0.1, 0.01, 1.0]
    # Missed by 2, 3 and 50 model errors.
    missed = (np.array([2.0, 3.0, 50.0]) * WITHOUT_LEVELS.model_errors(blocks)) ** 2
    assert floor_inflation(blocks, missed, 0.5) == pytest.approx(25.0)
    assert floor_inflation(blocks, missed, 0.5, WITHOUT_LEVELS) == pytest.approx(1.5)


def test_healthy_rigs_of_another_program_miss_the_level_of_x_by_its_model_error(shared: Path, pool):
    """`../shared/blind/single_practice/set_11`: nothing is wrong, by a program of its own."""
    paths = sorted((shared / "blind/single_practice/set_11").glob("run_*.h5"))
    dataset = RigDataset.of(gather_runs(paths, lambda _: None).runs)
    found = match_runs(without_step_errors(dataset, pool), AugmentedModel(), np.zeros(0), pool)
    x = dataset.channels.index("x")
    missed = [
        each.residual[x].mean() * level_share(run.observation.mean_speed)
        for each, run in zip(found, dataset.runs, strict=True)
    ]
    level = float(np.sqrt(np.mean(np.square(missed))))
    error = DEFAULT_LINEAR_FIT.model_error["x", "level"]
    # An error so much smaller would call it a fault; so much larger would hide one for nothing.
    assert 0.75 * error < level < error
