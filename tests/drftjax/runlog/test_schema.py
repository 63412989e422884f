"""The one table of columns, and what derives from it."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from drftjax.runlog import plausibility, schema
from drftjax.runlog.content import Level
from drftjax.runlog.hdf5.api import read_run, survey_run
from drftjax.runlog.hdf5.conversion import from_content, to_content
from drftjax.runlog.hdf5.examination import examine
from drftjax.runlog.plausibility import PlausibilityLimits
from drftjax.runlog.record import Events, Measured, Online, RecordedCommand, RecordedSetup
from drftjax.runlog.schema import COLUMNS, SETUP_UNITS, Column
from hils.recording.row_stream import Kind, OnlineRow

RUN = Path(__file__).parents[3] / "data" / "runs" / "fast.h5"
RECORDS = {
    "command": RecordedCommand,
    "measured": Measured,
    "online": Online,
    "events": Events,
}


@pytest.mark.parametrize("title", COLUMNS)
def test_a_record_has_a_field_for_each_column(title):
    names = [each.name for each in dataclasses.fields(RECORDS[title])]
    columns = [each.name for each in COLUMNS[title]]
    attributes = {"tick", "zeta_step", "tolerance", "loop", "meanings"}
    assert [each for each in names if each not in attributes] == columns


def test_the_set_up_has_a_field_for_each_number():
    assert [each.name for each in dataclasses.fields(RecordedSetup)] == [*SETUP_UNITS]


def test_rows_of_the_loop_follow_the_table():
    assert OnlineRow._fields == tuple(each.name for each in COLUMNS["online"])
    assert [kind.name.lower() for kind in Kind] == [*COLUMNS]


def online(**changes) -> Online:
    columns = {each.name: np.arange(3) for each in COLUMNS["online"]}
    return Online(**(columns | changes), tick=0.1, zeta_step=0.01, tolerance=1e-3)


def test_columns_are_kept_in_the_types_of_the_table():
    record = online(tuned=np.array([0.0, 1.0, 255.0]))
    for column in COLUMNS["online"]:
        assert getattr(record, column.name).dtype == column.dtype
    with pytest.raises(ValueError, match="tuned holds numbers that uint8 cannot hold"):
        online(tuned=np.array([0.0, 1.5, 2.0]))


def test_a_file_older_than_a_column_may_lack_it(monkeypatch):
    content = to_content(read_run(RUN))
    later = dict(COLUMNS) | {"command": (*COLUMNS["command"], Column("tilt", "rad", np.float64, 2))}
    monkeypatch.setattr("drftjax.runlog.hdf5.examination.COLUMNS", later)

    def missing(version: int) -> list[str]:
        attributes = content.attributes | {"schema_version": version}
        newer = dataclasses.replace(content, attributes=attributes)
        return [where for where, reason, _ in examine(newer) if "is missing" in reason]

    assert missing(1) == []
    assert missing(2) == ["/command/tilt"]


def test_a_run_survives_the_way_to_contents_and_back():
    run = read_run(RUN)
    again = from_content(to_content(run))
    for title in ("command", "measured"):
        for column in COLUMNS[title]:
            before, after = (getattr(getattr(each, title), column.name) for each in (run, again))
            np.testing.assert_array_equal(before, after)
    assert again.setup == run.setup


def test_limits_of_plausibility_can_be_chosen():
    content, violations = survey_run(RUN)
    assert content is not None
    assert violations == []
    slow = PlausibilityLimits(max_omega=1e-3, max_travel=1e-3)
    found = [(where, level) for where, _, level in examine(content, slow)]
    assert found == [("/command/omega", Level.NOTE), ("/measured/x", Level.NOTE)]
    assert PlausibilityLimits() == plausibility.LIMITS
    assert schema.UNITS["command"]["omega"] == "rad/s"
