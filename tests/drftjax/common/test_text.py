"""Numbers as text."""

import math
from decimal import Decimal

import numpy as np
import pytest

from drftjax.common.text import value_with_error


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.66994, 0.1, "0.67 ± 0.10"),
        (0.66994, 0.0999, "0.67 ± 0.10"),
        (1e-5, 0.035, "0.000 ± 0.035"),
        (-3.5, 0.41, "-3.50 ± 0.41"),
        (15234.0, 1200.0, "15200 ± 1200"),
        (3.2e-9, 4e-11, "(3.200 ± 0.040)e-09"),
        (1.234567e7, 3e5, "(1.235 ± 0.030)e+07"),
        (0.5, math.inf, "0.5 ± inf"),
        (0.5, 0.0, "0.5 ± 0"),
        (math.nan, 0.1, "nan ± 0.1"),
    ],
)
def test_digits_follow_the_error(value, error, text):
    assert value_with_error(value, error) == text


def test_value_and_error_end_at_one_place_and_are_rounded_by_less_than_a_tenth_of_the_error():
    random = np.random.default_rng(0)
    for value, size in zip(random.normal(size=300), random.uniform(-6, 3, 300), strict=True):
        number = value * 10 ** random.uniform(-6, 6)
        error = 10.0**size
        text = value_with_error(number, error)
        power = 1.0
        if text.startswith("("):
            text, exponent = text[1:].split(")e")
            power = 10.0 ** int(exponent)
        shown, by = (Decimal(part) for part in text.split(" ± "))
        assert shown.as_tuple().exponent == by.as_tuple().exponent
        # Half of the last of two digits is a twentieth of the error at most.
        assert abs(float(shown) * power - number) <= 0.0501 * error
        assert abs(float(by) * power - error) <= 0.0501 * error
