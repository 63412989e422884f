"""Sweeps of set-ups against single runs."""

import numpy as np
import pytest

from drftjax.common import packages
from drftjax.common.errors import InputError
from drftjax.setups.api import simulate
from drftjax.setups.setup import SetUp
from drftjax.sweeps.parameter_sweep import sweep

# The same steps, compiled as one of several runs.
ROUNDING = 1e-10

COMMAND = {"time": [0.5, 0.8, 1.3], "omega": [0, 1, 1]}


@pytest.fixture(scope="module")
def setup() -> SetUp:
    return SetUp(COMMAND, wheel={"shape": "plain", "plate_size": 0.02}, integrator={"step": 5e-3})


@pytest.fixture(scope="module")
def swept(setup):
    return sweep(setup, zeta=[0.6, 0.9], radius=[0.15, 0.11, 0.1501], sinkage=[0.01, 0.02])


def test_each_run_of_a_sweep_is_the_single_run(setup, swept):
    assert swept["z"].shape == (2, 3, 2, len(swept.time))
    for i, j, k in ((0, 0, 1), (1, 1, 0), (1, 2, 1)):
        point = {
            name: values[n] for (name, values), n in zip(swept.axes.items(), (i, j, k), strict=True)
        }
        single = simulate(setup, **point)
        assert swept.time == pytest.approx(single.measured.time, abs=ROUNDING)
        for name, values in single.measured.channels().items():
            scale = np.abs(values).max()
            assert swept[name][i, j, k] == pytest.approx(values, abs=ROUNDING * scale)


def test_coordinates_carry_names_values_and_units(swept):
    data = swept.to_xarray()
    assert dict(data.sizes) == {"zeta": 2, "radius": 3, "start.sinkage": 2, "time": 81}
    one = data.sel({"zeta": 0.9, "radius": 0.11, "start.sinkage": 0.01})
    assert one.fz.values == pytest.approx(swept["fz"][1, 1, 0])
    assert data.torque.attrs["units"] == "N m"
    assert float(data.time[0]) == 0.5
    frame = swept.to_dataframe()
    assert frame.z.to_numpy() == pytest.approx(swept["z"].ravel())
    assert len(frame) == 12 * 81


def test_sweep_shows_its_numbers(swept):
    assert "12 runs of 1.3 s over zeta (2), radius (3), sinkage (2)" in repr(swept)
    assert "final sinkage" in swept._repr_html_()
    assert len(swept.plot().axes[0].lines) == 12


def test_step_that_is_chosen_divides_the_interval(setup):
    bare = SetUp(COMMAND, wheel=setup.wheel)
    swept = sweep(bare, zeta=[0.8], mass_z=[18.0])
    parts = 0.01 / swept.step
    assert parts == pytest.approx(round(parts), abs=1e-9)
    assert bare.integrator.step is None


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ({}, "nothing is swept"),
        ({"zeta": 0.5}, "zeta has shape"),
        ({"zeta": []}, "zeta has shape"),
        ({"zeta": [0.5, -1]}, "zeta is -1, must lie"),
        ({"zeta": [0.7, 0.01]}, "at zeta = 0.01: the wheel sinks"),
        ({"step": [1e-3]}, "step cannot be swept"),
        ({"zetta": [1]}, "did you mean 'zeta'"),
        ({"zeta": np.linspace(0.5, 1, 20), "x": range(10_000)}, "would keep"),
    ],
)
def test_impossible_sweeps_are_refused(setup, numbers, said):
    with pytest.raises(InputError, match=said):
        sweep(setup, **numbers)


def test_missing_package_is_named(swept, monkeypatch):
    def absent(name: str) -> None:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(packages, "import_module", absent)
    with pytest.raises(InputError, match="to_xarray needs the package xarray, which is not"):
        swept.to_xarray()
    with pytest.raises(InputError, match="to_dataframe needs the package pandas"):
        swept.to_dataframe()
    with pytest.raises(InputError, match="no channel 'depth'"):
        swept["depth"]
