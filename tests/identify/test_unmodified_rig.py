"""Runs of rigs with nothing wrong are met by one zeta nearly to the noise of their scale."""

import pytest

from tests.studies.null_runs import left

# The estimate's own spread over a thousand samples, and its rounding to 0.6 um.
TOLD = 0.1
# 10 % over the noise is asked where nothing is wrong; docs/guide/fit.md has all runs.
LEFT = 1.1
# These begin to turn without the jump that some others of the plant make [mm].
JUMP = 0.03
SCALE = 0.020  # white noise of the sinkage's scale in these sets [mm]
# A misfit has corners where plates begin to lead, and a search may end at one.
CORNER = 1.02


@pytest.mark.parametrize(("name", "run"), [("set_11", "c"), ("set_12", "a")])
def test_one_zeta_leaves_little_more_than_the_scale_s_noise(shared, name, run):
    (each,) = left([shared / "blind" / "single_practice" / name / f"run_{run}.h5"])
    assert each.noise == pytest.approx(SCALE, rel=TOLD)
    assert each.rmse < LEFT * SCALE
    assert each.rmse <= CORNER * each.with_travel
    assert abs(each.jump) < JUMP
