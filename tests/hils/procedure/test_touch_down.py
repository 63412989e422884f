"""The wheel held where it touches the sand: how long its height is watched, and what is refused."""

import pytest

from drftjax.common.errors import InputError
from hils.procedure.settling import DEFAULT_TOUCHDOWN, TouchdownSettings, touch_down
from tests.helpers.protocol_variants import HELLO, OtherRig, Table

# The virtual clock goes on by grains of a millisecond.
GRAIN = 2e-3


def watched(each: float, settings: TouchdownSettings = DEFAULT_TOUCHDOWN) -> float:
    """How long touch-down takes with a rig whose readings come so far apart [s]."""

    class Rig(OtherRig):
        def advance(self, now: float, data: bytes) -> bytes:
            if self.session and not data and now - self.told < each:
                return b""
            return super().advance(now, data)

    table = Table(Rig())
    ack = table.session.connect(HELLO)
    begun = table.clock.now()
    zero = touch_down(table.session, table.link, table.clock, ack, settings)
    assert zero.z == -1760
    return table.clock.now() - begun


def test_readings_of_a_rig_at_rest_are_averaged_over_half_a_second():
    assert watched(0.02) == pytest.approx(DEFAULT_TOUCHDOWN.averaging_time, abs=GRAIN)


def test_a_busy_host_waits_until_as_many_came_as_it_needs():
    each = 0.1
    assert watched(each) == pytest.approx(DEFAULT_TOUCHDOWN.min_readings * each, abs=each)


def test_a_rig_that_measures_too_seldom_is_refused():
    with pytest.raises(InputError) as refused:
        watched(0.4)
    assert f"came in {DEFAULT_TOUCHDOWN.longest_time:g} s" in str(refused.value)
    assert f"needs {DEFAULT_TOUCHDOWN.min_readings}" in str(refused.value)


def test_the_average_lasts_as_long_as_it_is_set():
    assert watched(0.02, TouchdownSettings(averaging_time=1.0)) == pytest.approx(1.0, abs=GRAIN)
    with pytest.raises(InputError, match=r"came in 0\.1 s"):
        watched(0.02, TouchdownSettings(longest_time=0.1))
