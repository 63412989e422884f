"""Numbers of an effect in the words of an experimenter: "lambda 7.7 instead of 1.1"."""

import math
from collections.abc import Callable, Mapping

from diagnose.report.model_writer import estimate_in_words
from diagnose.result import ParameterEstimate
from drftjax.common.text import value_with_error
from drftjax.setups.setup import SetUp

Numbers = Mapping[str, ParameterEstimate]
Words = Callable[[Numbers, SetUp], str]


def in_user_terms(name: str, numbers: Numbers, setup: SetUp) -> str:
    """Numbers of an effect as what they say of the rig.

    Args:
        name: Reported name of the effect.
        numbers: Its numbers by field.
        setup: Set-up of one of the runs, for what was believed.

    Returns:
        One clause; every number with its name, value, error and unit where no other words are
        known.
    """
    words = WORDS.get(name)
    try:
        return words(numbers, setup) if words is not None else _plain(numbers)
    except KeyError:  # another form of the effect has other numbers
        return _plain(numbers)


def _plain(numbers: Numbers) -> str:
    return ", ".join(f"{key} = {estimate_in_words(each)}" for key, each in numbers.items())


def _scaled(each: ParameterEstimate, factor: float, offset: float = 0.0) -> str:
    return value_with_error(offset + factor * each.value, abs(factor) * each.error)


def _percent(key: str, thing: str, more: str, less: str) -> Words:
    def words(numbers: Numbers, setup: SetUp) -> str:
        each = numbers[key]
        size = value_with_error(100 * abs(each.value), 100 * each.error)
        return f"{thing} {size} % too {more if each.value > 0 else less}"

    return words


def _size(key: str, what: str, unit: str, factor: float = 1.0) -> Words:
    def words(numbers: Numbers, setup: SetUp) -> str:
        return f"{what} {_scaled(numbers[key], factor)} {unit}"

    return words


def _lambda(numbers: Numbers, setup: SetUp) -> str:
    believed = float(getattr(setup.terrain, "inertial_coefficient", 0.0))
    return f"lambda {_scaled(numbers['excess'], 1.0, believed)} instead of {believed:g}"


def _height_decrease(numbers: Numbers, setup: SetUp) -> str:
    believed = float(getattr(setup.terrain, "height_decrease", 0.0))
    found = _scaled(numbers["excess"], 1.0, believed)
    return f"height decrease behind the wheel {found} times the theory's, instead of {believed:g}"


def _radius(numbers: Numbers, setup: SetUp) -> str:
    believed = 1e3 * setup.wheel.radius
    return f"radius {_scaled(numbers['excess'], 1e3, believed)} mm instead of {believed:g} mm"


def _grousers(numbers: Numbers, setup: SetUp) -> str:
    believed = 1e3 * setup.wheel.grouser_height
    return f"grousers {_scaled(numbers['excess'], 1e3, believed)} mm high, not {believed:g} mm"


WORDS: Mapping[str, Words] = {
    "momentum_flux": _lambda,
    "height_decrease": _height_decrease,
    "wheel_radius": _radius,
    "grouser_height": _grousers,
    "speed_gain": _percent("gain", "the wheel turns", "fast", "slowly"),
    "carriage_gain": _percent("gain", "the carriage runs", "fast", "slowly"),
    "sinkage_gain": _percent("gain", "sinkage reads", "deep", "shallow"),
    "travel_gain": _percent("gain", "travel reads", "long", "short"),
    "torque_gain": _percent("gain", "torque reads", "high", "low"),
    "speed_lag": _size("lag", "the wheel's speed follows with a lag of", "s"),
    "backlash": _size("play", "play of the drive", "deg", math.degrees(1.0)),
    "surface_slope": _size("slope", "the surface rises by", "mm per m of travel", 1e3),
    "vertical_load": _size("force", "further load downward of", "N"),
    "vertical_coulomb": _size("force", "friction of the vertical guide", "N"),
    "vertical_viscous": _size("damping", "damping of the vertical guide", "N s/m"),
    "horizontal_coulomb": _size("force", "carriage friction", "N"),
    "horizontal_viscous": _size("damping", "carriage damping", "N s/m"),
    "drawbar": _size("force", "pull against the travel of", "N"),
    "cable_spring": _size("stiffness", "the cable pulls back with", "N per m of travel"),
    "vertical_spring": _size("stiffness", "the guide pushes up with", "N per mm of sinkage", 1e-3),
    "vertical_compliance": _size("compliance", "the frame gives", "mm per N", 1e3),
    "torque_friction": _size("friction", "friction of the bearing", "N m"),
    "measurement_delay": _size("delay", "readings are late by", "s"),
    "measurement_filter": _size("lag", "readings are filtered with a lag of", "s"),
    "channel_delay": _size("delay", "one channel is late by", "s"),
    "sinkage_drift": _size("rate", "the height reading drifts by", "mm/s", 1e3),
}
