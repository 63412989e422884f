"""The DRFT simulator: one frozen object holds every number, one function makes a step."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.arrays import Real, as_real
from drftjax.command import Command
from drftjax.integrator import AbstractIntegrator, Rosenbrock
from drftjax.rig import Rig
from drftjax.stress import PlateMotion, plate_motion
from drftjax.terrain import Terrain
from drftjax.wheel import AbstractWheel, GrouserWheel, Plates


class State(eqx.Module):
    """What the next step needs.

    Attributes:
        time: Time from the run's start [s].
        position: Axle position (x, z) [m]; z = 0 where the rim just touches the surface.
        velocity: Axle velocity (x, z) [m/s].
        angle: Wheel angle, positive driving forward [rad].
        omega: Angular velocity [rad/s].
    """

    time: Float[Array, ""]
    position: Float[Array, "2"]
    velocity: Float[Array, "2"]
    angle: Float[Array, ""]
    omega: Float[Array, ""]

    @classmethod
    def at_rest(cls, sinkage: Real, x: Real = 0.0, angle: Real = 0.0) -> "State":
        """A standing wheel at this sinkage [m], place x [m] and angle [rad]."""
        depth = as_real(sinkage)
        nought = jnp.zeros((), depth.dtype)
        place = jnp.stack([nought + x, -depth])
        return cls(nought, place, jnp.zeros_like(place), nought + angle, nought)


class Output(eqx.Module):
    """What an observer wants of a step; with a leading time axis, of a run.

    Attributes:
        time: End of the step [s].
        x, z: Axle position [m].
        vx, vz: Axle velocity [m/s].
        angle: Wheel angle [rad].
        omega: Angular velocity [rad/s].
        fx, fz: Force of the sand on the wheel over the step [N].
        torque: Drive torque that balances the sand [N m].
        slip: 1 - vx / (r omega) [-]; 0 where the wheel does not turn.
        sinkage: H = -z [m].
        zeta: Scaling factor used [-].
    """

    time: Float[Array, "*time"]
    x: Float[Array, "*time"]
    z: Float[Array, "*time"]
    vx: Float[Array, "*time"]
    vz: Float[Array, "*time"]
    angle: Float[Array, "*time"]
    omega: Float[Array, "*time"]
    fx: Float[Array, "*time"]
    fz: Float[Array, "*time"]
    torque: Float[Array, "*time"]
    slip: Float[Array, "*time"]
    sinkage: Float[Array, "*time"]
    zeta: Float[Array, "*time"]


class PlateLoad(eqx.Module):
    """Stress on each plate, for figures.

    Attributes:
        plates: Plates turned to the wheel angle.
        motion: Their depth and motion.
        stress_x, stress_z: Force of the sand per plate area [Pa], shape (plates,).
    """

    plates: Plates
    motion: PlateMotion
    stress_x: Float[Array, " plates"]
    stress_z: Float[Array, " plates"]


def slip(
    radius: Float[Array, ""], omega: Float[Array, ""], speed: Float[Array, ""]
) -> Float[Array, ""]:
    r"""Longitudinal slip $s = 1 - v / (r\omega)$ of a driven wheel.

    Args:
        radius: Rim radius [m].
        omega: Angular velocity, positive driving forward [rad/s].
        speed: Carriage speed [m/s].

    Returns:
        Slip ratio [-]; 0 rolls freely, 1 spins on the spot, 0 by convention at omega = 0.
    """
    turning = omega != 0
    return jnp.where(turning, 1 - speed / (radius * jnp.where(turning, omega, 1)), 0)


class Simulator(eqx.Module):
    """Wheel on sand, in a rig. The default is the set-up of Fuke, Ishikawa & Ishigami 2024.

    Attributes:
        wheel: Outline, cut into plates.
        terrain: Stress law and zeta.
        rig: Masses, damping, loads and carriage.
        integrator: How a step linearises the sand's force in the velocity.
    """

    wheel: AbstractWheel = eqx.field(default_factory=GrouserWheel)
    terrain: Terrain = eqx.field(default_factory=Terrain)
    rig: Rig = eqx.field(default_factory=Rig)
    integrator: AbstractIntegrator = eqx.field(default_factory=Rosenbrock)

    def prepared(self) -> "Simulator":
        """The same simulator with its wheel already cut: what a loop should step."""
        return dataclasses.replace(self, wheel=self.wheel.cut())

    def plate_load(
        self,
        position: Float[Array, "2"],
        velocity: Float[Array, "2"],
        angle: Float[Array, ""],
        omega: Float[Array, ""],
        zeta: Float[Array, ""],
        pace: Float[Array, "2"] | None = None,
    ) -> PlateLoad:
        """Stress on every plate of the wheel in this place, at this motion.

        Args:
            position: Axle position (x, z) [m].
            velocity: Axle velocity (x, z) [m/s].
            angle: Wheel angle [rad].
            omega: Angular velocity [rad/s].
            zeta: Scaling factor [-].
            pace: See `plate_motion`; `velocity` where none is given.
        """
        pace = velocity if pace is None else pace
        radius = self.wheel.radius
        plates = self.wheel.cut().plates(angle)
        height_decrease = radius * (radius * omega**2 / self.rig.gravity)
        height = position[1] + radius
        motion = plate_motion(plates, height, velocity, omega, height_decrease, pace)
        stress_x, stress_z = self.terrain.law.stress(motion, plates, zeta)
        return PlateLoad(plates, motion, stress_x, stress_z)

    def wrench(
        self,
        position: Float[Array, "2"],
        velocity: Float[Array, "2"],
        angle: Float[Array, ""],
        omega: Float[Array, ""],
        zeta: Float[Array, ""],
        pace: Float[Array, "2"] | None = None,
    ) -> Float[Array, "3"]:
        """The sand's force on the wheel (x, z) [N] and the drive torque against it [N m].

        Arguments as for `plate_load`.
        """
        load = self.plate_load(position, velocity, angle, omega, zeta, pace)
        force_x = load.stress_x * load.plates.area
        force_z = load.stress_z * load.plates.area
        moment = load.plates.x * force_z - load.plates.z * force_x
        return jnp.stack([force_x.sum(), force_z.sum(), moment.sum()])

    def step(
        self, state: State, command: Command, dt: Float[Array, ""] | float
    ) -> tuple[State, Output]:
        """One linearly implicit step: the force linearised in the velocity, solved once.

        The velocity equation is stiff (the sand's force turns over within `REST_SPEED` of rest),
        so the force is taken with the position moved along; `drftjax.integrator` says how.

        Args:
            state: State at the start of the step.
            command: Command at its end.
            dt: Step [s].
        """
        omega = command.omega
        time = state.time + dt
        angle = state.angle + dt * (state.omega + omega) / 2
        zeta = self.terrain.zeta(time, command)

        def wrench(velocity, pace):
            position = state.position + dt * velocity
            return self.wrench(position, velocity, angle, omega, zeta, pace)

        start = self.rig.carriage.approach(state.velocity, command)
        sand, by_velocity = self.integrator.linearise(wrench, start)
        damping = jnp.stack([self.rig.damping_x, self.rig.damping_z])
        inertia = jnp.diag(self.rig.mass() + dt * damping) - dt * by_velocity[:2]
        impulse = dt * (sand[:2] + self.rig.load(start))
        velocity = self.rig.carriage.advance(start, impulse, inertia)

        # z moves by the velocity that its force was balanced at. x bears on no force, so it may
        # move by the mean, which has no error of first order while the wheel speeds up.
        travel = jnp.stack([(state.velocity[0] + velocity[0]) / 2, velocity[1]])
        position = state.position + dt * travel
        after = State(time, position, velocity, angle, omega)
        return after, self._output(after, sand + by_velocity @ (velocity - start), zeta)

    def observe(self, state: State, command: Command) -> Output:
        """The output of a state as it stands, without a step: a run's first row."""
        zeta = self.terrain.zeta(state.time, command)
        sand = self.wrench(state.position, state.velocity, state.angle, state.omega, zeta)
        return self._output(state, sand, zeta)

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
