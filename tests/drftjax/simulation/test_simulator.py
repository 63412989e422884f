"""The wheel in its rig: rest, falling, rolling, towing, driven slip, and energy."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.physics.command import Command, command_at
from drftjax.physics.implicit import NewtonSettings
from drftjax.physics.integrator import DEFAULT_STEP, ImplicitEuler
from drftjax.physics.rig import DrivenCarriage, Rig
from drftjax.physics.state import State
from drftjax.physics.stress import QuasiStatic
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.physics.wheel import GrouserWheel, PlainWheel
from drftjax.runlog.record import RecordedCommand
from drftjax.setups.setup import CommandSetUp, RigSetUp, SetUp, WheelSetUp
from drftjax.simulation.simulator import LARGEST_GROWTH, Simulator
from drftjax.simulation.statics import DEFAULT_STATICS, REST, sinkage_under_load
from drftjax.simulation.trial import Trial
from tests.helpers.shared_program import whole_run
from tests.studies.runs import profile

# A wheel that stands where the sand at rest carries it goes no farther than that depth is known.
NO_CREEP = DEFAULT_STATICS.tolerance
# Elsewhere the sand gives way no faster than the width at rest [m/s], but for its tails: a plate at
# twice that speed still lacks a tenth of its direction.
REST_SPEED = 5e-7 * math.sqrt(0.150 * 9.81)
CREEP = 2 * REST_SPEED
# A steady quasi-static state does not know time; what is left is the ripple's inertia.
RATE_INDEPENDENCE = 2e-3
# A bare rim with nothing to pull rolls with the slip that its own resistance asks for.
FREE_ROLLING_SLIP = 0.02
# Mean forces over whole grouser passages of a wheel of 19 kg whose mean speed is steady: to under a
# millimetre a second over four seconds.
STEADY_FORCE = 5e-3
# Sums of doubles of some 100 W.
ENERGY_ROUNDING = 1e-9
# Dropped from 50 mm over the sand; where both integrators go with ever finer steps, and how near.
LANDING_DEPTH, LANDING = 49.5e-3, 0.3e-3
# A thousandth of the weight moves a wheel by 0.06 um in a step. Where plates turn over the search
# may end that far from a root; else it ends within rounding.
BALANCE = 1e-3
# A landed wheel is eased up by its rest force at most at REST_SPEED.
NO_BOUNCE = 5e-5
# A linearly implicit step falls g t dt / 2 short of the parabola.
FALL = 1.1
# The same step on c v = m g (1 - e^(-c t / m)) is late by c dt / 2 m at first, 5.3e-4; twice that.
TERMINAL = 1e-3
# A bare rim at one speed has no ripple: held at it, it goes on as it did, but for the tolerance of
# the search for each step's root, which is a tenth of the usual one here.
SAME_MOTION = 1e-8
# A few doubles of order one, and a sum of 12,000 of them.
ROUNDING, SUM_ROUNDING = 1e-15, 1e-12

MASS_Z, GRAVITY = 18.837, 9.81
PITCH = 2 * math.pi / 12
REST_DEPTH = float(sinkage_under_load(Simulator(), 0.7823, descent=REST))


def drive(simulator, duration, omega, start=None, vx=0.0, step=DEFAULT_STEP, interval=0.01):
    """Rows of a wheel that turns at omega [rad/s] from the first step on."""
    start = State.at_rest(0.025) if start is None else start
    command = RecordedCommand([0.0, duration], [omega, omega], [vx, vx])
    whole = whole_run(Trial.of(simulator, start, command, step, interval))
    return jax.tree.map(lambda values: values[1:], whole)


def passages(rows, omega, count=2):
    """Indices of the last `count` whole grouser passages."""
    row = float(rows.time[1] - rows.time[0])
    return slice(-round(count * PITCH / omega / row), None)


def test_wheel_at_its_rest_depth_does_not_creep_in_a_minute():
    simulator = Simulator()
    rows = drive(simulator, 60.0, 0.0, State.at_rest(REST_DEPTH), step=1e-3, interval=0.1)
    assert float(jnp.max(jnp.abs(rows.z + REST_DEPTH))) < NO_CREEP
    assert float(jnp.max(jnp.abs(rows.x))) < NO_CREEP
    assert float(rows.fz[-1]) == pytest.approx(MASS_Z * GRAVITY, rel=ENERGY_ROUNDING)


def test_deeper_wheel_is_not_pushed_up():
    rows = drive(Simulator(), 10.0, 0.0, State.at_rest(REST_DEPTH + 0.005))
    # As far as the regulariser lets it go in that time.
    assert float(rows.z[-1] + REST_DEPTH + 0.005) < 10.0 * REST_SPEED
    assert float(jnp.max(rows.vz)) < CREEP


def test_shallower_wheel_creeps_down_no_faster_than_the_regulariser_allows():
    # At 17.6 mm sand at rest carries 42 % of the load: the wheel keeps intruding, slowly.
    rows = drive(Simulator(), 2.0, 0.0, State.at_rest(0.0176))
    settled = rows.vz[np.asarray(rows.time) > 0.1]
    assert float(jnp.max(settled)) <= 0
    assert float(jnp.min(settled)) > -CREEP


def test_lifted_wheel_falls_freely_until_it_touches():
    start = State.at_rest(-0.100)
    rows = drive(Simulator(), 0.12, 0.0, start, step=1e-4, interval=1e-3)
    in_air = rows.z > 0.018
    fallen = 0.5 * GRAVITY * rows.time**2
    late = FALL * 0.5 * GRAVITY * rows.time * 1e-4
    assert int(jnp.sum(in_air)) > 100
    assert bool(jnp.all(jnp.abs(0.100 - fallen - rows.z)[in_air] <= late[in_air]))
    assert float(jnp.max(jnp.abs(rows.fz[in_air]))) == 0


def test_dropped_wheel_comes_to_rest_where_it_lands():
    # At longer steps a fall ends in chatter: docs/theory/integrator.md has the table.
    rows = drive(Simulator(), 1.0, 0.0, State.at_rest(-0.050), step=1e-4)
    landed = int(jnp.argmin(rows.z))
    # A fall of 50 mm takes 0.10 s, and of 100 mm 0.14; in the sand it takes longer.
    assert 0.1 < float(rows.time[landed]) < 0.2
    assert -float(rows.z[landed]) == pytest.approx(LANDING_DEPTH, abs=LANDING)
    assert float(rows.z[-1] - rows.z[landed]) < NO_BOUNCE
    assert float(jnp.max(rows.vz)) < CREEP


@pytest.mark.parametrize("wheel", [GrouserWheel(), PlainWheel()], ids=["grousers", "plain"])
def test_quasi_static_speed_is_proportional_to_omega_at_the_same_sinkage(wheel):
    simulator = Simulator(wheel=wheel, terrain=Terrain(law=QuasiStatic()))
    speeds, depths = [], []
    for degrees in (5.0, 10.0, 20.0):
        omega = math.radians(degrees)
        start = State.at_rest(0.030 if isinstance(wheel, GrouserWheel) else 0.040)
        rows = drive(simulator, 150 / degrees, omega, start, interval=0.005)
        last = passages(rows, omega)
        speeds.append(float(jnp.mean(rows.vx[last])) / omega)
        depths.append(float(jnp.mean(rows.sinkage[last])))
    np.testing.assert_allclose(speeds, speeds[0], rtol=RATE_INDEPENDENCE)
    np.testing.assert_allclose(depths, depths[0], rtol=RATE_INDEPENDENCE)


def test_a_small_bare_rim_speeds_up_as_with_far_shorter_plates():
    rig = RigSetUp(mass_x=1.47, mass_z=1.66)
    command = CommandSetUp([0.0, 2.0, 7.0, 12.0], [0.0, 0.0, 1.0, 1.0])

    def rows(plate_size):
        wheel = WheelSetUp("plain", 0.0545, 0.045, plate_size=plate_size)
        setup = SetUp(command, wheel=wheel, rig=rig)
        setup.start.sinkage = float(sinkage_under_load(setup.trial().simulator, 0.75))
        return whole_run(setup.trial(interval=0.1))

    fine = rows(0.0001)
    usual, coarse = (
        float(jnp.sqrt(jnp.mean((each.z - fine.z) ** 2))) for each in (rows(None), rows(0.004))
    )
    # The error is of first order in the plates' length, 0.36 and 4 mm; the larger would pass for an
    # effect [m].
    assert coarse > 100e-6
    assert usual < coarse / 5


def test_dynamic_terms_make_a_fast_wheel_differ():
    # What the test above would miss if rate never entered: at 300 deg/s it does.
    omega = math.radians(300.0)
    rows = drive(Simulator(), 3.0, omega, interval=0.002)
    slow = drive(Simulator(terrain=Terrain(law=QuasiStatic())), 3.0, omega, interval=0.002)
    last = passages(rows, omega, 6)
    # Ten times what that allows.
    apart = abs(float(jnp.mean(rows.vx[last] - slow.vx[last])))
    assert apart > 10 * RATE_INDEPENDENCE * 0.150 * omega


def test_free_rolling_wheel_has_near_zero_slip():
    # On firm sand, where sinkage and so resistance are small.
    firm = Simulator(wheel=PlainWheel(), terrain=Terrain(ConstantZeta(20.0)))
    rows = drive(firm, 4.0, 0.5, State.at_rest(0.003))
    assert abs(float(jnp.mean(rows.slip[-100:]))) < FREE_ROLLING_SLIP


def test_forces_balance_the_load_and_the_tow_when_rolling_is_steady():
    omega = math.radians(30.0)
    last = None
    slips = []
    for tow in (-20.0, 0.0, 20.0, 40.0):
        simulator = Simulator(rig=Rig(drawbar_load=tow))
        # Every step is a row: a mean of forces must not skip any.
        rows = drive(simulator, 8.0, omega, interval=DEFAULT_STEP)
        last = passages(rows, omega, 4)
        assert float(jnp.mean(rows.fx[last])) == pytest.approx(tow, abs=STEADY_FORCE)
        assert float(jnp.mean(rows.fz[last])) == pytest.approx(MASS_Z * GRAVITY, abs=STEADY_FORCE)
        slips.append(float(jnp.mean(rows.slip[last])))
    assert slips == sorted(slips)
    # A third of the weight more to tow costs a tenth of the way at the very least.
    assert slips[-1] > slips[0] + 0.1


@pytest.mark.parametrize("share", [0.0, 3e-5, -3e-4, 3e-3, -0.03, 0.1])
@pytest.mark.parametrize("wheel", [GrouserWheel(), PlainWheel()], ids=["grousers", "plain"])
def test_every_step_of_a_wheel_that_is_pulled_aside_as_it_settles_balances_its_momentum(
    wheel, share
):
    weight = MASS_Z * GRAVITY
    simulator = Simulator(wheel=wheel, rig=Rig(drawbar_load=share * weight))
    # It begins far above its rest depth, sinks, and stands.
    rows = drive(simulator, 1.0, 0.0, State.at_rest(0.010), interval=DEFAULT_STEP)
    velocity = np.stack([rows.vx, rows.vz])
    before = np.concatenate([np.zeros((2, 1)), velocity[:, :-1]], axis=1)
    force = np.stack([rows.fx - share * weight, rows.fz - weight])
    gained = (
        np.array([[float(simulator.rig.mass_x)], [MASS_Z]]) * (velocity - before) / DEFAULT_STEP
    )
    assert float(np.abs(gained - force).max()) < BALANCE * weight


def test_driven_carriage_imposes_the_speed_and_pulls_more_at_more_slip():
    omega = math.radians(30.0)
    pulls = []
    for slip in (0.0, 0.2, 0.5):
        vx = 0.150 * omega * (1 - slip)
        simulator = Simulator(rig=Rig(carriage=DrivenCarriage()))
        rows = drive(simulator, 6.0, omega, vx=vx)
        np.testing.assert_allclose(rows.vx, vx, rtol=ROUNDING)
        np.testing.assert_allclose(rows.slip, slip, rtol=0, atol=ROUNDING)
        # The carriage starts from rest, and over its first step travels at the mean speed.
        assert float(rows.x[-1]) == pytest.approx((6.0 - DEFAULT_STEP / 2) * vx, rel=SUM_ROUNDING)
        pulls.append(float(jnp.mean(rows.fx[passages(rows, omega, 4)])))
    assert pulls == sorted(pulls)
    # At half the way it pulls more than a quarter of its weight.
    assert pulls[-1] > MASS_Z * GRAVITY / 4


def test_driven_carriage_at_its_own_steady_speed_needs_no_force():
    omega = math.radians(30.0)
    exact = ImplicitEuler(newton=NewtonSettings(tolerance=1e-9))
    rolling = Simulator(wheel=PlainWheel(), integrator=exact)
    free = drive(rolling, 10.0, omega, State.at_rest(0.04))
    speed = float(jnp.mean(free.vx[-200:]))
    held = dataclasses.replace(rolling, rig=Rig(carriage=DrivenCarriage()))
    rows = drive(held, 10.0, omega, State.at_rest(0.04), vx=speed)
    assert float(jnp.mean(rows.fx[-200:])) == pytest.approx(0.0, abs=STEADY_FORCE)
    assert float(rows.z[-1]) == pytest.approx(float(free.z[-1]), abs=SAME_MOTION)


def test_damping_slows_a_falling_wheel_to_its_terminal_speed():
    # m_z dv/dt = -m_z g - c_z v, in the air.
    simulator = Simulator(rig=Rig(damping_z=200.0))
    rows = drive(simulator, 0.5, 0.0, State.at_rest(-2.0), step=1e-4)
    expected = -MASS_Z * GRAVITY / 200.0 * (1 - jnp.exp(-rows.time * 200.0 / MASS_Z))
    np.testing.assert_allclose(rows.vz, expected, rtol=TERMINAL)


def test_damping_along_x_asks_for_the_pull_that_overcomes_it():
    omega = math.radians(30.0)
    simulator = Simulator(rig=Rig(damping_x=200.0))
    rows = drive(simulator, 8.0, omega, interval=DEFAULT_STEP)
    last = passages(rows, omega, 4)
    pull, speed = float(jnp.mean(rows.fx[last])), float(jnp.mean(rows.vx[last]))
    assert pull == pytest.approx(200.0 * speed, abs=STEADY_FORCE)
    # It rolls with a slip of under a tenth.
    assert pull > 0.9 * 200.0 * 0.150 * omega


def test_drive_power_is_what_the_sand_dissipates_and_the_axle_takes():
    # torque omega = F . v + dissipation holds plate by plate, at any instant; sand only takes.
    simulator = Simulator()
    rows = profile().rows(DEFAULT_STEP, 0.05)
    moving = (np.asarray(rows.omega) > 0.1)[:-1]

    def balance(x, z, vx, vz, angle, omega):
        at = (
            jnp.stack([x, z]),
            jnp.stack([vx, vz]),
            angle,
            omega,
            jnp.asarray(0.7823),
        )
        load = simulator.plate_load(*at)
        force = simulator.wrench(*at)
        power = load.stress_x * load.motion.velocity_x + load.stress_z * load.motion.velocity_z
        dissipated = -jnp.sum(power * load.plates.area)
        return force[2] * omega - (force[0] * vx + force[1] * vz), dissipated

    kinds = (rows.x, rows.z, rows.vx, rows.vz, rows.angle, rows.omega)
    spent, dissipated = jax.jit(jax.vmap(balance))(*kinds)
    np.testing.assert_allclose(spent, dissipated, rtol=0, atol=ENERGY_ROUNDING)
    assert float(jnp.min(dissipated)) >= 0
    assert float(jnp.mean(dissipated[:-1][moving])) > 1.0


def test_steady_drive_power_is_the_tow_power_and_what_the_sand_dissipates():
    omega, tow = math.radians(30.0), 20.0
    simulator = Simulator(rig=Rig(drawbar_load=tow))
    rows = drive(simulator, 8.0, omega, interval=DEFAULT_STEP)
    last = passages(rows, omega, 4)
    power = float(jnp.mean(rows.torque[last])) * omega
    towing = tow * float(jnp.mean(rows.vx[last]))
    assert power > towing > 0


@pytest.mark.parametrize("speed", [0.0, 0.3])
def test_command_is_linear_between_its_samples(speed):
    knots = jnp.array([0.0, 1.0])
    commands = command_at(jnp.array([0.25, 2.0]), knots, jnp.array([0.0, 0.4]), speed * knots)
    np.testing.assert_allclose(commands.omega, [0.1, 0.4], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(commands.vx, [0.25 * speed, speed], rtol=0, atol=ROUNDING)


def test_derivatives_by_the_velocity_grow_by_no_more_than_is_believed():
    """Over any steps in a row, by the steps' own derivatives: a light wheel, far too stiff sand."""
    wheel, terrain = GrouserWheel(plate_size=0.005), Terrain(ConstantZeta(25.0))
    simulator = Simulator(wheel, terrain, Rig(mass_x=1.4, mass_z=2.0)).prepared()
    root, dt = jnp.sqrt(simulator.rig.mass()), 5e-3

    def step(state, omega):
        command = Command(omega, jnp.zeros(()), jnp.zeros(()))

        def velocity(start):
            after, _ = simulator.step(dataclasses.replace(state, velocity=start), command, dt)
            return after.velocity, after

        slope, after = jax.jacfwd(velocity, has_aux=True)(state.velocity)
        return after, (root[:, None] * slope / root[None, :], after.growth)

    omega = jnp.asarray(8.0 * np.clip(np.arange(1600) / 800, 0, 1))
    _, (slopes, told) = jax.jit(lambda start: jax.lax.scan(step, start, omega))(
        State.at_rest(0.0003)
    )
    norms = np.abs(slopes).sum(axis=1).max(axis=1)
    grown, largest = 1.0, []
    for norm in norms:
        grown = max(1.0, grown * norm)
        largest.append(grown)
    # A start's velocity also moves the place by half a step of it, which the bound leaves out.
    assert max(largest) <= LARGEST_GROWTH * 1.01
    assert max(largest) > 2, "there are steps that ask for more than is believed"
    assert 2 < float(told.max()) <= LARGEST_GROWTH * (1 + ROUNDING)
