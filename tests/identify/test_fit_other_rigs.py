"""Noise-free runs of rigs far from the paper's: a fit must find what made them.

`../shared/reference_rigs` gives wheels, masses, sands and commands.
"""

from pathlib import Path

import pytest

from drftjax.recorded.prepared_run import Run
from drftjax.runlog.hdf5.api import read_run
from drftjax.setups.from_run import setup_from_run
from drftjax.setups.simulated_run import simulated_run
from identify.api import fit

# No noise and the same model: what is left is how far the solver went.
ZETA, HEIGHT, ERRORS = 1e-3, 1e-2, 2.0
# Where the search starts, as a share of the true values [-].
START = {"zeta": 1.05, "height": 0.95}


@pytest.mark.parametrize("name", ["moon", "large_wheel", "small_wheel", "stiff_sand"])
def test_a_noise_free_run_gives_zeta_and_grouser_height_back(shared: Path, name):
    path = shared / "reference_rigs" / f"{name}.h5"
    if not path.is_file():
        pytest.skip("the folder ../shared has no reference_rigs")
    model = setup_from_run(read_run(path))
    true_zeta, true_height = float(model.terrain.zeta), model.wheel.grouser_height
    run = simulated_run(model)
    model.terrain.zeta = START["zeta"] * true_zeta
    model.wheel.grouser_height = START["height"] * true_height
    runs: Run = (model, run)
    result = fit(runs, parameters=["zeta", "wheel.grouser_height"], compare=["x", "z"])
    zeta = result.runs[0].values["terrain.zeta"]
    height = result.shared["wheel.grouser_height"]
    assert zeta.value == pytest.approx(true_zeta, rel=ZETA)
    assert height.value == pytest.approx(true_height, rel=HEIGHT)
    assert abs(zeta.value - true_zeta) <= ERRORS * zeta.error
    assert abs(height.value - true_height) <= ERRORS * height.error
