"""Runs as xarray datasets and pandas tables, and as they show themselves."""

import numpy as np
import pytest

from drftjax.common import packages
from drftjax.common.errors import InputError
from drftjax.runlog.record import Measured, RecordedCommand, RecordedSetup, RunLog


@pytest.fixture
def run() -> RunLog:
    time = np.array([0.0, 1.0, 2.0, 3.0])
    return RunLog(
        setup=RecordedSetup(wheel_radius=0.1, mass_z=5.0),
        command=RecordedCommand(time=[0.0, 2.0, 4.0], omega=[0.0, 2.0, 2.0]),
        measured=Measured(time=time, x=0.1 * time, z=-0.01 * time, torque=2.0 * time),
        source="measured",
        title="a $strange$ <run>",
    )


def test_table_has_commands_at_the_times_of_the_measurements(run):
    frame = run.to_dataframe()
    assert frame.index.tolist() == [0, 1, 2, 3]
    assert frame.omega.tolist() == [0, 1, 2, 2]
    assert frame.torque.tolist() == [0, 2, 4, 6]
    assert run.to_dataframe(derived=True).power.tolist() == [0, 2, 8, 12]


def test_dataset_has_units_and_the_set_up(run):
    data = run.to_xarray(derived=True)
    assert data.torque.attrs["units"] == "N m"
    assert data.slip.values[2:] == pytest.approx([0.5, 0.5])
    assert float(data.z.sel(time=2.0)) == -0.02
    assert data.attrs["wheel_radius"] == 0.1
    assert data.attrs["title"] == run.title


def test_run_shows_its_values(run):
    assert repr(run) == (
        "<RunLog 'a $strange$ <run>' (measured): 3 s, at the end x 0.3 m, z -0.03 m, torque 6 N m>"
    )
    assert "a $strange$ &lt;run&gt;" in run._repr_html_()
    assert "measured/torque" in run._repr_html_()
    assert len(run.plot().axes) == 4


@pytest.mark.parametrize(("view", "package"), [("to_xarray", "xarray"), ("to_dataframe", "pandas")])
def test_missing_package_is_named(run, monkeypatch, view, package):
    def absent(name: str) -> None:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(packages, "import_module", absent)
    with pytest.raises(InputError, match=f"{view} needs the package {package}.*pip install"):
        getattr(run, view)()
