"""Corrections: curves over one variable that stand in for an unlisted effect.

A correction acts in one stage: it scales zeta, pulls at the axle, changes the drive's speed, the
surface or a reading, by a curve that runs straight between its knots and level beyond them. Its
strengths are the curve's values at the knots. The variable and the knots are part of its class, so
that a model with it compiles like one with any effect; `correction_class` makes the class.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.common.errors import InputError
from drftjax.effects.base import (
    AbstractDrive,
    AbstractEffect,
    AbstractLoad,
    AbstractPlane,
    AbstractSensor,
    AbstractZetaFactor,
    EffectInfo,
    Memory,
    StepContext,
    along_x,
    along_z,
    strength,
)

if TYPE_CHECKING:
    from drftjax.physics.state import Output

NAME = "correction"


READING = "reading "


FIELDS = ("stage", "variable", "knots", "values")


Number = Float[Array, ""]


Pair = Float[Array, "2"]


# Variables of a curve, with their units.
VARIABLES = {
    "angular velocity": "rad/s",
    "slip speed": "m/s",
    "sinkage": "m",
    "travel": "m",
    "turning": "rad",
    "time": "s",
    "wheel angle": "rad",
    "vx": "m/s",
    "vz": "m/s",
}


# A drive knows no more than how it turns, the surface no more than what has gone by.
DRIVE_KNOWS = ("angular velocity", "turning", "time", "wheel angle")


SURFACE_KNOWS = ("travel", "turning", "time")


TURN = 2 * math.pi


# More knots than these are no curve, and would take long to compile.
MOST_KNOTS = 100


def fields(count: int) -> tuple[str, ...]:
    """Names of the strengths of a correction with this many knots."""
    return tuple(f"at_{k}" for k in range(count))


class TravelMemory(eqx.Module):
    """Travel [m], turning [rad] and time [s] since the run's start."""

    travel: Number
    turning: Number
    time: Number

    @classmethod
    def nothing(cls) -> "TravelMemory":
        nought = jnp.zeros(())
        return cls(nought, nought, nought)

    def known(self) -> dict[str, Number]:
        """By the names of `VARIABLES`."""
        return {"travel": self.travel, "turning": self.turning, "time": self.time}


class Curve(AbstractEffect):
    """Values at knots over a variable. The knots and the variable belong to the class."""

    variable: ClassVar[str]
    knots: ClassVar[tuple[float, ...]]
    stage: ClassVar[str]

    def values(self) -> Float[Array, " knots"]:
        return jnp.stack([getattr(self, field) for field in fields(len(self.knots))])

    def at(self, variable: Number) -> Number:
        """The curve's height; around a turn, it closes."""
        values = self.values()
        knots = jnp.asarray(self.knots, values.dtype)
        if self.variable == "wheel angle":
            return jnp.interp(jnp.mod(variable, TURN), knots, values, period=TURN)
        return jnp.interp(variable, knots, values)

    def along(self, known: Mapping[str, Number]) -> Number:
        """Height of the curve at its own variable, among all variables of its stage."""
        return self.at(known[self.variable])

    def in_moment(self, moment: StepContext, memory: TravelMemory) -> Number:
        """The curve's height in a step."""
        known = {
            "angular velocity": moment.omega,
            "slip speed": moment.rim_slip(),
            "sinkage": -moment.position[1],
            "wheel angle": moment.angle,
            "vx": moment.velocity[0],
            "vz": moment.velocity[1],
        }
        return self.along({**known, **memory.known()})


def _gone_on(memory: TravelMemory, moment: StepContext) -> TravelMemory:
    return TravelMemory(
        memory.travel + moment.dt * moment.velocity[0],
        memory.turning + moment.dt * jnp.abs(moment.omega),
        memory.time + moment.dt,
    )


class ZetaCorrection(Curve, AbstractZetaFactor):
    """zeta is scaled by the exponential of a curve."""

    about: ClassVar = EffectInfo(NAME, "terrain", "ζ = ζ exp(curve)", "zeta follows a fitted curve")

    def begin(self) -> Memory:
        return TravelMemory.nothing()

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        return _gone_on(memory, moment)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        return jnp.exp(self.in_moment(moment, memory))


class _ForceCorrection(Curve, AbstractLoad):
    def begin(self, position: Pair) -> Memory:
        return TravelMemory.nothing()

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        return _gone_on(memory, moment)

    def force(self, velocity: Pair, moment: StepContext, memory: Memory) -> Number:
        # The step linearises a load in the velocity that it is handed.
        return self.in_moment(replace(moment, velocity=velocity), memory)


class XForceCorrection(_ForceCorrection):
    """A horizontal force along a curve."""

    about: ClassVar = EffectInfo(NAME, "rig", "F_x = F_x + curve", "a fitted horizontal force")

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_x(self.force(velocity, moment, memory))


class ZForceCorrection(_ForceCorrection):
    """A vertical force along a curve."""

    about: ClassVar = EffectInfo(NAME, "rig", "F_z = F_z + curve", "a fitted vertical force")

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_z(self.force(velocity, moment, memory))


class SpeedCorrection(Curve, AbstractDrive):
    """The wheel's speed is off by a curve."""

    about: ClassVar = EffectInfo(
        NAME, "drive", "ω = ω + curve", "a fitted error of the drive's speed"
    )

    def begin(self, omega: Number, angle: Number) -> Memory:
        return TravelMemory.nothing()

    def turn(
        self, omega: Number, angle: Number, dt: Number, memory: Memory
    ) -> tuple[Number, Memory]:
        gone = TravelMemory(memory.travel, memory.turning + dt * jnp.abs(omega), memory.time + dt)
        known = {
            "angular velocity": omega,
            "turning": gone.turning,
            "time": gone.time,
            "wheel angle": angle + dt * omega,
        }
        return omega + self.along(known), gone


class HeightCorrection(Curve, AbstractPlane):
    """The surface under the wheel lies higher by a curve."""

    about: ClassVar = EffectInfo(NAME, "terrain", "h = h + curve", "a fitted height of the surface")

    def begin(self) -> Memory:
        return TravelMemory.nothing()

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        return _gone_on(memory, moment)

    def plane(self, axle: Number, memory: Memory) -> tuple[Number, Number]:
        return self.along(memory.known()), jnp.zeros_like(axle)


class ReadingCorrection(Curve, AbstractSensor):
    """A reading is off by a curve."""

    about: ClassVar = EffectInfo(
        NAME, "sensor", "reading = reading + curve", "a fitted reading error"
    )

    def begin(self, output: "Output") -> Memory:
        return output.x, TravelMemory.nothing(), output.angle

    def read(self, output: "Output", dt: Number, memory: Memory) -> tuple["Output", Memory]:
        first, gone, before = memory
        gone = TravelMemory(
            output.x - first, gone.turning + jnp.abs(output.angle - before), gone.time + dt
        )
        known = {
            "angular velocity": output.omega,
            "sinkage": -output.z,
            "wheel angle": output.angle,
            "vx": output.vx,
            "vz": output.vz,
            **gone.known(),
        }
        channel = self.stage.removeprefix(READING)
        changed = {channel: getattr(output, channel) + self.along(known)}
        if channel == "z":
            changed["sinkage"] = -changed["z"]
        return replace(output, **changed), (first, gone, output.angle)


# Class, unit and typical size of a correction of each stage.
STAGES: dict[str, tuple[type[Curve], str, float]] = {
    "zeta": (ZetaCorrection, "-", 0.1),
    "force_x": (XForceCorrection, "N", 5.0),
    "force_z": (ZForceCorrection, "N", 5.0),
    "speed": (SpeedCorrection, "rad/s", 0.02),
    "height": (HeightCorrection, "m", 1e-3),
    "reading x": (ReadingCorrection, "m", 1e-3),
    "reading z": (ReadingCorrection, "m", 2e-4),
    "reading fx": (ReadingCorrection, "N", 2.0),
    "reading fz": (ReadingCorrection, "N", 2.0),
    "reading torque": (ReadingCorrection, "N m", 0.2),
}


def correction_variables(stage: str) -> tuple[str, ...]:
    """Variables that a correction of a stage may follow."""
    if stage == "speed":
        return DRIVE_KNOWS
    if stage == "height":
        return SURFACE_KNOWS
    if stage.startswith(READING):
        return tuple(each for each in VARIABLES if each != "slip speed")
    return tuple(VARIABLES)


def correction_class(stage: str, variable: str, knots: Sequence[float]) -> type[Curve]:
    """Class of a correction.

    Args:
        stage: zeta, force_x, force_z, speed, height, or "reading " and a channel.
        variable: What its curve stands on, a name of `VARIABLES`.
        knots: Where, ascending, in the variable's unit.

    Raises:
        InputError: where there is no such stage, or it cannot know the variable.
    """
    return _correction(stage, variable, tuple(float(k) for k in knots))


@cache
def _correction(stage: str, variable: str, knots: tuple[float, ...]) -> type[Curve]:
    if stage not in STAGES:
        raise InputError(f"a correction's stage is {stage!r}, must be one of {', '.join(STAGES)}")
    if variable not in correction_variables(stage):
        known = ", ".join(correction_variables(stage))
        raise InputError(f"a correction of {stage} may follow {known}; {variable!r} was given")
    if not 2 <= len(knots) <= MOST_KNOTS:
        raise InputError(f"a correction has 2 to {MOST_KNOTS} knots; {len(knots)} were given")
    if any(a >= b for a, b in itertools.pairwise(knots)):
        raise InputError(f"the knots of a correction must ascend; {list(knots)} were given")
    if variable == "wheel angle" and not (knots[0] >= 0 and knots[-1] < TURN):
        raise InputError(
            f"the knots over a wheel angle must lie from 0 to under 2 pi rad; {list(knots)} "
            "were given"
        )
    _, unit, typical = STAGES[stage]
    at = [f"at {variable} = {knot:.4g} {VARIABLES[variable]}" for knot in knots]
    strengths = [strength(unit, typical, text) for text in at]
    members = dict(zip(fields(len(knots)), strengths, strict=True))
    return curve_class(stage, variable, knots, members)


def curve_class(
    stage: str, variable: str, knots: tuple[float, ...], members: Mapping[str, Any]
) -> type[Curve]:
    """Class of a correction with fields and methods of its own.

    Args:
        stage: Of `STAGES`.
        variable: What its curve stands on.
        knots: Where, ascending, in the variable's unit.
        members: Fields and methods by name; a method takes the place of the class's own.
    """
    base, _, _ = STAGES[stage]
    formula = base.about.formula.replace("reading", stage.removeprefix(READING))
    made: Any = type(base)
    return made(
        base.__name__,
        (base,),
        {
            "__annotations__": {n: Array for n, each in members.items() if not callable(each)},
            "__module__": __name__,
            "__doc__": base.__doc__,
            "about": replace(base.about, formula=f"{formula} over {variable}"),
            "variable": variable,
            "knots": knots,
            "stage": stage,
            **members,
        },
    )


def entry_of(effect: Curve) -> dict[str, Any]:
    """A correction as a file holds it."""
    return {
        "name": NAME,
        "stage": effect.stage,
        "variable": effect.variable,
        "knots": list(effect.knots),
        "values": [float(value) for value in effect.values()],
    }


def build_correction(entry: Mapping[str, Any]) -> Curve:
    """The correction that an entry describes.

    Raises:
        InputError: says what was given, and what must hold.
    """
    missing = [field for field in FIELDS if field not in entry]
    if missing:
        raise InputError(
            f"a correction needs {', '.join(missing)} too; its entries are {', '.join(FIELDS)}"
        )
    for field in entry:
        if field not in ("name", *FIELDS):
            raise InputError(f"a correction has no entry {field!r}; it has {', '.join(FIELDS)}")
    for field in ("stage", "variable"):
        if not isinstance(entry[field], str):
            raise InputError(f"correction.{field} is {entry[field]!r}, must be a word")
    knots, values = _numbers(entry, "knots"), _numbers(entry, "values")
    kind = correction_class(entry["stage"], entry["variable"], knots)
    if len(values) != len(knots):
        raise InputError(
            f"a correction has a value for each of its {len(knots)} knots; {len(values)} were given"
        )
    return with_values(kind, values)


def with_values(kind: type[Curve], values: Sequence[float]) -> Curve:
    """The correction with these values at its knots."""
    return kind(**{field: float(v) for field, v in zip(fields(len(values)), values, strict=True)})


def _numbers(entry: Mapping[str, Any], field: str) -> list[float]:
    given = entry[field]
    if not isinstance(given, list) or not all(isinstance(each, float | int) for each in given):
        raise InputError(f"correction.{field} is {given!r}, must be a list of numbers")
    if not all(math.isfinite(each) for each in given):
        raise InputError(f"correction.{field} is {given}, must be finite")
    return [float(each) for each in given]
