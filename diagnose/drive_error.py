"""The drive's own error, where the wheel's speed was measured: which effect of the drive makes it.

A run whose wheel's speed was measured is simulated under that speed, so that no error of the drive
is left in its gap. The effects of the drive are compared with the speed itself, which shows them
far more sharply than travel and sinkage do.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import least_squares

from drftjax.common.text import value_with_error
from drftjax.effects.base import AbstractDrive, AbstractEffect
from drftjax.effects.catalogue import field_metadata, reported_name, shapes, strengths
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.recorded.wheel_speed import WheelSpeed, driven_by


@dataclass(frozen=True)
class DriveErrorSettings:
    """Numbers by which the error of a drive is put down to an effect.

    Attributes:
        step: Step in which a drive is simulated [s]: a tenth of the shortest lag that a wheel on
            sand can show.
        least_error: A drive has an error where measured and commanded speed differ by more than so
            many standard deviations of the reading's noise, RMS [-].
        least_explained: An effect is named where it explains this share of the error's mean square
            [-]. With less, most of the error would be something else.
        least_gain: And where it explains it better than each other one, with so much more
            likelihood (difference of the Bayesian information criterion) [-].
        correlation: Readings so far apart count as independent evidence [s]: a drive's errors last.
    """

    step: float = 2e-3
    least_error: float = 1.2
    least_explained: float = 0.5
    least_gain: float = 6.0
    correlation: float = 0.1


DEFAULT_DRIVE_ERROR = DriveErrorSettings()


@dataclass(frozen=True, eq=False)
class DriveError:
    """Error of a drive, RMS over runs, and the effect that makes it.

    Attributes:
        error, noise: Measured minus commanded speed, and the reading's white noise, RMS [rad/s].
        effect: The effect with its numbers; None where there is no error, or no effect explains it.
        is_off: True where the wheel did not turn as commanded.
        explained: Share of the error's mean square beyond noise that the likeliest effect explains
            [-]; 0 where the wheel turned as commanded, or there is no effect to choose from.
        numbers: Its strengths with standard errors, by name, in the unit of each.
        rivals: Names of effects that the speed cannot tell from it.
    """

    error: float
    noise: float
    is_off: bool
    effect: AbstractEffect | None = None
    explained: float = 0.0
    numbers: dict[str, tuple[float, float, str]] | None = None
    rivals: tuple[str, ...] = ()

    def sentences(self) -> list[str]:
        """Error of the drive and its cause, in words."""
        off = f"{self.error:.3g} rad/s RMS (noise {self.noise:.2g})"
        given = "The model is driven by the measured speed, so this is no part of the gap."
        if not self.is_off:
            return [f"The wheel turned as commanded, by its measured speed: {off}. {given}"]
        if self.effect is None:
            return [
                f"The wheel did not turn as commanded, by its measured speed: {off}. No effect of "
                f"the drive explains half of it. {given}"
            ]
        numbers = ", ".join(
            f"{name} = {value_with_error(value, error)}{'' if unit == '-' else ' ' + unit}"
            for name, (value, error, unit) in (self.numbers or {}).items()
        )
        also = f" (as would {' or '.join(self.rivals)})" if self.rivals else ""
        return [
            f"The wheel did not turn as commanded, by its measured speed: {off}. "
            f"{reported_name(self.effect.about.name)}{also} explains {self.explained:.0%} of it: "
            f"{numbers}. {given}"
        ]

    def document(self) -> dict:
        """As plain values, in the layout of diagnosis.json."""
        return {
            "error": self.error,
            "noise": self.noise,
            "effect": None if self.effect is None else reported_name(self.effect.about.name),
            "explained": self.explained,
            "numbers": {
                name: {"value": value, "error": error, "unit": unit}
                for name, (value, error, unit) in (self.numbers or {}).items()
            },
            "rivals": list(self.rivals),
        }


def driven_by_measured_speed(
    runs: Sequence[PreparedRun], effects: Sequence[type[AbstractEffect]]
) -> tuple[list[PreparedRun], tuple[type[AbstractEffect], ...]]:
    """Runs under the measured speed of their wheels, and the effects that are not of the drive.

    Args:
        runs: Runs of one rig.
        effects: Effects to choose from.

    Returns:
        Runs and effects; as given where not every run has a measured speed, where a set-up has an
        effect of the drive itself, and where there are no other effects to choose from.
    """
    others = tuple(each for each in effects if not issubclass(each, AbstractDrive))
    driven = []
    for each in runs:
        own = each.trial.simulator.effects
        if each.wheel_speed is None or any(isinstance(e, AbstractDrive) for e in own) or not others:
            return list(runs), tuple(effects)
        driven.append(replace(each, trial=driven_by(each.trial, each.wheel_speed)))
    return driven, others


@dataclass(frozen=True, eq=False)
class _Candidate:
    """An effect fitted to the speed: its numbers, and what it leaves."""

    effect: AbstractEffect
    errors: np.ndarray
    left: float
    free: int


def drive_error(
    runs: Sequence[PreparedRun],
    effects: Sequence[type[AbstractEffect]],
    settings: DriveErrorSettings = DEFAULT_DRIVE_ERROR,
) -> DriveError | None:
    """Error of the drive by the measured speed of the wheel, and the effect that makes it.

    Each effect of the drive is simulated alone, from the commanded speed, and its strengths are
    fitted to the measured one by least squares, from each of its shapes and far values.

    Args:
        runs: Runs of one rig, as prepared.
        effects: Effects to choose from; those of other stages are passed over.
        settings: Numbers by which an effect is named.

    Returns:
        The error; None where not every run has a measured speed.
    """
    speeds = [each.wheel_speed for each in runs]
    if not speeds or any(each is None for each in speeds):
        return None
    drive = _Drive.of(runs, settings)
    noise = float(np.sqrt(np.mean([each.noise**2 for each in speeds if each])))
    none = drive.left(None)
    error = float(np.sqrt(none))
    if error <= settings.least_error * noise:
        return DriveError(error, noise, is_off=False)
    found = [drive.fitted(each) for each in effects if issubclass(each, AbstractDrive)]
    if not found:
        return DriveError(error, noise, is_off=True)
    count = drive.duration / settings.correlation  # readings that count as independent

    def criterion(each: _Candidate) -> float:
        return count * np.log(max(each.left, noise**2)) + each.free * np.log(count)

    best, *rest = sorted(found, key=criterion)
    explained = float(np.clip((none - best.left) / (none - noise**2), 0, 1))
    if explained < settings.least_explained:
        return DriveError(error, noise, is_off=True, explained=explained)
    about = field_metadata(type(best.effect))
    numbers = {
        name: (float(getattr(best.effect, name)), float(spread), about[name]["unit"])
        for name, spread in zip(strengths(type(best.effect)), best.errors, strict=True)
    }
    own = reported_name(best.effect.about.name)
    near = [e for e in rest if criterion(e) - criterion(best) < settings.least_gain]
    rivals = dict.fromkeys(reported_name(each.effect.about.name) for each in near)
    rivals.pop(own, None)
    return DriveError(error, noise, True, best.effect, explained, numbers, tuple(rivals))


@dataclass(frozen=True, eq=False)
class _Drive:
    """Commanded speeds of some runs in common steps, and what was measured.

    Attributes:
        step: [s].
        commanded: [rad/s], shape (runs, steps).
        angles: Of the wheels at the start [rad], shape (runs,).
        speeds: Of each run.
        correlation: Readings so far apart count as independent [s].
    """

    step: float
    commanded: Float[Array, "runs steps"]
    angles: Float[Array, " runs"]
    speeds: list[WheelSpeed]
    correlation: float

    @classmethod
    def of(cls, runs: Sequence[PreparedRun], settings: DriveErrorSettings) -> "_Drive":
        step = settings.step
        trials = [each.setup.trial(interval=0) for each in runs]
        longest = max(float(each.time[-1]) for each in trials)
        time = np.arange(0, longest + 2 * step, step)
        commanded = [np.interp(time, np.asarray(t.time), np.asarray(t.omega)) for t in trials]
        angles = [float(each.start.angle) for each in trials]
        speeds = [each.wheel_speed for each in runs if each.wheel_speed is not None]
        stacked = jnp.asarray(np.stack(commanded))
        return cls(step, stacked, jnp.asarray(angles), speeds, settings.correlation)

    @property
    def duration(self) -> float:
        """Length of all runs [s]."""
        return float(sum(each.time[-1] - each.time[0] for each in self.speeds))

    @property
    def readings_together(self) -> float:
        """Readings within the time over which errors last [-]."""
        return self.correlation * sum(len(each.time) for each in self.speeds) / self.duration

    def residual(self, turned: np.ndarray) -> np.ndarray:
        """Simulated minus measured speed [rad/s], shape (samples of all runs,)."""
        time = self.step * np.arange(turned.shape[1])
        each = [
            np.interp(seen.time, time, own) - seen.measured
            for seen, own in zip(self.speeds, turned, strict=True)
        ]
        return np.concatenate(each)

    def left(self, effect: AbstractEffect | None) -> float:
        """Mean square of simulated minus measured speed [rad^2/s^2]."""
        turned = self.commanded if effect is None else _turned(effect, self)
        return float(np.mean(self.residual(np.asarray(turned)) ** 2))

    def fitted(self, kind: type[AbstractEffect]) -> _Candidate:
        """An effect with the strengths that suit the measured speed."""
        about, names = field_metadata(kind), strengths(kind)
        scale = np.array([about[name]["typical"] for name in names])
        bounds = [np.array([about[n][side] for n in names]) / scale for side in ("least", "most")]
        forms = [
            dict(zip(shapes(kind), each, strict=True))
            for each in product(*(about[name]["starts"] for name in shapes(kind)))
        ]

        def effect(at, form) -> AbstractEffect:
            return kind(**form, **dict(zip(names, scale * at, strict=True)))

        @jax.jit
        def simulated(at, form):
            return _turned(effect(at, form), self)

        @jax.jit
        def slopes(at, form):
            return jnp.moveaxis(jax.jacfwd(simulated)(at, form), -1, 0)

        def columns(at, form) -> np.ndarray:
            """Derivative of the residual, shape (samples of all runs, strengths)."""
            each = [self.residual(np.asarray(slope)) - missing for slope in slopes(at, form)]
            return np.stack(each, axis=1)

        def linear(form) -> float:
            """Mean square left by the strengths that suit best to first order."""
            at_zero = columns(np.zeros(len(names)), form)
            found, *_ = np.linalg.lstsq(at_zero, nothing, rcond=None)
            return float(np.mean((nothing - at_zero @ found) ** 2))

        # The residual is linear in what is simulated but for the measured speed.
        missing = self.residual(np.zeros(self.commanded.shape))
        nothing = -self.residual(np.asarray(self.commanded))
        form = min(forms, key=linear) if len(forms) > 1 else forms[0]
        far = [np.array(each) / scale for each in product(*(about[n]["far"] for n in names))]
        starts = [np.full(len(names), 1e-3), *far]

        def residual(at: np.ndarray) -> np.ndarray:
            return self.residual(np.asarray(simulated(at, form)))

        results = [
            least_squares(
                residual,
                np.clip(start, *bounds),
                lambda at: columns(at, form),  # pyright: ignore[reportArgumentType]
                bounds=bounds,
            )
            for start in starts
        ]
        best = min(results, key=lambda each: each.cost)
        left = 2 * best.cost / len(best.fun)
        gram = best.jac.T @ best.jac
        # What is left beyond the reading's noise lasts, so that fewer readings count.
        white = float(np.mean([each.noise**2 for each in self.speeds]))
        lasting = 1 + self.readings_together * max(0.0, 1 - white / left)
        errors = scale * np.sqrt(lasting * left * np.diag(np.linalg.pinv(gram)))
        return _Candidate(effect(best.x, form), errors, left, len(names) + len(form))


def _turned(effect: AbstractEffect, drive: _Drive) -> Float[Array, "runs steps"]:
    """Angular velocity that a drive makes of the commanded one, at the end of each step [rad/s]."""
    assert isinstance(effect, AbstractDrive)

    def run(commanded, angle):
        def turn(carry, omega):
            angle, memory = carry
            speed, memory = effect.turn(omega, angle, step, memory)
            return (angle + step * speed, memory), speed

        step = jnp.asarray(drive.step, commanded.dtype)
        begun = effect.begin(commanded[0], angle)
        _, speeds = jax.lax.scan(turn, (angle, begun), commanded[1:])
        return jnp.concatenate([commanded[:1], speeds])

    return jax.vmap(run)(drive.commanded, drive.angles)
