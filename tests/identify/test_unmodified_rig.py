"""Runs of rigs with nothing wrong are met by one zeta nearly to the noise of their scale."""

import numpy as np
import pytest

from tests.studies.null_runs import left

# The estimate's own spread over a thousand samples, and its rounding to 0.6 um.
TOLD = 0.1
# 10 % over the noise is asked where nothing is wrong; docs/guide/fit.md has all runs.
LEFT = 1.1
# These begin to turn without the jump that some others of the plant make [mm].
JUMP = 0.03
# In these sets zeta scatters from run to run by three per mille, of the one or two per cent that
# such sand may have.
SCATTER = 0.01
SCALE = 0.020  # white noise of the sinkage's scale in these sets [mm]
# A line through five readings of that noise, 10 ms apart, is off by 0.6 mm/s; no chance makes five.
RISES = 3.0
# Under so much of its weight a rising wheel is stopped by the rest within a millisecond.
SUPPORT = 0.05


@pytest.mark.parametrize(("name", "runs"), [("set_03", "bdf"), ("set_08", "acg")])
def test_one_zeta_leaves_little_more_than_the_scale_s_noise(shared, name, runs):
    folder = shared / "blind" / "practice" / name
    found = list(left([folder / f"run_{run}.h5" for run in runs]))
    for each in found:
        assert each.noise == pytest.approx(SCALE, rel=TOLD)
        assert each.rmse < LEFT * SCALE
        assert each.rmse <= each.with_travel
        assert abs(each.jump) < JUMP
    scatter = np.std([each.zeta for each in found]) / np.mean([each.zeta for each in found])
    assert scatter < SCATTER


def test_a_wheel_that_jumps_rises_where_the_model_s_sand_gives_no_support(shared):
    (found,) = left([shared / "blind" / "practice" / "set_03" / "run_e.h5"])
    assert found.jump < -JUMP
    assert found.rise > RISES
    assert found.support < SUPPORT
