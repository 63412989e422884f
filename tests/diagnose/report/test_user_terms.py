"""Numbers and remedies in the words of an experimenter."""

import dataclasses

import pytest

from diagnose.report.remedies import KEEP, REMEDIES, remedy
from diagnose.report.user_terms import WORDS, in_user_terms
from diagnose.result import ParameterEstimate
from drftjax.effects.catalogue import catalogue, effect_class, reported_names
from drftjax.setups.setup import read_setup

CASES = {
    "momentum_flux": ({"excess": (6.6, 0.1, "-")}, "lambda 7.70 ± 0.10 instead of 1.1"),
    "horizontal_coulomb": ({"force": (4.0, 0.1, "N")}, "carriage friction 4.00 ± 0.10 N"),
    "wheel_radius": ({"excess": (1e-3, 1e-4, "m")}, "radius 101.00 ± 0.10 mm instead of 100 mm"),
    "travel_gain": ({"gain": (-0.02, 0.001, "-")}, "travel reads 2.00 ± 0.10 % too short"),
    "surface_slope": ({"slope": (0.01, 0.001, "-")}, "the surface rises by 10.0 ± 1.0 mm per m"),
    # No words of its own, and another form: plain names.
    "loosening": ({"loss": (0.3, 0.01, "-")}, "loss = 0.300 ± 0.010"),
    "speed_gain": ({"other": (0.3, 0.01, "-")}, "other = 0.300 ± 0.010"),
}


@pytest.mark.parametrize("name", CASES)
def test_a_number_says_what_it_means_on_the_rig(name):
    numbers, expected = CASES[name]
    estimates = {key: ParameterEstimate(*given) for key, given in numbers.items()}
    setup = read_setup("data/paper.toml")
    setup.wheel.radius = 0.1
    assert in_user_terms(name, estimates, setup).startswith(expected)


def test_every_listed_effect_has_a_remedy_and_no_other_has():
    listed = set(reported_names(tuple(catalogue())))
    # `sand` is the answer `zeta` of a comparison.
    assert listed <= set(REMEDIES) <= listed | {"sand"}
    assert remedy("an_effect_of_the_users_own") == KEEP


@pytest.mark.parametrize("name", WORDS)
def test_words_name_numbers_that_the_effect_has(name):
    fields = {field.name for field in dataclasses.fields(effect_class(name))}
    estimates = {key: ParameterEstimate(0.1, 0.01, "-") for key in fields}
    told = in_user_terms(name, estimates, read_setup("data/paper.toml"))
    assert " = " not in told
