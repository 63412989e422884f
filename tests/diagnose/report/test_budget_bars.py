"""Budget of the gap: its bars by their widths, and its table."""

import pytest

from diagnose.report.budget_text import budget_table
from diagnose.report.page import budget_bars
from drftjax.common.rich_text import table_cells
from tests.helpers.handmade_diagnosis import BEFORE, FLOORS, handmade_diagnosis

ROUNDING = 1e-9


def test_parts_follow_on_each_other_and_are_as_wide_as_their_share_of_the_gap():
    bars = budget_bars(handmade_diagnosis(["a", "b"], samples=10))
    assert [bar.title for bar in bars] == ["travel x: gap 9 mm", "height z: gap 1.1 mm"]
    for bar, channel in zip(bars, ("x", "z"), strict=True):
        chance = 100 * FLOORS[channel] / BEFORE[channel]
        shares = [0.7, 0.24, 0.06]
        expected = [chance, *((100 - chance) * share for share in shares)]
        assert [part.width for part in bar.parts] == pytest.approx(expected, rel=ROUNDING)
        ends = [part.start + part.width for part in bar.parts]
        assert [0.0, *ends[:-1]] == pytest.approx([part.start for part in bar.parts])
    names = [part.label for part in bars[0].parts]
    assert names[1:] == ["horizontal_coulomb or drawbar", "surface_slope", "unexplained"]


def test_the_table_gives_the_unit_of_each_channel():
    head = table_cells(budget_table(handmade_diagnosis(["a"], samples=10))).head
    share = "share (90 %)"
    assert head == ["the gap comes from", "x [mm]", share, "z [mm]", share]


def test_a_diagnosis_without_a_budget_has_no_bars():
    assert budget_bars(handmade_diagnosis(["a"], samples=10, found=False)) == []
