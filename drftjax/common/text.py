"""Control characters in text from files, and numbers as text."""

import math


def replace_unprintable(text: str) -> str:
    """Replace control characters, which could steer a terminal or break a line, by U+FFFD."""
    return "".join(each if each.isprintable() else "\ufffd" for each in text)


def value_with_error(value: float, error: float) -> str:
    """Return a number to the digits that its standard error leaves: "0.67 ± 0.10".

    Two digits of the error are shown, and the value to the same place.

    Args:
        value: The number.
        error: Its standard error, in the same unit; zero or not finite says nothing on digits.
    """
    if not (math.isfinite(value) and math.isfinite(error) and error > 0):
        return f"{value:.5g} ± {error:.2g}"
    last = math.floor(math.log10(error)) - 1
    last += round(error / 10.0**last) == 100
    first = max(last + 1, math.floor(math.log10(abs(value))) if value else last)
    if last > -7 and first < 6:
        places = max(-last, 0)
        return f"{round(value, -last):.{places}f} ± {round(error, -last):.{places}f}"
    scale, digits = 10.0**first, first - last
    return f"({value / scale:.{digits}f} ± {error / scale:.{digits}f})e{first:+03d}"
