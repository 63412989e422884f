"""Fits by some of the recorded channels alone."""

import dataclasses

import numpy as np
import pytest

import drftjax
from drftjax.common.errors import InputError
from drftjax.recorded.prepared_run import prepare_run
from drftjax.runlog.hdf5.api import write_run
from drftjax.runlog.record import Measured, Online
from drftjax.runlog.schema import COLUMNS
from tests.helpers.synthetic_runs import SLOW, recorded, setup_of

# A channel that is not compared takes no part: the same program on the same numbers.
SAME = 1e-12


@pytest.fixture(scope="module")
def run():
    return recorded(setup_of(SLOW, 0.74), 1)


def test_a_channel_left_out_counts_no_more_than_one_not_recorded(run):
    alone = dataclasses.replace(run, measured=Measured(time=run.measured.time, z=run.measured.z))
    by_z, without = (
        drftjax.fit({"run": each}, parameters="zeta", compare=channels).runs[0]
        for each, channels in ((run, "z"), (alone, ("x", "z")))
    )
    assert by_z.channels == without.channels == ("z",)
    ((ours,), (theirs,)) = (each.values.values() for each in (by_z, without))
    assert ours.value == pytest.approx(theirs.value, rel=SAME)
    assert ours.error == pytest.approx(theirs.error, rel=SAME)
    np.testing.assert_allclose(by_z.residuals["z"], without.residuals["z"], rtol=0, atol=SAME)


def test_what_is_not_compared_is_told_as_unused(run):
    observation = prepare_run("run", run, compare=("x",)).observation
    assert observation.channels == ("x",)
    assert "z" in observation.unused


def test_forces_on_a_free_carriage_are_compared_where_that_is_asked_and_no_loop_drives_it():
    log = recorded(setup_of(SLOW, 0.74), channels=("x", "z", "fx"))
    assert prepare_run("run", log).observation.channels == ("x", "z")
    asked = prepare_run("run", log, carriage_forces=True).observation
    assert asked.channels == ("x", "z", "fx")
    columns = {each.name: np.arange(3) for each in COLUMNS["online"]}
    online = Online(**columns, tick=0.1, zeta_step=0.01, tolerance=1e-3)
    in_loop = dataclasses.replace(log, online=online)
    looped = prepare_run("run", in_loop, carriage_forces=True).observation
    assert looped.channels == ("x", "z")
    assert looped.unused == ("fx",)


def test_a_force_on_a_free_carriage_is_not_compared_without_its_motion():
    log = recorded(setup_of(SLOW, 0.74), channels=("z", "fx", "fz"))
    seen = prepare_run("run", log, carriage_forces=True).observation
    assert seen.channels == ("z",)
    assert seen.unused == ("fx", "fz")


@pytest.mark.parametrize(
    ("compare", "why"),
    [
        (("sinkage",), "must be among x, z, fx, fz, torque"),
        ((), "must be among x, z, fx, fz, torque"),
        (("torque",), "of a free carriage x or z must be compared, not torque alone"),
        (("fx", "fz"), "of a free carriage x or z must be compared"),
    ],
)
def test_channels_that_cannot_be_compared_are_refused(run, compare, why):
    with pytest.raises(InputError, match=why):
        drftjax.fit({"run": run}, compare=compare)


def test_the_command_compares_what_it_is_told(drft, run, tmp_path):
    write_run(tmp_path / "run.h5", run)
    answer = drft("fit", tmp_path / "run.h5", "--own", "zeta", "--compare", "z")
    assert answer.code == 0
    assert "z [mm]" in answer.out
    assert "x [mm]" not in answer.out
    assert "must be among" in drft("fit", tmp_path / "run.h5", "--compare", "y").refusal
    refusal = drft("fit", tmp_path / "run.h5", "--zeta", "path", "--compare", "x").refusal
    assert "--compare must name z" in refusal
