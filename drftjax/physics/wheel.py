"""Wheels as closed outlines in the x-z plane, cut into plates.

Positions are relative to the axle, x forward and z up; a wheel angle phi > 0 turns the wheel
forward, so that the lowest point moves backward. `docs/theory/model.md` has the picture.
"""

import abc
import math

import equinox as eqx
import jax
import jax.core as jax_core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.common.arrays import Real, as_real, require_between

# A single-wheel test bed's wheel in metres; anything outside is a slip of units (150 for 0.150).
SMALLEST_RADIUS, LARGEST_RADIUS = 0.005, 2.0


UNIT_HINT = " (lengths are in metres)"


DEFAULT_PLATE_SIZE = 0.004


# Of a bare rim. Its plates do not turn, so the edge of those that lead jumps from one to the next
# and stays there, where turning ones average out. With plates of 4 mm a healthy rig is off by up to
# 0.15 mm in z while its wheel speeds up.
PLAIN_PLATE_SIZE = 0.001


DEFAULT_REACH = math.pi / 2


# A length that is a whole number of plates but for rounding [plates]: files differ in last digits.
ROUNDING = 1e-9


# Single-precision numbers in the widest vectors of a processor.
LANES = 16


def plate_count(length: float, plate_size: float) -> int:
    """Number of plates of at most this size [m] that cut a length [m]."""
    return math.ceil(length / plate_size - ROUNDING)


class Plates(eqx.Module):
    """Flat plates of a wheel's surface, already turned to the wheel's angle.

    Attributes:
        x, z: Plate centres relative to the axle [m], shape (plates,).
        normal_x, normal_z: Outward unit normals [-], shape (plates,).
        area: Length times wheel width [m2], shape (plates,).
    """

    x: Float[Array, " plates"]
    z: Float[Array, " plates"]
    normal_x: Float[Array, " plates"]
    normal_z: Float[Array, " plates"]
    area: Float[Array, " plates"]


class AbstractWheel(eqx.Module):
    """A rigid wheel: an outline that can be cut into plates.

    Attributes:
        radius: Rim radius, the datum of sinkage [m].
    """

    radius: eqx.AbstractVar[Float[Array, ""]]

    @abc.abstractmethod
    def cut(self) -> "AbstractCut":
        """The outline cut into plates: done once, before a run."""


class AbstractCut(AbstractWheel):
    """A wheel already cut into plates, ready to be turned.

    Attributes:
        sinkage_limit: Sinkage up to which every plate below the surface is carried [m].
    """

    sinkage_limit: eqx.AbstractVar[Float[Array, ""]]

    @abc.abstractmethod
    def plates(self, angle: Float[Array, ""]) -> Plates:
        """Plates of the wheel standing at `angle` [rad]."""


class StillCut(AbstractCut):
    """Plates of a wheel that is the same at every angle, and need not turn."""

    radius: Float[Array, ""]
    sinkage_limit: Float[Array, ""]
    outline: Plates

    def cut(self) -> AbstractCut:
        return self

    def plates(self, angle: Float[Array, ""]) -> Plates:
        del angle
        return self.outline


class TurningCut(AbstractCut):
    """Plates that turn with the wheel.

    The outline repeats every `pitch`: it is turned by what is left of the angle after whole
    pitches, so that only plates near the sand need be carried.
    """

    radius: Float[Array, ""]
    sinkage_limit: Float[Array, ""]
    outline: Plates
    pitch: float = eqx.field(static=True)

    def cut(self) -> AbstractCut:
        return self

    def plates(self, angle: Float[Array, ""]) -> Plates:
        return turn(self.outline, angle - self.pitch * jnp.round(angle / self.pitch))


def fill_vectors(plates: Plates) -> Plates:
    """`plates` and copies of the last, of no area, up to a number that fills a CPU's vectors.

    What is left over is computed plate by plate, for a fifth of the time of all.
    """
    more = -plates.x.shape[0] % LANES
    filled = jax.tree.map(lambda each: jnp.pad(each, (0, more), mode="edge"), plates)
    nought = jnp.pad(plates.area, (0, more))
    return Plates(filled.x, filled.z, filled.normal_x, filled.normal_z, nought)


def turn(plates: Plates, angle: Float[Array, ""]) -> Plates:
    """`plates` turned forward by `angle` [rad] about the axle."""
    sine, cosine = jnp.sin(angle), jnp.cos(angle)
    return Plates(
        plates.x * cosine + plates.z * sine,
        plates.z * cosine - plates.x * sine,
        plates.normal_x * cosine + plates.normal_z * sine,
        plates.normal_z * cosine - plates.normal_x * sine,
        plates.area,
    )


def _check_rim(radius: Real, width: Real) -> None:
    require_between("wheel radius", radius, SMALLEST_RADIUS, LARGEST_RADIUS, UNIT_HINT)
    require_between("wheel width", width, SMALLEST_RADIUS, LARGEST_RADIUS, UNIT_HINT)


def _check_cut(radius: Real, plate_size: float, reach: float) -> None:
    require_between("plate size", plate_size, 1e-5, float(radius), UNIT_HINT)
    require_between("reach", reach, 0.1, math.pi, " rad")


def _check_grousers(which: str, radius: Real, count: int, height: Real, thickness: Real) -> None:
    require_between(f"{which}grouser height", height, 0.0, float(radius), UNIT_HINT)
    require_between(
        f"{which}grouser thickness",
        thickness,
        0.0,
        0.999 * (2 * math.pi / count) * float(radius),
        f", the pitch of {count} grousers on a rim of {float(radius):g} m",
    )


def _midpoints(count: int, dtype) -> Float[Array, " count"]:
    return jnp.asarray((np.arange(count) + 0.5) / count, dtype)


class PlainWheel(AbstractWheel):
    """A bare rim. Its plates do not turn with it, so that it rolls without ripple.

    Attributes:
        radius, width: Rim radius and wheel width [m].
        rim_plates: Number of plates over the reach.
        reach: Angle from straight down to the outermost plate on either side [rad].
    """

    radius: Float[Array, ""]
    width: Float[Array, ""]
    rim_plates: int = eqx.field(static=True)
    reach: float = eqx.field(static=True)

    def __init__(
        self,
        radius: Real = 0.150,
        width: Real = 0.120,
        *,
        plate_size: float = PLAIN_PLATE_SIZE,
        reach: float = DEFAULT_REACH,
    ):
        _check_rim(radius, width)
        _check_cut(radius, plate_size, reach)
        self.radius = as_real(radius)
        self.width = as_real(width)
        # An even number, so that none lies where a rolling rim is at rest.
        self.rim_plates = 2 * plate_count(reach * float(radius), plate_size)
        self.reach = reach

    def cut(self) -> AbstractCut:
        place = (2 * _midpoints(self.rim_plates, self.radius.dtype) - 1) * self.reach
        sine, cosine = jnp.sin(place), jnp.cos(place)
        area = self.radius * self.width * (2 * self.reach / self.rim_plates)
        outline = Plates(
            self.radius * sine,
            -self.radius * cosine,
            sine,
            -cosine,
            jnp.broadcast_to(area, place.shape),
        )
        limit = self.radius * (1 - math.cos(self.reach))
        return StillCut(self.radius, limit, fill_vectors(outline))


class GrouserWheel(AbstractWheel):
    """A rim with straight radial grousers: rim plates between them, tips and both side faces.

    The geometry repeats at every grouser, so only the sectors within `reach` of straight down
    are carried, turned by what is left of the wheel angle after whole pitches.

    Defaults are Table 1 of Fuke, Ishikawa & Ishigami 2024.

    Attributes:
        radius: Rim radius, without grousers [m].
        width: Wheel width [m].
        grouser_height, grouser_thickness: Radial height and tangential thickness [m].
        grouser_fraction: Effective share of the grouser height [-]; 1 is the true geometry, 1/3
            is the shadowing rule of Agarwal et al. 2021.
        grouser_shadow: Inner share of the effective height whose faces carry nothing, as the sand
            between grousers moves with the wheel [-].
        grouser_count: Number of grousers.
        rim_plates, tip_plates, side_plates: Plates on each rim piece, tip and side face.
        reach: Angle from straight down within which every plate is carried [rad].
    """

    radius: Float[Array, ""]
    width: Float[Array, ""]
    grouser_height: Float[Array, ""]
    grouser_thickness: Float[Array, ""]
    grouser_fraction: Float[Array, ""]
    grouser_shadow: Float[Array, ""]
    grouser_count: int = eqx.field(static=True)
    rim_plates: int = eqx.field(static=True)
    tip_plates: int = eqx.field(static=True)
    side_plates: int = eqx.field(static=True)
    reach: float = eqx.field(static=True)

    def __init__(
        self,
        radius: Real = 0.150,
        width: Real = 0.120,
        grouser_count: int = 12,
        grouser_height: Real = 0.018,
        grouser_thickness: Real = 0.009,
        grouser_fraction: Real = 1.0,
        *,
        grouser_shadow: Real = 0.0,
        plate_size: float = DEFAULT_PLATE_SIZE,
        reach: float = DEFAULT_REACH,
    ):
        _check_rim(radius, width)
        require_between("grouser count", grouser_count, 1, 1000, " (PlainWheel has none)")
        _check_grousers("", radius, grouser_count, grouser_height, grouser_thickness)
        require_between("grouser fraction", grouser_fraction, 0.0, 2.0)
        require_between("grouser shadow", grouser_shadow, 0.0, 1.0)
        _check_cut(radius, plate_size, reach)
        self.radius = as_real(radius)
        self.width = as_real(width)
        self.grouser_height = as_real(grouser_height)
        self.grouser_thickness = as_real(grouser_thickness)
        self.grouser_fraction = as_real(grouser_fraction)
        self.grouser_shadow = as_real(grouser_shadow)
        self.grouser_count = int(grouser_count)
        gap = self._pitch * float(radius) - float(grouser_thickness)
        self.rim_plates = plate_count(gap, plate_size)
        self.tip_plates = max(1, plate_count(float(grouser_thickness), plate_size))
        self.side_plates = max(1, plate_count(float(grouser_height), plate_size))
        self.reach = reach

    def check(self) -> None:
        """Refuse impossible grousers, as effects may make them; traced numbers pass.

        Raises:
            InputError: names the length, and its bounds.
        """
        radius, height, thickness = self.radius, self.grouser_height, self.grouser_thickness
        if any(isinstance(each, jax_core.Tracer) for each in (radius, height, thickness)):
            return
        # A rounding below none is none.
        height = max(float(height), 0.0)
        _check_grousers("the true ", radius, self.grouser_count, height, thickness)

    @property
    def _pitch(self) -> float:
        return 2 * math.pi / self.grouser_count

    @property
    def _sectors(self) -> tuple[int, ...]:
        """Grousers, counted from straight down, that come within reach at some wheel angle."""
        half = math.ceil(self.reach / self._pitch - ROUNDING)
        if 2 * half + 1 >= self.grouser_count:
            return tuple(range(self.grouser_count))
        return tuple(range(-half, half + 1))

    def _sector(self) -> Plates:
        """One grouser that points straight down, and the rim half a pitch to either side."""
        dtype = self.radius.dtype
        half_thickness = self.grouser_thickness / 2
        height = self.grouser_fraction * self.grouser_height
        start = half_thickness / self.radius
        span = self._pitch - 2 * start
        place = start + _midpoints(self.rim_plates, dtype) * span
        # The far half of the rim piece belongs to the half pitch before the grouser.
        place = jnp.where(place > self._pitch / 2, place - self._pitch, place)
        across = (_midpoints(self.tip_plates, dtype) - 0.5) * self.grouser_thickness
        bare = 1 - self.grouser_shadow
        outer = self.grouser_shadow + bare * _midpoints(self.side_plates, dtype)
        up = self.radius + outer * height
        rim, tip, side = jnp.ones_like(place), jnp.ones_like(across), jnp.ones_like(up)
        rim_area = self.radius * span / self.rim_plates
        tip_area = self.grouser_thickness / self.tip_plates
        side_area = bare * height / self.side_plates
        return jax.tree.map(
            lambda *pieces: jnp.concatenate(pieces),
            Plates(
                self.radius * jnp.sin(place),
                -self.radius * jnp.cos(place),
                jnp.sin(place),
                -jnp.cos(place),
                self.width * rim_area * rim,
            ),
            Plates(
                across, -(self.radius + height) * tip, 0 * tip, -tip, self.width * tip_area * tip
            ),
            Plates(half_thickness * side, -up, side, 0 * side, self.width * side_area * side),
            Plates(-half_thickness * side, -up, -side, 0 * side, self.width * side_area * side),
        )

    def cut(self) -> AbstractCut:
        sectors = self._sectors
        sector = self._sector()
        turned = [turn(sector, jnp.asarray(-self._pitch * k, self.radius.dtype)) for k in sectors]
        outline = jax.tree.map(lambda *pieces: jnp.concatenate(pieces), *turned)
        limit = self._sinkage_limit(len(sectors))
        return TurningCut(self.radius, limit, fill_vectors(outline), self._pitch)

    def _sinkage_limit(self, sectors: int) -> Float[Array, ""]:
        """Sinkage [m] at which the next plate would touch, were there more than these sectors."""
        # The wheel may stand half a pitch off either way.
        edge = self._pitch * (sectors // 2)
        if sectors == self.grouser_count or edge >= math.pi / 2:
            return self.radius
        half_thickness = self.grouser_thickness / 2 / self.radius
        grouser = jnp.minimum(self._pitch * (sectors // 2 + 0.5) - half_thickness, math.pi / 2)
        tip = self.radius + self.grouser_fraction * self.grouser_height
        rim_touches = self.radius * (1 - math.cos(edge))
        return jnp.minimum(rim_touches, self.radius - tip * jnp.cos(grouser))
