"""Where x of a diagnosis counts from."""

import dataclasses

import numpy as np
import pytest

from diagnose.api import gather_inputs
from diagnose.checks.caveats import caveats
from diagnose.dataset import RigDataset
from diagnose.evaluation.model_reader import read_model_file
from drftjax.recorded.prepared_run import prepare_run
from drftjax.runlog.record import RunLog
from drftjax.setups.setup_toml import setup_toml
from tests.helpers.synthetic_runs import SLOW, recorded, setup_of

# Places of a few metres, taken from one another.
ROUNDING = 1e-14
# Three times what two starts differ by that are read with 20 um of noise each [m].
SET_OFF = 1e-4


@pytest.fixture(scope="module")
def run() -> RunLog:
    return recorded(setup_of())


def from_x(run: RunLog, start: float) -> RunLog:
    assert run.measured.x is not None
    x = run.measured.x + start
    return dataclasses.replace(run, measured=dataclasses.replace(run.measured, x=x))


def test_runs_that_start_elsewhere_count_from_there_and_keep_their_places(run):
    at_zero = gather_inputs({"a": run, "b": from_x(run, 0.3)}).runs
    away = gather_inputs({"a": from_x(run, 2.0), "b": from_x(run, 2.3)}).runs
    assert away[0].setup.start.x == pytest.approx(0.0, abs=ROUNDING)
    assert away[1].setup.start.x == pytest.approx(0.3, abs=ROUNDING)
    for one, other in zip(at_zero, away, strict=True):
        moved = one.observation.values[0][0] - other.observation.values[0][0]
        difference = other.observation.values[0] + moved - one.observation.values[0]
        np.testing.assert_allclose(difference, 0, rtol=0, atol=ROUNDING)
        assert other.trial.start.position[0] == pytest.approx(other.setup.start.x, abs=ROUNDING)


def test_a_driven_carriage_starts_where_its_x_was_recorded():
    """Though x is given there and not compared: a patch of the bed lies at one place."""
    setup = setup_of(SLOW, vx=[0.0, 0.0, 0.06, 0.06])
    one, other = (recorded(setup, channels=("x", "z"), seed=seed) for seed in (0, 1))
    found = gather_inputs({"a": from_x(one, 2.0), "b": from_x(other, 2.3)}).runs
    assert "x" not in found[0].observation.channels
    starts = [each.trial.start.position[0] for each in found]
    assert starts == pytest.approx([0.0, 0.3], abs=SET_OFF)
    assert found[1].setup.start.origin == found[0].setup.start.origin
    assert found[0].setup.start.origin == pytest.approx(2.0, abs=SET_OFF)


def test_a_model_counts_other_runs_from_where_its_own_started(run, tmp_path):
    """However few of them there are, and wherever these start."""
    model = setup_of()
    model.start.origin = 2.0
    model.effects = [{"name": "surface_slope", "slope": 0.01}]
    path = tmp_path / "model.toml"
    path.write_text(setup_toml(model))
    assert read_model_file(path).origin == 2.0
    for start in (2.0, 2.3, 0.0):
        (each,) = gather_inputs({"b": from_x(run, start)}, read_model_file(path).origin).runs
        assert each.setup.start.origin == 2.0
        recorded_start = prepare_run("b", from_x(run, start)).setup.start.x
        assert each.setup.start.x == pytest.approx(recorded_start - 2.0, abs=ROUNDING)
        assert each.trial.start.position[0] == each.setup.start.x
    path.write_text(setup_toml(setup_of()))
    assert "origin" not in path.read_text()
    assert read_model_file(path).origin is None


def test_a_run_without_x_leaves_the_others_where_they_are(run):
    def blind(one: RunLog) -> RunLog:
        return dataclasses.replace(one, measured=dataclasses.replace(one.measured, x=None))

    given = {"a": from_x(run, 3.0), "b": from_x(run, 3.2), "c": blind(from_x(run, 3.0))}
    found = gather_inputs(given).runs
    starts = [each.setup.start.x for each in found]
    assert starts == pytest.approx([0.0, 0.2, 0.0], abs=ROUNDING)
    assert {each.setup.start.origin for each in found} == {found[0].setup.start.origin}
    assert any(
        "c lacks x" in note and "start at x = 0" in note for note in caveats(RigDataset.of(found))
    )


def test_a_copy_of_a_run_is_no_repeat(run):
    again = dataclasses.replace(run, title="saved again")
    told = gather_inputs({"a": run, "b": again, "c": from_x(run, 0.3)})
    assert [each.name for each in told.runs] == ["a", "c"]
    assert told.skipped == {"b": "b: has the very readings of a"}


def test_where_x_counts_from_is_told(run):
    (away,) = gather_inputs({"a": from_x(run, 2.0)}).runs
    assert any(
        note.startswith("x = 0 is 2 m of the recorded x") for note in caveats(RigDataset.of([away]))
    )
    (here,) = gather_inputs({"a": run}).runs
    assert not any("recorded x" in note for note in caveats(RigDataset.of([here])))


def test_runs_that_start_at_zero_stay_as_they_are(run):
    (each,) = gather_inputs({"a": run}).runs
    plain = prepare_run("a", run)
    assert each.setup.start.x == plain.setup.start.x
    np.testing.assert_array_equal(each.observation.values, plain.observation.values)
