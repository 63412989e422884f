"""What ripple the tuner of eq. 7 makes by itself, and what the grousers make; coarse and short."""

import numpy as np
import pytest

from hils.experiment.spectrum import SpectralLine, spectrum
from tests.studies.closed_loop import INTERVAL, Setting, Traces, run

DURATION, SETTLED = 26.0, 12.0
# Far longer than the study's, which change the ripple's frequency by a third, not its kind.
COARSE = 8e-3
RINGING = Setting(tick=0.002, tolerance=0.0)
# Two lines of a record of 14 s are told apart from here on [Hz].
APART = 0.15
# Within its dead band eq. 7 lets zeta stand for seconds: what is left of a line is a fifth of the
# band of 0.1 mm, and less than one step of zeta.
QUIET_SINKAGE, QUIET_ZETA = 2e-5, 1e-3
# Swinging, it goes to and fro by many steps a swing, and the sinkage by several times that rest.
SWINGS_ZETA, SWINGS_SINKAGE = 5e-3, 4e-5
# Coarse plates change the swing's frequency by up to a third of itself, at twice the speed by less.
SWINGS, SAME_SWING = (1.2, 3.0), 0.25


def strongest(values: np.ndarray) -> SpectralLine:
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
        assert strongest(made.z_sim[0] - made.z_real[0]).amplitude < QUIET_SINKAGE
        assert strongest(made.zeta[0]).amplitude < QUIET_ZETA


def test_without_a_dead_band_it_swings_by_itself(bare, grousers):
    for made in (bare, grousers):
        line = strongest(made.z_sim[1] - made.z_real[1])
        assert SWINGS[0] < line.frequency < SWINGS[1]
        assert line.amplitude > SWINGS_SINKAGE
        assert spectrum(made.zeta[1], INTERVAL).at(line.frequency) > SWINGS_ZETA


def test_with_grousers_the_swing_is_in_the_simulation_and_not_in_the_rig(grousers):
    def between_orders(values: np.ndarray) -> float:
        """Ripple from 1.2 to 2.8 Hz that the grousers' 1, 2 and 3 Hz have no part in."""
        found = spectrum(values, INTERVAL)
        near = np.abs(found.frequency - 2.0)
        return float(np.linalg.norm(found.amplitude[(near > 2 * APART) & (near < 0.8)]))

    assert between_orders(grousers.z_sim[1]) > 5 * between_orders(grousers.z_real[1])


def test_the_swing_does_not_go_with_the_wheel_s_speed(bare):
    fast, slow = (strongest(bare.z_sim[n] - bare.z_real[n]).frequency for n in (1, 2))
    assert slow / fast == pytest.approx(1, abs=SAME_SWING)


def test_grousers_out_of_step_give_eq_7_their_own_frequency(grousers):
    line = strongest(grousers.zeta[2])
    assert line.frequency == pytest.approx(1.0, abs=APART / 3)
    # Ten steps of zeta and more; in step with them, a hundredth of that.
    assert line.amplitude > 0.01
    assert spectrum(grousers.zeta[0], INTERVAL).at(1.0) < 0.02 * line.amplitude
