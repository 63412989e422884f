"""Faults of the rig itself in each phase of a run; what the table of outcomes rests on."""

import re

import pytest

from hils.rig_sim.faults import Fault, ScaleJump, Window
from tests.helpers.fault_matrix import (
    ENDS,
    FAULTS,
    PHASES,
    RIG_FAULTS,
    SHORT,
    STRUCK_COUNTDOWN,
    cell,
    require_outcome,
    require_row,
    require_safety,
    struck,
    table,
)

# The profile stands for so long before the wheel turns [s].
STOOD = 0.1


def test_table_holds_every_fault_and_phase():
    rows = table()
    assert rows.pop("fault") == list(PHASES)
    rows.pop("---")
    assert list(rows) == ["none", *FAULTS]


def test_without_a_fault_the_run_completes():
    assert table()["none"] == ["completes"] * len(PHASES)
    quiet = cell(None)
    require_safety(quiet)
    require_outcome(quiet, "completes")
    assert quiet.report is not None
    assert quiet.report.rested


def test_absurd_readings_between_rest_and_start_move_nothing():
    """The last readings before the start say where the simulated wheel starts."""
    late = struck((Fault(ScaleJump("z"), Window("arm", 2.03, SHORT)),))
    require_safety(late)
    assert late.report is not None
    assert not late.report.completed
    assert re.search(ENDS["readings"][0], late.report.reason), late.report.reason
    if late.report.start is not None:
        # The guard's slack: what a reading may be off by and still be believed.
        assert late.report.start.sinkage == pytest.approx(0.0162, abs=2e-3)


def test_every_fault_strikes_within_its_phase():
    """The windows are where the profile is in that phase, so that the table says what it means."""
    quiet = cell(None)
    start = quiet.soft.rig.occasions
    assert start["hello"] + PHASES["zero"][1] + SHORT <= start["arm"]
    assert start["arm"] + PHASES["settle"][1] + SHORT <= start["motion"]
    # From the first motion: 0.5 s to speed up, 0.5 s steady, 0.5 s to slow down, then the ramp.
    offsets = [PHASES[each][1] for each in ("accelerate", "steady", "decelerate", "ramp-down")]
    assert all(0.5 * n <= offset < 0.5 * (n + 1) for n, offset in enumerate(offsets))
    assert start["motion"] + PHASES["ramp-down"][1] < start["stop"]
    longer = cell(None, "countdown").soft.rig.occasions
    struck_from, began = longer["arm"] + PHASES["countdown"][1], longer["motion"] - STOOD
    assert began - STRUCK_COUNTDOWN <= struck_from
    assert struck_from + SHORT <= began


@pytest.mark.parametrize("name", RIG_FAULTS)
def test_fault_in_each_phase_has_its_stated_outcome(name):
    require_row(name)
