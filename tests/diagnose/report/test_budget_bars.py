"""Bars of the budget: shares of the gap by their widths."""

import pytest

from diagnose.report.page import budget_bars
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


def test_a_diagnosis_without_a_budget_has_no_bars():
    assert budget_bars(handmade_diagnosis(["a"], samples=10, found=False)) == []
