"""A granular engine's runs with a known force on the carriage: no resistive-force law made them."""

from pathlib import Path

import numpy as np
import pytest

from diagnose.api import diagnose
from diagnose.dataset import RigDataset
from drftjax.recorded.prepared_run import prepare_run
from drftjax.runlog.hdf5.api import read_run

BEDS = Path("data/granular")
RUNS = ("P1_60", "P2_60", "P1_120")  # one command on two packings, and another
DRAWBAR, FRICTION = 50.0, 30.0  # as `tests.studies.granular_bed` gave them to the engine [N]
# Forces are those of 4 mm discs that meet and part, averaged over half a second: 1 N of 200.
ROUGH = 1.0
SIZE = 0.25  # what is asked of a size on sand that follows no known law


def held(kind: str, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Time [s], and force that holds the carriage [N]."""
    run = read_run(BEDS / kind / f"{name}.h5")
    dataset = RigDataset.of([prepare_run(name, run, carriage_forces=True)])
    return dataset.time(0), dataset.recording(0)[dataset.channels.index("fx")]


@pytest.mark.parametrize("name", RUNS)
def test_the_force_that_holds_the_carriage_is_read_without_any_law(name):
    for kind, force in (("before", 0.0), ("drawbar", DRAWBAR), ("friction", FRICTION)):
        time, pull = held(kind, name)
        # Dry friction holds a carriage that moves.
        assert pull[time > 0.6].mean() == pytest.approx(force, abs=ROUGH)


@pytest.mark.parametrize(
    ("kind", "effect", "force"),
    [("drawbar", "drawbar", DRAWBAR), ("friction", "horizontal_coulomb", FRICTION)],
)
def test_a_change_of_that_force_is_named_with_its_size(kind, effect, force):
    now, before = ([BEDS / side / f"{name}.h5" for name in RUNS] for side in (kind, "before"))
    found = diagnose(now, against=before)
    (group,) = found.groups
    # A constant pull and friction differ while the wheel stands, which is half a second here.
    assert effect in group
    assert set(group) <= {"drawbar", "horizontal_coulomb"}
    (numbers,) = found.parameters.values()
    assert numbers["force"].value == pytest.approx(force, rel=SIZE)
