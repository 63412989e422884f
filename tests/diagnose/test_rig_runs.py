"""Runs of one rig have one wheel: what counts as the same."""

import pytest

from diagnose.rig_runs import describe_rig
from drftjax.setups.setup import CommandSetUp, SetUp, WheelSetUp

SQUARE = [(0.1, 0.1), (-0.1, 0.1), (-0.1, -0.1), (0.1, -0.1)]
WHEELS = {
    "grousers": WheelSetUp(),
    "grousers on a third": WheelSetUp(grouser_fraction=1 / 3),
    "plain": WheelSetUp(shape="plain"),
    "square": WheelSetUp(shape="outline", radius=0.1, points=SQUARE),
    "another square": WheelSetUp(
        shape="outline", radius=0.1, points=[(1.01 * x, y) for x, y in SQUARE]
    ),
}


def kind(wheel: WheelSetUp) -> str:
    return describe_rig(SetUp(command=CommandSetUp([0.0, 1.0], [0.0, 0.0]), wheel=wheel))


def test_wheels_of_other_shapes_are_other_wheels():
    assert len({kind(each) for each in WHEELS.values()}) == len(WHEELS)


@pytest.mark.parametrize("name", list(WHEELS))
def test_a_wheel_is_the_same_however_it_is_cut(name):
    wheel = WHEELS[name]
    points = None if wheel.points is None else [(x + 1e-8, y) for x, y in wheel.points]
    again = WheelSetUp(
        shape=wheel.shape,
        radius=wheel.radius,
        grouser_fraction=wheel.grouser_fraction,
        points=points,
        plate_size=0.01,
    )
    assert kind(again) == kind(wheel)
