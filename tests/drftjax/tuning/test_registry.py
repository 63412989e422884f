"""Tuners by name: the project's own, and those that installed packages add."""

import sys

import pytest

from drftjax.common.errors import InputError
from drftjax.tuning.registry import GROUP, OWN, TunerSetUp, tuners
from drftjax.tuning.step_tuner import StepTuner
from tests.helpers.fake_package import write_package

TICK = 0.01

SOURCE = """
from drftjax.tuning.step_tuner import AbstractTuner, StepTuner


class Doubled(StepTuner):
    def tune(self, memory, zeta, error):
        return super().tune(memory, zeta, 2 * error)


class Unfinished(AbstractTuner):
    pass
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Installs a package with these entry points for one test."""

    def install(**points: str) -> None:
        home = write_package(tmp_path, GROUP, points, SOURCE)
        monkeypatch.syspath_prepend(str(home))
        tuners.cache_clear()

    yield install
    tuners.cache_clear()
    sys.modules.pop("extra", None)


def test_a_packages_tuner_is_built_by_its_name_with_its_numbers(package):
    package(doubled="extra:Doubled")
    assert list(tuners()) == [*OWN, "doubled"]
    tuner = TunerSetUp("doubled", {"zeta_step": 0.5}).build(TICK)
    assert isinstance(tuner, StepTuner)
    assert type(tuner).__name__ == "Doubled"
    assert (float(tuner.tick), float(tuner.zeta_step)) == (TICK, 0.5)


@pytest.mark.parametrize(
    ("name", "point", "said"),
    [
        ("absent", "extra:Absent", "the tuner 'absent' of extra:Absent fails: "),
        ("path", "pathlib:Path", "the tuner 'path' of pathlib:Path is no tuner class"),
        ("half", "extra:Unfinished", "lacks begin, follow, tune, which every tuner has"),
        ("kalman", "extra:Doubled", "the tuner 'kalman' of extra:Doubled is there already"),
    ],
)
def test_a_package_that_adds_no_tuner_is_named(package, name, point, said):
    package(**{name: point})
    with pytest.raises(InputError, match=said):
        tuners()


def test_settings_are_no_number_of_a_tuner():
    with pytest.raises(InputError, match=r"has no number 'settings', it has drift, .* low, high$"):
        TunerSetUp("kalman", {"settings": 1.0}).build(TICK)


def test_an_unknown_tuner_is_refused_with_the_nearest_one():
    said = "the tuner is 'kalmann', must be one of 'step', 'pi', 'kalman'; did you mean 'kalman'"
    with pytest.raises(InputError, match=said):
        TunerSetUp("kalmann").build(TICK)
