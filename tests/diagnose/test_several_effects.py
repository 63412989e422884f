"""Several effects at once, on runs of a plant that shares no code with the project.

`../shared/blind` holds the runs and their labels. Few effects are to choose from, those of the
label, and one or two that look most like them: of these, such that one program simulates them all.
"""

import json
from pathlib import Path

import pytest

from diagnose.api import diagnose
from diagnose.report.budget_text import budget_rows, effect_sentences, one_zeta_sentence
from diagnose.result import Diagnosis
from tests.helpers.rig_datasets import WITHOUT_NEXT_RUN

SEVERAL = ("speed_ripple", "vertical_coulomb", "travel_gain", "vertical_viscous")
SWEPT = ("slip_softening", "sinkage_hardening", "loosening")
# Slips of 0, 30 and 60 % at one speed, one of them twice, and of 15 % at another.
FEW_SLIPS = {"fast15", "slip00a", "slip00b", "slip30a", "slip60a"}
# Shares are rounded to double precision.
ROUNDING = 1e-9


def labelled(shared: Path, place: str) -> tuple[list[Path], set[str]]:
    folder = shared / "blind" / place
    labels = json.loads((folder.parent / "labels.json").read_text())
    return sorted(folder.glob("*.h5")), set(labels[folder.name])


@pytest.fixture(scope="module")
def several(shared: Path) -> tuple[Diagnosis, set[str]]:
    runs, label = labelled(shared, "budget_practice/set_02")
    return diagnose(runs[:4], SEVERAL, settings=WITHOUT_NEXT_RUN), label


def test_three_effects_at_once_are_named(several):
    found, label = several
    assert set(found.verdict) == label
    assert all(found.weights[name] > 0.9 for name in label)
    assert len(found.stepwise) == 3
    assert [gap.shrinkage > 0.9 for gap in found.gap.values()] == [True, True]


def test_the_budget_divides_the_gap_among_them(several):
    found, label = several
    for channel, budget in found.budget.items():
        gap = found.gap[channel]
        assert (budget.before, budget.after) == pytest.approx((gap.before, gap.after), rel=1e-6)
        shares = [each.share for each in budget.effects.values()]
        assert sum(shares) + budget.remainder == pytest.approx(1.0, abs=ROUNDING)
    # A scale that reads long shows in travel alone.
    assert found.budget["x"].effects["travel_gain"].share > 0.2
    assert abs(found.budget["z"].effects["travel_gain"].share) < 0.05
    rows = budget_rows(found)
    assert {row[0] for row in rows[1:-2]} == label
    assert [row[0] for row in rows[-2:]] == ["unexplained", "chance (noise floor)"]
    assert len(effect_sentences(found)) == len(label)


def test_zeta_that_falls_with_slip_is_named_and_hides_nearly_all_of_the_gap(shared):
    runs, label = labelled(shared, "sweep_practice/set_02")
    few = [each for each in runs if each.stem in FEW_SLIPS]
    found = diagnose(few, SWEPT, settings=WITHOUT_NEXT_RUN)
    assert set(found.verdict) == label == {"slip_softening"}
    bed, own = found.one_zeta_gap["z"], found.gap["z"]
    assert bed.before > 20 * own.before
    assert bed.after < 0.1 * bed.before
    assert found.zeta_shares["slip_softening"].own > 0.9 > found.zeta_shares["slip_softening"].bed
    assert "With one zeta for the bed" in one_zeta_sentence(found)
