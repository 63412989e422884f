"""The DRFT simulator: one frozen object holds every number, one function makes a step."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.common.errors import InputError
from drftjax.effects import composition as chain
from drftjax.effects.base import AbstractAdjustment, AbstractEffect, StepContext
from drftjax.physics.command import Command
from drftjax.physics.implicit import AbstractBalance, root_of
from drftjax.physics.integrator import ImplicitEuler
from drftjax.physics.plate_sums import sums_over_plates
from drftjax.physics.rig import FreeCarriage, Rig
from drftjax.physics.state import Output, State, slip
from drftjax.physics.stress import PlateMotion, plate_motion
from drftjax.physics.terrain import Terrain
from drftjax.physics.wheel import AbstractWheel, GrouserWheel, Plates

# Time [s] that an observation takes of an instrument that lags: none, but for a division.
INSTANT = 1e-9

# Gravitational acceleration at which zeta is the scaling factor of the stress [m/s2].
EARTH_GRAVITY = 9.81

# Most [-] that a derivative by the velocity may grow by before it shrinks again. Where a plate
# begins to lead the paper's wheel asks for 2 to 4 in a step; folds ask for hundreds.
LARGEST_GROWTH = 6.0

# Speed of the axle over that of the rim [-] below which a wheel turns on the spot.
ON_THE_SPOT = 1e-3


class PlateLoad(eqx.Module):
    """Stress on each plate.

    Attributes:
        plates: Plates turned to the wheel angle.
        motion: Their depth and motion, in the frame of the surface.
        stress_x, stress_z: Force of the sand per plate area [Pa], shape (plates,).
    """

    plates: Plates
    motion: PlateMotion
    stress_x: Float[Array, " plates"]
    stress_z: Float[Array, " plates"]

    def wrenches(self) -> tuple[Float[Array, " plates"], ...]:
        """Force (x, z) of the sand on each plate [N], and the drive torque against it [N m]."""
        force_x, force_z = self.stress_x * self.plates.area, self.stress_z * self.plates.area
        return force_x, force_z, self.plates.x * force_z - self.plates.z * force_x


class Simulator(eqx.Module):
    """Wheel on sand, in a rig. The default is the set-up of Fuke, Ishikawa & Ishigami 2024.

    Attributes:
        wheel: Outline, cut into plates.
        terrain: Stress law and zeta.
        rig: Masses, damping, loads and carriage.
        integrator: How a step finds the velocity at its end.
        effects: Mechanisms beyond the reference model, each in its place, in the order given.
    """

    wheel: AbstractWheel = eqx.field(default_factory=GrouserWheel)
    terrain: Terrain = eqx.field(default_factory=Terrain)
    rig: Rig = eqx.field(default_factory=Rig)
    integrator: ImplicitEuler = eqx.field(default_factory=ImplicitEuler)
    effects: chain.Effects = ()

    def __check_init__(self):
        for effect in self.effects:
            if not isinstance(effect, AbstractEffect):
                raise InputError(f"{effect!r} is not an effect; see drftjax.effects")

    def adjusted(self) -> "Simulator":
        """The same simulator with the numbers that its effects change, these effects left out."""
        simulator = self
        for effect in self.effects:
            if isinstance(effect, AbstractAdjustment):
                simulator = effect.adjust(simulator)
        rest = tuple(e for e in self.effects if not isinstance(e, AbstractAdjustment))
        return dataclasses.replace(simulator, effects=rest)

    def prepared(self) -> "Simulator":
        """The same simulator, adjusted and with its wheel cut: what a loop should step."""
        simulator = self.adjusted()
        return dataclasses.replace(simulator, wheel=simulator.wheel.cut())

    def check(self) -> None:
        """Refuse effects that do not fit this wheel or law, or make its grousers impossible.

        Raises:
            InputError: names the number, and its bounds.
        """
        wheel = self.adjusted().wheel
        if isinstance(wheel, GrouserWheel):
            wheel.check()

    def begin(self, state: State, command: Command) -> State:
        """The true state at a run's start, with a memory for each effect.

        Args:
            state: Position as the instruments read it at rest, and motion.
            command: Command at that time.
        """
        simulator = self.prepared()
        effects = simulator.effects
        if not effects:
            return dataclasses.replace(state, memory=())
        weight = -self.rig.load(jnp.zeros_like(state.velocity))[1]
        position = chain.initial_readings(effects, state.position, weight)
        state = dataclasses.replace(state, position=position)
        state = dataclasses.replace(state, memory=chain.begin(effects, state))
        truth, dt = simulator._truth(state, command)
        memory = chain.begin_reading(effects, state.memory, truth, dt)
        return dataclasses.replace(state, memory=memory)

    def remembered(self, state: State, command: Command) -> State:
        """The state as it is, or by `begin` where it has no memory yet."""
        return state if state.memory else self.begin(state, command)

    def plate_load(
        self,
        position: Float[Array, "2"],
        velocity: Float[Array, "2"],
        angle: Float[Array, ""],
        omega: Float[Array, ""],
        zeta: Float[Array, ""],
        memory: chain.Memories = (),
    ) -> PlateLoad:
        """Stress on every plate of the wheel in this place, at this motion.

        Args:
            position: Axle position (x, z) [m].
            velocity: Axle velocity (x, z) [m/s].
            angle: Wheel angle [rad].
            omega: Angular velocity [rad/s].
            zeta: Scaling factor [-].
            memory: Of the effects; as at a run's start where none is given.
        """
        self = self.prepared()
        if not memory:
            nought = jnp.zeros_like(angle)
            memory = chain.begin(self.effects, State(nought, position, velocity, angle, omega))
        radius = self.wheel.radius
        plates = chain.move_plates(self.effects, self.wheel.cut().plates(angle), angle)
        height_decrease = radius * (radius * omega**2 / self.rig.gravity)
        frame = chain.surface_frame(self.effects, position[0])
        turned, height = frame.plates(plates), frame.distance(position[1] + radius)
        width = self.integrator.rest_speed(radius, self.rig.gravity, omega)
        lead = self.integrator.lead_speed(radius, omega)
        motion = plate_motion(
            turned, height, frame.velocity(velocity), omega, height_decrease, width, radius, lead
        )
        motion = chain.relative_to_surface(self.effects, memory, motion, position[0], turned.x)
        # The sand's strength goes with gravity, so that zeta is a number of the sand.
        strength = zeta * (self.rig.gravity / EARTH_GRAVITY)
        stress = frame.stress_in_space(*self.terrain.law.stress(motion, turned, strength))
        factor = chain.stress_factor(self.effects, motion)
        return PlateLoad(plates, motion, factor * stress[0], factor * stress[1])

    def wrench(
        self,
        position: Float[Array, "2"],
        velocity: Float[Array, "2"],
        angle: Float[Array, ""],
        omega: Float[Array, ""],
        zeta: Float[Array, ""],
        memory: chain.Memories = (),
    ) -> Float[Array, "3"]:
        """The sand's force on the wheel (x, z) [N] and the drive torque against it [N m].

        Arguments as for `plate_load`.
        """
        load = self.plate_load(position, velocity, angle, omega, zeta, memory)
        return jnp.stack(sums_over_plates(load.wrenches()))

    @eqx.filter_jit
    def step(
        self, state: State, command: Command, dt: Float[Array, ""] | float
    ) -> tuple[State, Output]:
        """One implicit step: the velocity at its end balances the forces there.

        Compiled by itself, so that all loops and derivatives of one simulator share its trace.

        Args:
            state: State at the start of the step.
            command: Command at its end.
            dt: Step [s].
        """
        self = self.prepared()
        effects, dt = self.effects, jnp.asarray(dt, state.time.dtype)
        if len(state.memory) != len(effects):
            raise InputError("the state remembers nothing of the effects; start by `begin`")
        omega, memory = chain.wheel_speed(effects, state.memory, command.omega, state.angle, dt)
        time = state.time + dt
        angle = state.angle + dt * (state.omega + omega) / 2
        radius = self.wheel.radius
        moment = StepContext(
            time, dt, state.position, state.velocity, angle, omega, command.omega, radius
        )
        zeta = self.terrain.zeta(time, command) * chain.zeta_factor(effects, memory, moment)
        start = self.rig.carriage.approach(state.velocity, command)
        balance = StepBalance(self, start, state, memory, moment, zeta)
        quasi_static = _guess(state.omega, start, omega, radius)
        guess = self.rig.carriage.approach(quasi_static + dt * state.trend, command)
        velocity, sand, root = root_of(balance, guess, self.integrator.newton)
        velocity = self.rig.carriage.impose(velocity, start)
        grown = jnp.minimum(balance.growth(root.jacobian).max(), balance.largest_growth())
        grown = jax.lax.stop_gradient(jnp.maximum(state.growth * grown, 1))
        after, output = self._moved(state, velocity, sand, memory, moment, zeta)
        # Past a fold of the balance the last velocity itself stays on its branch.
        trend = jnp.where(grown > 1, 0, jax.lax.stop_gradient((velocity - quasi_static) / dt))
        return dataclasses.replace(after, growth=grown, trend=trend), output

    def _moved(
        self,
        state: State,
        velocity: Float[Array, "2"],
        sand: Float[Array, "3"],
        memory: chain.Memories,
        moment: StepContext,
        zeta: Float[Array, ""],
    ) -> tuple[State, Output]:
        """State and reading after a step.

        Args:
            state: State at the start of the step.
            velocity: Velocity (x, z) at its end [m/s].
            sand: Wrench of the sand on the wheel [N, N, N m].
            memory: What the effects remember during it.
            moment: Context of the step.
            zeta: Scaling factor [-].
        """
        # By the mean velocity, which has no error of first order while the wheel speeds up.
        position = state.position + moment.dt * (state.velocity + velocity) / 2
        memory = chain.advance(self.effects, memory, moment)
        after = State(moment.time, position, velocity, moment.angle, moment.omega)
        truth = self._output(after, sand, zeta)
        reading, memory = chain.measure(self.effects, memory, truth, moment.dt)
        return dataclasses.replace(after, memory=memory), reading

    def held(self, state: State, command: Command) -> Float[Array, "2"]:
        """Force (x, z) of the rig and its effects on the wheel [N].

        Args:
            state: Of the wheel; the effects' memories begin with it.
            command: Command at that time.
        """
        self = self.prepared()
        memory, instant = chain.begin(self.effects, state), jnp.full_like(state.time, INSTANT)
        moment = self._moment(state, command, instant)
        place, velocity = state.position, state.velocity
        held = chain.loads(self.effects, memory, place, velocity, moment, of_the_sand=False)
        return self.rig.load(velocity) + held

    def observe(self, state: State, command: Command) -> Output:
        """The output of a state as it stands, without a step: a run's first row."""
        self = self.prepared()
        truth, dt = self._truth(state, command)
        # Between two steps no time passes: a lagging instrument reads what it last held.
        return chain.measure(self.effects, state.memory, truth, dt)[0]

    def _truth(self, state: State, command: Command) -> tuple[Output, Float[Array, ""]]:
        """True output, before any instrument reads it, and the time that a reading takes [s]."""
        effects, memory = self.effects, state.memory
        dt = jnp.full_like(state.time, INSTANT)
        moment = self._moment(state, command, dt)
        zeta = self.terrain.zeta(state.time, command) * chain.zeta_factor(effects, memory, moment)
        place, velocity = state.position, state.velocity
        sand = self.wrench(place, velocity, state.angle, state.omega, zeta, memory)
        piled = chain.loads(effects, memory, place, velocity, moment, of_the_sand=True)
        return self._output(state, sand.at[:2].add(piled), zeta), dt

    def _moment(self, state: State, command: Command, dt: Float[Array, ""]) -> StepContext:
        return StepContext(
            state.time,
            dt,
            state.position,
            state.velocity,
            state.angle,
            state.omega,
            command.omega,
            self.wheel.radius,
        )

    def _output(self, state: State, sand: Float[Array, "3"], zeta: Float[Array, ""]) -> Output:
        x, z = state.position
        vx, vz = state.velocity
        return Output(
            time=state.time,
            x=x,
            z=z,
            vx=vx,
            vz=vz,
            angle=state.angle,
            omega=state.omega,
            fx=sand[0],
            fz=sand[1],
            torque=sand[2],
            slip=slip(self.wheel.radius, state.omega, vx),
            sinkage=-z,
            zeta=zeta,
        )


def _guess(
    before: Float[Array, ""],
    start: Float[Array, "2"],
    omega: Float[Array, ""],
    radius: Float[Array, ""],
) -> Float[Array, "2"]:
    """Velocity (x, z) that the search for the root begins with [m/s].

    Quasi-static motion goes along with the angular velocity; it is doubled at most. A wheel that
    turns on the spot is at a corner of the leading-plate rule, so it is given half its rim's speed.

    Args:
        before, omega: Angular velocity at the step's start and end [rad/s].
        start: Velocity at its start [m/s].
        radius: Rim radius [m].
    """
    turning = before != 0
    growth = jnp.where(turning, jnp.clip(omega / jnp.where(turning, before, 1), 0, 2), 1)
    rim = radius * omega
    spins = jnp.abs(start[0]) < ON_THE_SPOT * jnp.abs(rim)
    along = jnp.where(spins, rim / 2, growth * start[0])
    return jnp.stack([along, growth * start[1]])


class StepBalance(AbstractBalance):
    """Balance of momentum over one step of a simulator.

    Attributes:
        simulator: Prepared, with its wheel cut.
        start: Velocity (x, z) that the step starts from [m/s].
        state: State at the start of the step.
        memory: What the effects remember during it.
        moment: Context of the step.
        zeta: Scaling factor [-].
    """

    simulator: Simulator
    start: Float[Array, "2"]
    state: State
    memory: chain.Memories
    moment: StepContext
    zeta: Float[Array, ""]

    @property
    def force_count(self) -> int:
        return 3  # fx, fz and the torque

    def by_plate(self, velocity: Float[Array, "2"]) -> tuple[Float[Array, " plates"], ...]:
        moment, velocity = self.moment, self._imposed(velocity)
        at = self._position(velocity), velocity, moment.angle, moment.omega
        return self.simulator.plate_load(*at, self.zeta, self.memory).wrenches()

    def of_sums(
        self, velocity: Float[Array, "2"], sums: tuple[Float[Array, ""], ...]
    ) -> tuple[Float[Array, "2"], Float[Array, "3"]]:
        simulator, memory, moment, dt = self.simulator, self.memory, self.moment, self.moment.dt
        velocity = self._imposed(velocity)
        effects, rig, position = simulator.effects, simulator.rig, self._position(velocity)
        piled = chain.loads(effects, memory, position, velocity, moment, of_the_sand=True)
        sand = jnp.stack(sums).at[:2].add(piled)
        held = chain.loads(effects, memory, position, velocity, moment, of_the_sand=False)
        forces = sand[:2] + rig.load(velocity) + held
        return rig.mass() * (velocity - self.start) - dt * forces, sand

    def _imposed(self, velocity: Float[Array, "2"]) -> Float[Array, "2"]:
        # The root does not move along a driven axis, so derivatives by its speed enter here.
        return self.simulator.rig.carriage.impose(velocity, self.start)

    def _position(self, velocity: Float[Array, "2"]) -> Float[Array, "2"]:
        return self.state.position + self.moment.dt * (velocity + self.start) / 2

    def solve(
        self, jacobian: Float[Array, "2 2"], residual: Float[Array, "2"]
    ) -> Float[Array, "2"]:
        still = jnp.zeros_like(residual)
        return self.simulator.rig.carriage.advance(still, residual, jacobian)

    def growth(self, jacobian: Float[Array, "2 2"]) -> Float[Array, "2"]:
        root = jnp.sqrt(self.simulator.rig.mass())
        (a, b), (c, d) = jacobian / root[:, None] / root[None, :]
        if not isinstance(self.simulator.rig.carriage, FreeCarriage):
            return 1 / jnp.abs(jnp.stack([d, d]))
        # Columns of the inverse by the sum of their sizes, a norm: that of products is no larger.
        columns = jnp.stack([jnp.abs(d) + jnp.abs(c), jnp.abs(a) + jnp.abs(b)])
        return columns / jnp.abs(a * d - b * c)

    def largest_growth(self) -> Float[Array, ""]:
        return LARGEST_GROWTH / self.state.growth

    def further_guesses(self) -> Float[Array, "guesses 2"]:
        # A wheel that comes to stand, and one that begins to fall.
        rig = self.simulator.rig
        falling = self.start + self.moment.dt * rig.load(self.start) / rig.mass()
        return jnp.stack([jnp.zeros_like(falling), falling])

    def speed_scale(self) -> Float[Array, ""]:
        return jnp.sqrt(self.simulator.wheel.radius * self.simulator.rig.gravity)

    def size(self, residual: Float[Array, "2"]) -> Float[Array, ""]:
        speed = residual / self.simulator.rig.mass()
        free = isinstance(self.simulator.rig.carriage, FreeCarriage)
        return jnp.hypot(speed[0], speed[1]) if free else jnp.abs(speed[1])
