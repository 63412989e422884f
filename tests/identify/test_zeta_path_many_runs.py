"""zeta(t) and the replayed tuner of several runs, of which one cannot be used."""

import dataclasses

import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.recorded.prepared_run import PreparedRun
from identify.crosscheck.crosscheck import crosscheck
from identify.crosscheck.replays import TunerSetting
from identify.fit_path import fit_paths
from identify.results.result import FitResult
from tests.helpers.synthetic_runs import coarse, recorded, setup_of

SETTING = TunerSetting(0.02, 1e-3, 1e-4)


def sound(name: str, zeta: float) -> PreparedRun:
    return coarse(name, recorded(setup_of(zeta=zeta), seed=len(name)))


def without(channel: str) -> PreparedRun:
    run = recorded(setup_of(), channels=tuple({"x", "z"} - {channel}))
    return coarse(f"no {channel}", run)


def of_another_wheel() -> PreparedRun:
    run = recorded(setup_of())
    return coarse(
        "plain", dataclasses.replace(run, setup=dataclasses.replace(run.setup, grouser_count=0))
    )


def of_few_samples() -> PreparedRun:
    return coarse("sparse", recorded(setup_of(), rate=2.0))


BAD = {
    "no z": (lambda: without("z"), "has no /measured/z"),
    "plain": (of_another_wheel, "has another kind of wheel"),
    "sparse": (of_few_samples, "samples to compare, too few for"),
}


@pytest.fixture(scope="module")
def good() -> list[PreparedRun]:
    return [sound("one", 0.74), sound("another", 0.75)]


@pytest.fixture(scope="module")
def alone(good) -> FitResult:
    return fit_paths(good, 0.5)


@pytest.mark.parametrize("bad", BAD)
def test_a_run_that_cannot_be_used_is_named_and_the_others_go_on(good, alone, bad):
    make, why = BAD[bad]
    runs = [good[0], make(), good[1]]
    fitted = fit_paths(runs, 0.5)
    checked = crosscheck(runs, SETTING, knot_spacing=0.5, sweep=False)
    for found in (fitted, checked):
        assert [each.name for each in found.runs] == ["one", "another"]
        assert list(found.failures) == [bad]
        assert why in found.failures[bad]
    for one, other in zip(fitted.runs, alone.runs, strict=True):
        assert np.array_equal(one.path.value, other.path.value)


def test_where_none_can_be_used_the_last_one_says_why(good):
    with pytest.raises(InputError, match="no z: has no /measured/z"):
        fit_paths([without("z")], 0.5)
    unmoved = dataclasses.replace(good[0], name="another")
    with pytest.raises(InputError, match="two runs have one name"):
        crosscheck([unmoved, good[1]], SETTING, sweep=False)
