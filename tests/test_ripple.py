"""What ripple the tuner of eq. 7 makes by itself, and what the grousers make; coarse and short."""

import numpy as np
import pytest

from hils.spectrum import Line, spectrum
from tests.studies.closed_loop import INTERVAL, Setting, Traces, run

DURATION, SETTLED = 26.0, 12.0
# Far longer than the study's, which change the ripple's frequency by a third, not its kind.
COARSE = 8e-3
RINGING = Setting(tick=0.002, tolerance=0.0)
# Two lines of a record of 14 s are told apart from here on [Hz].
APART = 0.15


def strongest(values: np.ndarray) -> Line:
    return spectrum(values, INTERVAL).lines(1)[0]


@pytest.fixture(scope="module")
def bare() -> Traces:
    """A bare rim: quiet by the dead band, without one, and without one at half the speed."""
    slow = RINGING._replace(omega=RINGING.omega / 2)
    settings = [Setting(), RINGING, slow]
    return run(settings, DURATION, grousers=False, plate=COARSE).steady(SETTLED)


@pytest.fixture(scope="module")
def grousers() -> Traces:
    """The same with grousers: quiet, ringing, and quiet but for grousers that are half apart."""
    settings = [Setting(), RINGING, Setting(angle=float(np.radians(15.0)))]
    return run(settings, DURATION, plate=COARSE).steady(SETTLED)


def test_the_dead_band_keeps_the_tuner_quiet(bare, grousers):
    for made in (bare, grousers):
        assert strongest(made.z_sim[0] - made.z_real[0]).amplitude < 2e-5
        assert strongest(made.zeta[0]).amplitude < 1e-3


def test_without_a_dead_band_it_swings_by_itself(bare, grousers):
    for made in (bare, grousers):
        line = strongest(made.z_sim[1] - made.z_real[1])
        assert 1.2 < line.frequency < 3.0
        assert line.amplitude > 4e-5
        assert spectrum(made.zeta[1], INTERVAL).at(line.frequency) > 5e-3


def test_with_grousers_the_swing_is_in_the_simulation_and_not_in_the_rig(grousers):
    def between_orders(values: np.ndarray) -> float:
        """Ripple from 1.2 to 2.8 Hz that the grousers' 1, 2 and 3 Hz have no part in."""
        found = spectrum(values, INTERVAL)
        near = np.abs(found.frequency - 2.0)
        return float(np.linalg.norm(found.amplitude[(near > 2 * APART) & (near < 0.8)]))

    assert between_orders(grousers.z_sim[1]) > 5 * between_orders(grousers.z_real[1])


def test_the_swing_does_not_go_with_the_wheel_s_speed(bare):
    fast, slow = (strongest(bare.z_sim[n] - bare.z_real[n]).frequency for n in (1, 2))
    assert 0.75 < slow / fast < 1.25


def test_grousers_out_of_step_give_eq_7_their_own_frequency(grousers):
    line = strongest(grousers.zeta[2])
    assert line.frequency == pytest.approx(1.0, abs=0.05)
    assert line.amplitude > 0.01
    assert spectrum(grousers.zeta[0], INTERVAL).at(1.0) < 0.1 * line.amplitude
