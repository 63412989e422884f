r"""Stress of sand on a moving plate: resistive force theory, quasi-static and dynamic.

$\beta$ is the plate's attack angle, $\gamma$ its intrusion angle (positive downward), $\mathbf n$
its outward normal, $\mathbf p$ its velocity. No angle is computed: with
$\mathbf u = \mathbf p / |\mathbf p|$,

$$\cos\gamma = u_x,\quad \sin\gamma = -u_z,\quad
  c = \cos 2\beta = n_z^2 - n_x^2,\quad s = \sin 2\beta = -2 n_x n_z .$$

Sources: Li, Zhang & Goldman 2013, Science 339:1408 (the law and its coefficients); Agarwal et al.
2021, Science Advances 7:eabe0631 (dynamic terms); Fuke, Ishikawa & Ishigami 2024, ISTVS, eqs. 1,
4, 5, 6 (the form used here, with the effective depth where the paper's eq. 6 prints |z|).
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from drftjax.common.arrays import as_real, require_between
from drftjax.physics.wheel import Plates

NEWTON_PER_CUBIC_CENTIMETRE = 1e6


class PlateMotion(eqx.Module):
    """Depth and motion of the plates, all of shape (plates,) but the last one.

    Attributes:
        depth: Depth below the surface [m], negative above it.
        velocity_x, velocity_z: Plate velocity [m/s].
        direction_x, direction_z: Its direction, fading to zero at rest over a small speed [-].
        normal_speed: Speed along the outward normal [m/s].
        share: Share of its load that the plate carries by the leading-plate rule [-], 0 to 1.
        height_decrease: Loss of height of the sand behind the wheel, r (r omega^2 / g) [m].
        axle_depth: Depth of the axle below the surface over the rim's radius [-]; -1 where the rim
            just touches.
        omega: Angular velocity [rad/s].
        radius: Rim radius [m].
    """

    depth: Float[Array, " plates"]
    velocity_x: Float[Array, " plates"]
    velocity_z: Float[Array, " plates"]
    direction_x: Float[Array, " plates"]
    direction_z: Float[Array, " plates"]
    normal_speed: Float[Array, " plates"]
    share: Float[Array, " plates"]
    height_decrease: Float[Array, ""]
    axle_depth: Float[Array, ""]
    omega: Float[Array, ""]
    radius: Float[Array, ""]


def plate_motion(
    plates: Plates,
    height: Float[Array, ""],
    velocity: Float[Array, "2"],
    omega: Float[Array, ""],
    height_decrease: Float[Array, ""],
    rest_speed: Float[Array, ""] | float,
    radius: Float[Array, ""],
    lead_speed: Float[Array, ""] | float = 0.0,
) -> PlateMotion:
    """Depth and motion of plates on a wheel that translates and turns.

    Args:
        plates: The wheel's plates.
        height: Height of the axle over the undisturbed surface [m].
        velocity: Velocity (x, z) of the axle [m/s].
        omega: Angular velocity, positive driving forward [rad/s].
        height_decrease: See `PlateMotion`.
        rest_speed: Width [m/s] over which direction and leading-plate rule fade in at rest.
        radius: Rim radius [m].
        lead_speed: Speed [m/s] along its normal from which on a plate carries its whole load.
    """
    velocity_x = velocity[0] + omega * plates.z
    velocity_z = velocity[1] - omega * plates.x
    speed = jnp.sqrt(velocity_x**2 + velocity_z**2 + rest_speed**2)
    normal_speed = plates.normal_x * velocity_x + plates.normal_z * velocity_z
    return PlateMotion(
        depth=-(height + plates.z),
        velocity_x=velocity_x,
        velocity_z=velocity_z,
        direction_x=velocity_x / speed,
        direction_z=velocity_z / speed,
        normal_speed=normal_speed,
        # At rest along its normal a plate still carries fully, so that a standing wheel holds; on a
        # rolling one it carries half, so that on the mean plates lead from rest on.
        share=jnp.clip(1 + (normal_speed - lead_speed) / rest_speed, 0, 1),
        height_decrease=height_decrease,
        axle_depth=-height / radius,
        omega=omega,
        radius=radius,
    )


COEFFICIENT_NAMES = ("A00", "A10", "B11", "B01", "B-11", "C11", "C01", "C-11", "D10")


class StressCoefficients(eqx.Module):
    """The nine Fourier coefficients of the stress per depth, in N/cm3.

    Attributes:
        values: In the order of `COEFFICIENT_NAMES` [N/cm3], shape (9,).

    Li et al. 2013 give the generic set, to be scaled by zeta, and sets of their own for loosely
    and closely packed poppy seeds (used with zeta = 1).
    """

    values: Float[Array, "9"]

    def __init__(self, values: ArrayLike):
        require_between("stress coefficients", values, -1e3, 1e3, " N/cm3")
        self.values = as_real(values)

    @classmethod
    def generic(cls) -> "StressCoefficients":
        return cls([0.206, 0.169, 0.212, 0.358, 0.055, -0.124, 0.253, 0.007, 0.088])

    @classmethod
    def loose_poppy_seeds(cls) -> "StressCoefficients":
        return cls([0.051, 0.047, 0.053, 0.083, 0.020, -0.026, 0.057, 0.0, 0.025])

    @classmethod
    def close_poppy_seeds(cls) -> "StressCoefficients":
        return cls([0.094, 0.092, 0.092, 0.151, 0.035, -0.039, 0.086, 0.018, 0.046])

    def __call__(
        self,
        normal_x: Float[Array, "*n"],
        normal_z: Float[Array, "*n"],
        direction_x: Float[Array, "*n"],
        direction_z: Float[Array, "*n"],
    ) -> tuple[Float[Array, "*n"], Float[Array, "*n"]]:
        """alpha_x and alpha_z [N/cm3] of plates with these normals, moving in this direction."""
        a00, a10, b11, b01, bm11, c11, c01, cm11, d10 = self.values
        cosine, sine = direction_x, -direction_z
        c = normal_z**2 - normal_x**2
        s = -2 * normal_x * normal_z
        alpha_z = a00 + a10 * c + (b01 + (b11 + bm11) * c) * sine + (b11 - bm11) * s * cosine
        alpha_x = (c01 + (c11 + cm11) * c) * cosine + (cm11 - c11) * s * sine + d10 * s
        return alpha_x, alpha_z


class AbstractCorners(eqx.Module):
    """Onset of a plate's load: where it enters the sand, begins to lead or passes the axle."""

    @abc.abstractmethod
    def sunk(self, depth: Float[Array, " plates"]) -> Float[Array, " plates"]:
        """Immersion of each plate in the sand [m], given its depth below the surface [m]."""

    @abc.abstractmethod
    def share(self, motion: PlateMotion) -> Float[Array, " plates"]:
        """Share of its load that each plate carries by the leading-plate rule [-]."""

    @abc.abstractmethod
    def past(self, distance: Float[Array, " plates"]) -> Float[Array, " plates"]:
        """1 for plates behind the contact's bisector, by this distance [m], 0 for others [-]."""

    @abc.abstractmethod
    def flux(self, motion: PlateMotion, depth: Float[Array, " plates"]) -> Float[Array, " plates"]:
        """Square of the speed at which plates at this depth [m] push sand ahead [m2/s2]."""


class Sharp(AbstractCorners):
    """Sudden onset, as the model has it."""

    def sunk(self, depth: Float[Array, " plates"]) -> Float[Array, " plates"]:
        return jnp.maximum(depth, 0)

    def share(self, motion: PlateMotion) -> Float[Array, " plates"]:
        return motion.share

    def past(self, distance: Float[Array, " plates"]) -> Float[Array, " plates"]:
        return jnp.where(distance > 0, 1, 0).astype(distance.dtype)

    def flux(self, motion: PlateMotion, depth: Float[Array, " plates"]) -> Float[Array, " plates"]:
        return jnp.where(depth > 0, jnp.maximum(motion.normal_speed, 0) ** 2, 0)


class Rounded(AbstractCorners):
    """Onset over a width each, for searches that follow the slope of a run's derivatives.

    A derivative by a parameter jumps a little at every plate that enters the sand, begins to lead
    or passes below the axle. Its time depends on the profile, and a derivative of
    derivatives does not see the jumps. Over a width, there are none.

    Attributes:
        entry: Depth over which a plate enters the sand [m].
        lead: Speed along its normal over which a plate begins to lead [m/s].
        passage: Distance over which a plate passes below the axle [m].
    """

    entry: float = eqx.field(static=True, default=2e-3)
    lead: float = eqx.field(static=True, default=5e-3)
    passage: float = eqx.field(static=True, default=4e-3)

    def sunk(self, depth: Float[Array, " plates"]) -> Float[Array, " plates"]:
        return _ramp(depth, self.entry)

    def share(self, motion: PlateMotion) -> Float[Array, " plates"]:
        return _step(motion.normal_speed, self.lead)

    def past(self, distance: Float[Array, " plates"]) -> Float[Array, " plates"]:
        return _step(distance, self.passage)

    def flux(self, motion: PlateMotion, depth: Float[Array, " plates"]) -> Float[Array, " plates"]:
        return _step(depth, self.entry) * _ramp(motion.normal_speed, self.lead) ** 2


def _ramp(value: Float[Array, " n"], width: float) -> Float[Array, " n"]:
    """max(value, 0), rounded over a width in its unit."""
    return (value + jnp.sqrt(value**2 + width**2)) / 2


def _step(value: Float[Array, " n"], width: float) -> Float[Array, " n"]:
    """0 below and 1 above zero [-], over a width in the value's unit: the slope of `_ramp`."""
    return (1 + value / jnp.sqrt(value**2 + width**2)) / 2


class AbstractBisector(eqx.Module):
    """Line through the axle that halves the contact with the sand."""

    @abc.abstractmethod
    def past(
        self,
        motion: PlateMotion,
        plates: Plates,
        loss: Float[Array, ""],
        corners: AbstractCorners,
    ) -> Float[Array, " plates"]:
        """1 for plates behind the line, 0 for plates ahead of it [-], shape (plates,).

        Args:
            motion: Of the plates.
            plates: Of the wheel.
            loss: Height [m] that the sand behind the wheel has lost.
            corners: Onset of a plate's passage.
        """


class VerticalBisector(AbstractBisector):
    """The vertical through the axle, whichever way the wheel turns: -x is behind.

    It is the convention of the reference model, for a wheel that drives forward on level ground.
    """

    def past(
        self,
        motion: PlateMotion,
        plates: Plates,
        loss: Float[Array, ""],
        corners: AbstractCorners,
    ) -> Float[Array, " plates"]:
        return corners.past(-plates.x)


class ArcBisector(AbstractBisector):
    r"""Middle of the arc of the rim that truly touches the sand, after Agarwal et al. 2021.

    For an axle at the height $h$ over the sand, the rim enters it at $\arccos(h / r)$ ahead of
    straight down, and leaves the sand behind, which is lower by the loss $\delta_h$, at
    $\arccos((h + \delta_h) / r)$. For a wheel that turns backward it is the mirror image.
    """

    def distance_behind(
        self, motion: PlateMotion, plates: Plates, loss: Float[Array, ""]
    ) -> Float[Array, " plates"]:
        """Distance of each plate behind the line [m], negative ahead; arguments as of `past`."""
        height = -motion.axle_depth
        # A quarter turn from straight down is the farthest that the model covers.
        entry = jnp.arccos(jnp.clip(height, 0, 1))
        leave = jnp.arccos(jnp.clip(height + loss / motion.radius, 0, 1))
        # Plates pass the line suddenly: no derivative goes through its place.
        half = jax.lax.stop_gradient(entry - leave) / 2
        sense = jnp.where(motion.omega < 0, -1, 1)
        return -(sense * plates.x * jnp.cos(half) + plates.z * jnp.sin(half))

    def past(
        self,
        motion: PlateMotion,
        plates: Plates,
        loss: Float[Array, ""],
        corners: AbstractCorners,
    ) -> Float[Array, " plates"]:
        return corners.past(self.distance_behind(motion, plates, loss))


class WeightedBisector(AbstractBisector):
    """Part of the height decrease behind one line, and the rest behind another.

    Attributes:
        first, second: The two lines.
        share: Part of the height decrease that lies behind the second [-].
    """

    first: AbstractBisector
    second: AbstractBisector
    share: Float[Array, ""]

    def past(
        self,
        motion: PlateMotion,
        plates: Plates,
        loss: Float[Array, ""],
        corners: AbstractCorners,
    ) -> Float[Array, " plates"]:
        first = self.first.past(motion, plates, loss, corners)
        second = self.second.past(motion, plates, loss, corners)
        return first + self.share * (second - first)


class AbstractStressLaw(eqx.Module):
    """Stress of sand on plates, as a force per area."""

    @abc.abstractmethod
    def stress(
        self, motion: PlateMotion, plates: Plates, zeta: Float[Array, ""]
    ) -> tuple[Float[Array, " plates"], Float[Array, " plates"]]:
        """Stress (x, z) on each plate [Pa] at scaling factor `zeta` [-]."""


def _depth_stress(
    coefficients: StressCoefficients,
    corners: AbstractCorners,
    motion: PlateMotion,
    plates: Plates,
    depth: Float[Array, " plates"],
    zeta: Float[Array, ""],
) -> tuple[Float[Array, " plates"], Float[Array, " plates"]]:
    """The part of the stress that grows with depth, zeta |z| (-alpha_x, alpha_z)."""
    alpha_x, alpha_z = coefficients(
        plates.normal_x, plates.normal_z, motion.direction_x, motion.direction_z
    )
    scale = NEWTON_PER_CUBIC_CENTIMETRE * zeta * corners.share(motion) * corners.sunk(depth)
    return -scale * alpha_x, scale * alpha_z


class QuasiStatic(AbstractStressLaw):
    """Resistive force theory of Li et al. 2013: stress proportional to depth, free of rate."""

    coefficients: StressCoefficients = eqx.field(default_factory=StressCoefficients.generic)
    corners: AbstractCorners = eqx.field(default_factory=Sharp)

    def stress(
        self, motion: PlateMotion, plates: Plates, zeta: Float[Array, ""]
    ) -> tuple[Float[Array, " plates"], Float[Array, " plates"]]:
        return _depth_stress(self.coefficients, self.corners, motion, plates, motion.depth, zeta)


class Dynamic(AbstractStressLaw):
    r"""Dynamic resistive force theory: momentum flux, and a height decrease behind the wheel.

    $$\mathrm d\mathbf F = \zeta \tilde d\,(-\alpha_x, \alpha_z)\,\mathrm dS
      - \lambda\rho\,(\mathbf n\cdot\mathbf p)^2\,\mathbf n\,\mathrm dS$$

    with $\tilde d = d - \delta_h$ behind the contact's bisector and $\tilde d = d$ ahead of it.

    Attributes:
        inertial_coefficient: lambda [-]; 1.1 in Agarwal et al. 2021.
        bulk_density: rho [kg/m3]; 1490 for the paper's Toyoura sand.
        height_decrease: Share of delta_h = r (r omega^2 / g) that is taken off [-]; 1 in the paper.
        coefficients: Stress per depth.
        corners: Where plates' loads set in.
        bisector: Line that halves the contact.
    """

    inertial_coefficient: Float[Array, ""] = eqx.field(converter=as_real, default=1.1)
    bulk_density: Float[Array, ""] = eqx.field(converter=as_real, default=1490.0)
    height_decrease: Float[Array, ""] = eqx.field(converter=as_real, default=1.0)
    coefficients: StressCoefficients = eqx.field(default_factory=StressCoefficients.generic)
    corners: AbstractCorners = eqx.field(default_factory=Sharp)
    bisector: AbstractBisector = eqx.field(default_factory=VerticalBisector)

    def __check_init__(self):
        # A fit to slow runs leaves lambda free, even of its sign, and its result must still run.
        require_between("inertial coefficient (lambda)", self.inertial_coefficient, -20.0, 100.0)
        hint = " kg/m3"
        require_between("bulk density", self.bulk_density, 100.0, 10000.0, hint)
        require_between("height decrease", self.height_decrease, 0.0, 10.0)

    def stress(
        self, motion: PlateMotion, plates: Plates, zeta: Float[Array, ""]
    ) -> tuple[Float[Array, " plates"], Float[Array, " plates"]]:
        loss = self.height_decrease * motion.height_decrease
        depth = motion.depth - loss * self.bisector.past(motion, plates, loss, self.corners)
        stress_x, stress_z = _depth_stress(
            self.coefficients, self.corners, motion, plates, depth, zeta
        )
        pressure = self.inertial_coefficient * self.bulk_density * self.corners.flux(motion, depth)
        return stress_x - pressure * plates.normal_x, stress_z - pressure * plates.normal_z
