"""The verdict, by the weights of sets of effects."""

from types import SimpleNamespace

import pytest

from diagnose.selection.model_weights import NONE, UNKNOWN
from diagnose.selection.verdict import (
    believing_listed,
    competing_hypotheses,
    decide,
    explaining_candidates,
    weight_by_name,
    weights_without,
)


@pytest.mark.parametrize(
    ("share", "left"),
    [
        ({(NONE,): 0.1, (UNKNOWN,): 0.1, ("drawbar",): 0.8}, {(NONE,): 0.5, (UNKNOWN,): 0.5}),
        # Of long runs all other weights may be too small for a number.
        ({(NONE,): 0.0, (UNKNOWN,): 0.0, ("drawbar",): 1.0}, {(NONE,): 0.0, (UNKNOWN,): 1.0}),
    ],
)
def test_without_a_set_the_others_have_its_weight(share, left):
    assert weights_without(share, ("drawbar",)) == pytest.approx(left)


def test_most_of_the_weight_of_unknown_goes_to_listed_sets_in_proportion():
    share = {
        ("none",): 0.0,
        ("unknown",): 0.9,
        ("drawbar",): 0.02,
        ("drawbar", "unknown"): 0.04,
        ("horizontal_coulomb",): 0.04,
    }
    for leaves_gap, unknown in ((False, 0.31), (True, 0.94)):
        moved = believing_listed(share, ("drawbar",), leaves_gap)
        assert sum(moved.values()) == pytest.approx(1.0)
        assert decide(moved) == (("drawbar",), [["drawbar", "horizontal_coulomb"]])
        # 0.06 and 0.04 of their own, and six and four tenths of 0.63.
        assert weight_by_name(moved) == pytest.approx(
            {"unknown": unknown, "drawbar": 0.438, "horizontal_coulomb": 0.292, "none": 0.0}
        )


def test_where_a_larger_set_explains_the_gap_smaller_ones_get_nothing_of_unknown():
    share = {("unknown",): 0.9, ("backlash",): 0.08, ("backlash", "speed_gain"): 0.02}
    moved = believing_listed(share, ("backlash", "speed_gain"), leaves_gap=False)
    # 0.02 of its own, and all of 0.63.
    assert moved[("backlash", "speed_gain")] == pytest.approx(0.65)
    assert moved[("backlash",)] == 0.08
    assert decide(moved)[0] == ("backlash", "speed_gain")
    # Beside a gap of hundreds of floors all listed sets may weigh too little for a number.
    lost = {("unknown",): 1.0, ("backlash",): 0.0, ("backlash", "speed_gain"): 0.0}
    moved = believing_listed(lost, ("backlash", "speed_gain"), leaves_gap=True)
    assert moved[("backlash", "speed_gain", "unknown")] == pytest.approx(0.7)


def test_a_larger_set_may_explain_the_gap_unless_it_is_far_less_likely():
    share = {
        ("unknown",): 0.8,
        ("a",): 0.08,
        ("a", "b"): 0.01,
        ("a", "c"): 0.005,
        ("a", "c", "unknown"): 0.015,
        ("a", "b", "c"): 1e-5,
    }
    assert explaining_candidates(share, ("a",)) == [("a",), ("a", "c")]
    # None that is smaller than the likeliest.
    assert explaining_candidates(share, ("a", "c")) == [("a", "c")]


def test_effects_that_share_their_weight_speak_together():
    share = {("none",): 0.02, ("unknown",): 0.4, ("drawbar",): 0.3, ("bulldozing",): 0.28}
    assert decide(share) == (("drawbar",), [["drawbar", "bulldozing"]])
    assert decide(share | {("unknown",): 0.6})[0] == ("unknown",)
    assert decide({("none",): 1.0, ("unknown",): 0.0}) == (("none",), [["none"]])


def test_without_a_gap_the_verdict_is_none_whatever_the_weights():
    share = {("none",): 0.05, ("depth_hardening",): 0.7, ("cohesion",): 0.2, ("unknown",): 0.05}
    assert decide(share)[0] == ("depth_hardening",)
    named = [["none", "depth_hardening", "cohesion"]]
    assert decide(share, has_gap=False) == (("none",), named)


def test_none_stands_until_it_is_far_outweighed():
    """An alarm takes more than being likelier: the rate of false ones is held down."""
    faint = {("drawbar",): 0.35, ("none",): 0.3, ("backlash",): 0.2, ("unknown",): 0.15}
    assert decide(faint) == (("none",), [["none", "drawbar", "backlash", "unknown"]])
    plainer = faint | {("drawbar",): 0.6, ("none",): 0.1}
    assert decide(plainer) == (("drawbar",), [["drawbar", "backlash"]])
    assert decide({("none",): 0.2, ("unknown",): 0.8})[0] == ("none",)
    assert decide({("none",): 0.1, ("unknown",): 0.8, ("drawbar",): 0.1})[0] == ("unknown",)


def test_likenesses_of_a_second_effect_speak_together_for_it():
    alone = {("backlash",): 0.4, ("loosening",): 0.05}
    beside = {("backlash", "wheel_radius"): 0.3, ("backlash", "travel_gain"): 0.25}
    expected = ("backlash", "wheel_radius"), [["backlash"], ["wheel_radius", "travel_gain"]]
    assert decide(alone | beside) == expected
    # They do not where one effect alone is believed more than all of them.
    assert decide(alone | {("backlash", "travel_gain"): 0.3})[0] == ("backlash",)


def test_a_run_is_to_tell_the_verdict_from_all_that_is_named_beside_it():
    def rivals(**weights: float) -> list[tuple[str, ...]]:
        share = {(name,): weight for name, weight in weights.items()}
        effects = [each for each in share if each[0] not in (NONE, UNKNOWN)]
        leading = [SimpleNamespace(names=each) for each in effects]
        found = SimpleNamespace(none=SimpleNamespace(names=()))
        told = competing_hypotheses(found, leading, share, max(share, key=lambda each: share[each]))  # pyright: ignore
        return [each.names for each in told]

    alike = {"measurement_delay": 0.4, "measurement_filter": 0.3, "speed_lag": 0.2}
    rest = {"none": 0.0, "unknown": 0.1}
    assert rivals(**alike, **rest) == [("measurement_filter",), ("speed_lag",)]
    # The likeliest counts where it has little weight, too; one that all but none has does not.
    assert rivals(drawbar=0.9, speed_lag=0.05, none=0.04, unknown=0.01) == [("speed_lag",)]
    assert rivals(drawbar=0.99, speed_lag=0.01, none=0.0, unknown=0.0) == []
    assert rivals(drawbar=0.5, none=0.5, unknown=0.0) == [()]
    # Nothing is known of what is unknown, and another form of an effect needs no telling apart.
    assert rivals(unknown=0.6, drawbar=0.4, none=0.0) == []
    assert rivals(speed_ripple=0.6, speed_harmonics=0.4, none=0.0) == []
