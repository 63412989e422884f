"""The virtual rig: its physics, instruments and firmware in one, in explicit time."""

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.physics.command import Command
from drftjax.physics.integrator import DEFAULT_STEP
from drftjax.physics.rig import Rig
from drftjax.physics.state import State
from drftjax.setups.setup import WheelSetUp
from drftjax.setups.terrain_setup import DynamicTerrain
from drftjax.simulation.rollout import simulate
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.statics import sinkage_under_load
from hils.link.link import LinkLost
from hils.link.messages import (
    VIRTUAL_RIG,
    Arm,
    Bye,
    Drive,
    Hello,
    HelloAck,
    Measurement,
    Reason,
    RigState,
    Stop,
)
from hils.rig_sim.config import BedSetUp, VirtualSetUp, read_virtual_setup
from hils.rig_sim.faults import (
    Disconnect,
    DriveFault,
    Fault,
    FaultScript,
    FlippedBytes,
    LostFrames,
    Reset,
    SaturatedDrive,
    ScaleJump,
    StuckScale,
    Window,
)
from hils.rig_sim.in_process import QUICK, SoftRig, rig_physics, soft_rig
from hils.rig_sim.physics import DEFAULT_LOWERING, REST, MotorDemand
from hils.rig_sim.rig import RigFault
from hils.rig_sim.sensors import Instruments, RigClock, SensorNoise

DATA = Path(__file__).resolve().parents[3] / "data"
TICK = 0.01
FULL_SPEED = math.radians(30.0)
# What coarse plates and steps cost, docs/results/speed.md: plates of 8 mm stand within 0.2 mm.
COARSE = 0.2e-3
SCALE = Instruments()
# The wheel, let down in 1.5 s, has still to sink by a hundredth of a millimetre, at less than a
# tenth of a millimetre a second.
LET_DOWN = 0.1e-3
# The same operations, compiled in two ways.
COMPILED_APART = 1e-12
# A speed on the wire is a single.
SINGLE = 1e-7
# A free wheel's speed ripples by some per cent as its grousers pass, and it slips by one.
RIPPLE = 0.05
# Readings of angular velocity scatter by 1e-3 rad/s; four times that.
OMEGA = 4 * SCALE.omega_noise


def quick(**numbers) -> VirtualSetUp:
    return VirtualSetUp(physics=QUICK, **numbers)


def opened(
    setup: VirtualSetUp | None = None, *faults: Fault, seed: int = 0, **line: float
) -> SoftRig:
    """A rig that has answered HELLO."""
    soft = soft_rig(setup, FaultScript(faults, seed=1), seed, **line)
    soft.link.begin(7)
    soft.link.send(Hello(round(TICK * 1e6), 100))
    soft.clock.sleep_until(soft.clock.now() + 0.1)
    return soft


def drive(soft: SoftRig, seconds: float, omega: float = 0.0, vx: float | None = None) -> list:
    """Commands each tick; the measurement at each tick's end."""
    begun, read = soft.clock.now(), []
    for number in range(1, round(seconds / TICK) + 1):
        soft.link.send(Drive(omega, vx or 0.0, vx is not None, 100))
        soft.clock.sleep_until(begun + number * TICK)
        read.append(measured(soft))
    return read


def measured(soft: SoftRig) -> Measurement:
    arrival = soft.link.newest()
    assert arrival is not None
    assert isinstance(arrival.frame.message, Measurement)
    return arrival.frame.message


def settled(setup: VirtualSetUp | None = None, *faults: Fault, **line: float) -> SoftRig:
    """A rig whose wheel has been let down."""
    soft = opened(setup, *faults, **line)
    soft.link.send(Arm())
    drive(soft, DEFAULT_LOWERING.time + 0.1)
    return soft


# Physics ---------------------------------------------------------------------------------------


def test_wheel_let_down_stands_where_statics_says():
    physics = rig_physics(quick())
    simulator = quick().simulator()
    packed = physics.held()
    assert physics.motion(packed).z == 0.0
    packed = physics.advance(packed, round(DEFAULT_LOWERING.time / physics.step), REST, REST, True)
    stands = -physics.motion(packed).z
    assert stands == pytest.approx(float(sinkage_under_load(simulator, 0.7823)), abs=LET_DOWN)
    assert abs(physics.motion(packed).vz) < LET_DOWN


def test_block_of_steps_is_the_simulator():
    """Two blocks, driven evenly from one demand to the next, are as many single steps."""
    physics, setup = rig_physics(quick()), quick()
    packed = physics.held()
    demands = [REST, MotorDemand(0.2, 0.0, False), MotorDemand(0.5, 0.0, False)]
    for start, end in pairwise(demands):
        packed = physics.advance(packed, 50, start, end)
    omega = np.concatenate([np.linspace(0, 0.2, 51)[1:], np.linspace(0.2, 0.5, 51)[1:]])
    still = jnp.zeros(100)
    # Neither demand drives the carriage.
    sim = replace(setup.simulator(), rig=Rig())
    state, _ = simulate(sim, State.at_rest(0.0), Command(jnp.asarray(omega), still, still), 1e-3)
    assert physics.motion(packed).z == pytest.approx(float(state.position[1]), abs=COMPILED_APART)
    assert physics.motion(packed).x == pytest.approx(float(state.position[0]), abs=COMPILED_APART)


def test_driven_carriage_has_the_speed_it_is_given_and_a_free_one_finds_its_own():
    free = settled()
    drive(free, 3.0, FULL_SPEED)
    own = free.rig.motion.vx
    assert own == pytest.approx(0.15 * FULL_SPEED, rel=RIPPLE)
    driven = settled()
    drive(driven, 3.0, FULL_SPEED, 0.5 * own)
    assert driven.rig.motion.vx == pytest.approx(0.5 * own, rel=SINGLE)
    assert driven.rig.motion.fx > free.rig.motion.fx + 1.0  # the sand pushes what slips


def test_a_driven_carriage_of_a_rig_with_a_gain_is_faster_than_it_is_told():
    fast = settled(quick(effects=[{"name": "carriage_gain", "gain": 0.03}]))
    drive(fast, 1.0, FULL_SPEED, 0.05)
    assert fast.rig.motion.vx == pytest.approx(1.03 * 0.05, rel=SINGLE)


def test_paper_profile_sinks_as_the_reference_says():
    soft = settled()
    drive(soft, 4.0, FULL_SPEED)
    read = drive(soft, 3.0, FULL_SPEED)
    mean = np.mean([each.z for each in read]) * SCALE.z_scale
    # shared/model.md: mean z over 10-17 s is -29.9 mm.
    assert mean == pytest.approx(-29.9e-3, abs=COARSE)


def test_effects_of_the_file_act():
    loosening = {"name": "loosening", "loss": 0.3, "decay": 0.3}
    plain, loose = settled(), settled(quick(effects=[loosening]))
    deeper = drive(plain, 2.0, FULL_SPEED)[-1].z - drive(loose, 2.0, FULL_SPEED)[-1].z
    # A zeta that is 0.2 lower by then, at 25 mm of sinkage a zeta, less what it has still to sink.
    assert deeper * SCALE.z_scale > 3e-3


def test_physics_is_finer_than_the_loop_own():
    setup = VirtualSetUp()
    ours = Simulator(WheelSetUp().build())
    # Plates half as long, and a step of less than half the default.
    assert len(setup.simulator().prepared().wheel.plates(jnp.zeros(())).x) > 1.8 * len(
        ours.prepared().wheel.plates(jnp.zeros(())).x
    )
    assert setup.physics.step < DEFAULT_STEP / 2


# From touch-down to the end ---------------------------------------------------------------------


def test_wheel_hangs_at_touch_down_until_it_is_armed():
    soft = opened()
    soft.clock.sleep_until(soft.clock.now() + 5.0)
    assert soft.rig.is_held
    assert soft.rig.motion.z == 0.0
    assert abs(measured(soft).z * SCALE.z_scale) < 6 * SCALE.z_noise
    soft.link.send(Drive(FULL_SPEED, 0.0, False, 100))
    soft.clock.sleep_until(soft.clock.now() + 0.5)
    assert soft.rig.motion.omega == 0.0
    soft.link.send(Arm())
    drive(soft, 0.2)
    assert not soft.rig.is_held
    # Let down, it is on its way to 16 mm.
    assert soft.rig.motion.z < -5e-3


def test_next_session_finds_the_bed_prepared_anew():
    setup = quick(bed=BedSetUp(scatter=0.05))
    soft = settled(setup)
    first = drive(soft, 1.0, FULL_SPEED)[-1].z
    drive(soft, 0.5)
    soft.link.send(Bye())
    soft.link.begin(8)
    soft.link.send(Hello(round(TICK * 1e6), 100))
    soft.clock.sleep_until(soft.clock.now() + 0.1)
    assert soft.rig.is_held
    assert abs(measured(soft).z * SCALE.z_scale) < 6 * SCALE.z_noise
    soft.link.send(Arm())
    drive(soft, DEFAULT_LOWERING.time + 0.1)
    again = drive(soft, 1.0, FULL_SPEED)[-1].z
    # Beds that scatter by 5 % of zeta, 1 mm of sinkage: another one, and no other rig.
    assert 0.3e-3 < abs(first - again) * SCALE.z_scale < 10e-3


def test_watchdog_counts_from_the_last_command():
    soft = settled()
    drive(soft, 0.5, FULL_SPEED)
    last = soft.clock.now() - TICK
    soft.clock.sleep_until(soft.clock.now() + 0.5)
    change = soft.rig.changes[-1]
    assert (change.state, change.reason) == (RigState.SAFE, Reason.WATCHDOG)
    assert change.time - last <= 5 * TICK + TICK
    assert soft.rig.motion.omega == 0.0


# Instruments, clock and wire --------------------------------------------------------------------


def test_reading_is_counts_of_the_truth_with_the_noise_given():
    soft = settled()
    z = np.asarray([each.z for each in drive(soft, 5.0)]) * SCALE.z_scale
    spread = np.std(np.diff(z)) / math.sqrt(2)  # the wheel creeps by less
    expected = math.hypot(SCALE.z_noise, SCALE.z_scale / math.sqrt(12))
    # Differences tell it to sqrt(3 / (4 n)); four times that.
    assert spread == pytest.approx(expected, rel=4 * math.sqrt(0.75 / len(z)))


def test_noise_is_the_same_whoever_asks_and_how_often():
    times = np.arange(0.0, 4.0, 0.001)
    one, other = SensorNoise(5), SensorNoise(5)
    often = np.asarray([one.at(t) for t in times])
    seldom = np.asarray([other.at(t) for t in times[::7]])
    assert np.array_equal(often[::7], seldom)
    assert not np.array_equal(often[0], SensorNoise(6).at(0.0))
    # Four standard deviations of one of so many numbers.
    assert np.std(often) == pytest.approx(1, abs=4 / math.sqrt(2 * often.size))


def test_rig_clock_runs_on_its_own_and_wraps():
    clock = RigClock(skew=1e-3, ahead=2**32 * 1e-6 - 0.5)
    soft = opened(quick(clock=clock))
    begun = soft.clock.now() - 0.1
    stamps = {}
    for _ in range(10):
        soft.clock.sleep_until(soft.clock.now() + 0.1)
        arrival = soft.link.newest()
        assert arrival is not None
        stamps[arrival.time] = arrival.frame.t_us
    values = list(stamps.values())
    assert values[0] > values[-1]  # it wrapped, and measurements counted on
    for time, stamp in stamps.items():
        own = clock.ahead + (time - begun) * 1.001
        away = (stamp - own * 1e6 + 2**31) % 2**32 - 2**31
        assert abs(away) <= 10_000  # a measurement is no older than one tick


def test_boot_numbers_and_identity():
    ack = opened().link.reports()[0].frame.message
    assert isinstance(ack, HelloAck)
    assert (ack.rig_id, ack.z_scale) == (VIRTUAL_RIG, pytest.approx(SCALE.z_scale))
    other = opened(seed=1).link.reports()[0].frame.message
    assert isinstance(other, HelloAck)
    assert ack.boot_id != other.boot_id


@pytest.mark.parametrize(("baud", "latency"), [(115200, 0.0), (115200, 0.001), (115200, 0.016)])
def test_readings_come_as_late_as_wire_and_adapter_make_them(baud, latency):
    soft = opened(baud=baud, latency=latency)
    soft.link.send(Arm())
    begun, late = soft.clock.now(), []
    for number in range(200):
        seq = soft.link.send(Drive(0.0, 0.0, False, 100))
        sent = soft.clock.now()
        while measured(soft).ack_seq != seq and soft.clock.now() < sent + 0.1:
            soft.clock.sleep_until(soft.clock.now() + 0.001)
        late.append(soft.clock.now() - sent)
        soft.clock.sleep_until(begun + (number + 1) * 0.04)
    wire = (31 + 39) * 10 / baud
    assert wire <= min(late)
    # A look each millisecond, and a measurement of its own may be on the wire before.
    assert max(late) <= wire + 39 * 10 / baud + latency + 0.0021


def test_same_seed_gives_the_same_run_to_the_bit():
    def run(seed: int) -> list:
        armed = Window("arm", 0.1)
        faults = Fault(FlippedBytes(rate=0.003), armed), Fault(LostFrames(rate=0.1), armed)
        soft = opened(None, *faults, seed=seed)
        soft.link.send(Arm())
        return drive(soft, 1.0, 0.1)

    assert run(3) == run(3)
    assert run(3) != run(4)


# Faults -----------------------------------------------------------------------------------------


def test_plug_pulled_loses_the_link_and_the_rig_goes_safe_by_itself():
    soft = settled(None, Fault(Disconnect(), Window("motion", 0.5)))
    with pytest.raises(LinkLost, match="plug"):
        drive(soft, 1.0, FULL_SPEED)
    soft.rig.advance_unplugged(soft.clock.now() + 0.5)
    assert soft.rig.state is RigState.SAFE
    assert soft.rig.motion.omega == 0.0


def test_reset_gives_a_new_boot_number_and_stands_still():
    soft = settled(None, Fault(Reset(), Window("motion", 0.5, 0.2)))
    drive(soft, 1.5, FULL_SPEED)
    stranger = soft.link.quality().foreign_state
    assert soft.rig.state is RigState.IDLE
    assert soft.rig.motion.omega == 0.0
    assert stranger is not None
    assert stranger.boot_id != opened().link.reports()[0].frame.message.boot_id  # pyright: ignore


def test_stuck_and_absurd_scales():
    soft = settled(None, Fault(StuckScale("z"), Window("motion", 0.5)))
    z = [each.z for each in drive(soft, 2.0, FULL_SPEED)]
    assert len(set(z[60:])) == 1
    assert len(set(z[:40])) > 10
    soft = settled(None, Fault(ScaleJump("z", counts=100_000), Window("motion", 0.5)))
    z = [each.z for each in drive(soft, 1.0, FULL_SPEED)]
    assert min(map(abs, z[60:])) > 90_000
    assert max(map(abs, z[:40])) < 10_000


def test_saturated_drive_turns_slower_and_says_so():
    soft = settled(None, Fault(SaturatedDrive(0.1), Window("motion", 0.5)))
    read = drive(soft, 1.5, FULL_SPEED)
    assert read[40].omega == pytest.approx(FULL_SPEED, abs=OMEGA)
    assert read[-1].omega == pytest.approx(0.1, abs=OMEGA)
    assert soft.rig.motion.omega == pytest.approx(0.1)


def test_drive_fault_stands_still_until_power_up():
    soft = settled(None, Fault(DriveFault(7), Window("motion", 0.5, 0.1)))
    read = drive(soft, 1.0, FULL_SPEED)
    assert (read[-1].state, read[-1].fault) == (RigState.FAULT, 7)
    assert soft.rig.motion.omega == 0.0


def test_wheel_that_sinks_to_its_end_stop_is_a_fault():
    soft = opened(quick(terrain=DynamicTerrain(zeta=0.02)))
    soft.link.send(Arm())
    read = drive(soft, 3.0)
    assert (read[-1].state, read[-1].fault) == (RigState.FAULT, RigFault.END_STOP)


def test_stop_ramps_to_rest_and_stays_armed():
    soft = settled()
    drive(soft, 1.0, FULL_SPEED)
    soft.link.send(Stop())
    drive(soft, 0.3)
    assert soft.rig.state is RigState.ARMED
    assert soft.rig.motion.omega == 0.0
    assert set(soft.rig.occasions) == {"power", "hello", "arm", "motion", "stop"}


# Its file ---------------------------------------------------------------------------------------

FILE = """
title = "a rig whose sand loosens"
[terrain]
zeta = 0.8
[physics]
step = 1e-3
plate_size = 0.008
[instruments]
z_scale = 5e-6
[limits]
omega_max = 1.0
[clock]
skew = 1e-4
[[effect]]
name = "loosening"
loss = 0.1
"""


def test_file_of_a_virtual_rig(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(FILE)
    setup = read_virtual_setup(path)
    assert (setup.instruments.z_scale, setup.limits.omega_max) == (5e-6, 1.0)
    assert len(setup.simulator().effects) == 1
    ack = opened(setup).link.reports()[0].frame.message
    assert isinstance(ack, HelloAck)
    assert (ack.omega_max, ack.z_scale) == (1.0, pytest.approx(5e-6))


def test_set_up_of_a_run_serves_as_it_is():
    setup = read_virtual_setup(DATA / "paper.toml")
    assert setup.simulator().wheel.rim_plates > setup.wheel.build().rim_plates


@pytest.mark.parametrize("wheel", ["shape = 'plain'", "radius = 0.05\ngrouser_height = 0.005"])
def test_a_rig_has_shorter_plates_than_its_loop_on_any_wheel(tmp_path, wheel):
    path = tmp_path / "rig.toml"
    path.write_text(f"[wheel]\n{wheel}\n")
    setup = read_virtual_setup(path)
    assert setup.simulator().wheel.rim_plates > 1.5 * setup.wheel.build().rim_plates


def test_example_file_is_a_rig_whose_sand_loosens():
    setup = read_virtual_setup(DATA / "virtual_rig.toml")
    assert [each["name"] for each in setup.effects] == ["loosening"]
    like_default = (setup.physics.step, setup.instruments, setup.limits)
    default = VirtualSetUp()
    assert like_default == (default.physics.step, default.instruments, default.limits)
    assert setup.simulator().wheel.rim_plates == default.simulator().wheel.rim_plates
    assert setup.clock.ahead == pytest.approx(default.clock.ahead)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[instruments]\nz_scale = 0", ["z_scale is 0", "m a count"]),
        ("[instruments]\nx_scale = -1", ["x_scale is -1", "or be 0"]),
        ("[physics]\nstep = 1", ["physics step is 1"]),
        ("[limits]\nomega_max = -1", ["omega_max is -1"]),
        ("[bed]\nscater = 0.1", ["'scater'", "scatter"]),
        ('[[effect]]\nname = "sponge"', ["'sponge'"]),
        ("[clock]\nskew = 2", ["clock skew is 2"]),
    ],
)
def test_wrong_files_are_refused_in_one_sentence(tmp_path, text, words):
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_virtual_setup(path)
    assert all(word in str(error.value) for word in [str(path), *words]), error.value
