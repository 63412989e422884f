"""Repeats: runs of one condition, which is one command, wheel, rig and sand.

One definition serves fits and diagnoses. Numbers of set-ups agree within what files of different
makers round, wheel speeds within what a drive holds, and carriage speeds and sands within what runs
made alike differ by.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.integrate import cumulative_trapezoid

from drftjax.recorded.prepared_run import PreparedRun
from drftjax.runlog.record import RecordedCommand
from drftjax.setups.setup import RigSetUp, SetUp, WheelSetUp


@dataclass(frozen=True)
class RepeatTolerances:
    """Differences that two repeats may have.

    Attributes:
        relative, absolute: Of the numbers of wheel and rig: share of their size, and what is added
            to it for numbers near zero, in their own unit. Files of different makers round by as
            much.
        turned: Of the angle that the wheel has turned by at any time, as a share of the whole
            [-]. A log may hold the measured speed in place of the commanded one: a drive holds its
            mean within this, and no profile is varied by so little.
        wheel_speed: RMS over the run, as a share of the top speed [-]: what a drive ripples and an
            encoder's speed scatters by.
        carriage_speed: Of a driven carriage's speed, as a share of its top speed [-]: in the loop
            it is tuned to the sinkage, and no two runs get the same.
        log_zeta: Of the zeta that is believed of the sand before any fit [-], by its logarithm:
            sand that is prepared alike scatters by a few per cent.
        shared: The shorter run lasts for this share of the longer one at least [-], and each was
            recorded for as much of the other's time: one may have been stopped early.
        shared_by_fits: The same for the residuals of fits [-]. With more missing, the numbers
            fitted to one suit other parts of the run than the other's, and a residual that grows in
            both would be counted as noise.
        position: Between the places at which they begin [m], where effects may depend on the place.
        angle: Between the wheel angles at which they begin [rad], likewise.
    """

    relative: float = 1e-6
    absolute: float = 1e-9
    turned: float = 2e-3
    wheel_speed: float = 0.02
    carriage_speed: float = 0.02
    log_zeta: float = 0.2
    shared: float = 0.5
    shared_by_fits: float = 0.95
    position: float = 5e-3
    angle: float = float(np.deg2rad(1.0))


DEFAULT_TOLERANCES = RepeatTolerances()


@dataclass(frozen=True, eq=False)
class RunCondition:
    """Command, wheel, rig and sand of a run, as they are believed to be before any fit.

    Attributes:
        command: What was asked of the rig.
        wheel, rig: Their set-ups.
        log_zeta: Logarithm of the sand's zeta [-]; None where it is not known before the fit.
    """

    command: RecordedCommand
    wheel: WheelSetUp
    rig: RigSetUp
    log_zeta: float | None = None

    @classmethod
    def of(cls, setup: SetUp) -> "RunCondition":
        """The condition that a set-up describes; a zeta that varies over time counts as unknown."""
        zeta = setup.terrain.zeta
        log_zeta = float(np.log(zeta)) if isinstance(zeta, float) else None
        return cls(setup.command.build(), setup.wheel, setup.rig, log_zeta)

    @property
    def duration(self) -> float:
        """Length of the command [s]."""
        return float(self.command.time[-1] - self.command.time[0])

    @property
    def rank(self) -> tuple[float, ...]:
        """Key that sorts the longest run first, and runs of equal length by their numbers alone."""
        command, rig = self.command, self.rig
        zeta = np.inf if self.log_zeta is None else self.log_zeta
        load = (rig.mass_x, rig.mass_z, rig.drawbar_load)
        vx = () if command.vx is None else command.vx
        return (-self.duration, zeta, *load, *vx, *command.omega)


def group_by_condition(
    runs: Sequence[PreparedRun], tolerances: RepeatTolerances = DEFAULT_TOLERANCES
) -> list[list[int]]:
    """Runs of the same condition, by index; one that was stopped early is among them.

    Args:
        runs: The runs.
        tolerances: Differences that runs of one condition may have.

    Returns:
        Groups of one run or more, each ascending, in the order of their first runs.
    """
    return group_conditions([RunCondition.of(each.setup) for each in runs], tolerances)


def group_conditions(
    conditions: Sequence[RunCondition], tolerances: RepeatTolerances = DEFAULT_TOLERANCES
) -> list[list[int]]:
    """Equal conditions, by index, like `group_by_condition`.

    Each condition is compared with the longest one of a group, so that the groups do not depend on
    the order of the runs.
    """
    groups: list[list[int]] = []
    for index in sorted(range(len(conditions)), key=lambda each: conditions[each].rank):
        for group in groups:
            if _equal(conditions[group[0]], conditions[index], tolerances):
                group.append(index)
                break
        else:
            groups.append([index])
    return sorted(sorted(group) for group in groups)


def _equal(one: RunCondition, other: RunCondition, tolerances: RepeatTolerances) -> bool:
    return (
        _equal_numbers(one.wheel, other.wheel, tolerances)
        and _equal_numbers(one.rig, other.rig, tolerances)
        and _equal_sands(one, other, tolerances)
        and _equal_commands(one, other, tolerances)
    )


def _equal_numbers(
    one: WheelSetUp | RigSetUp, other: WheelSetUp | RigSetUp, tolerances: RepeatTolerances
) -> bool:
    """True where all fields of two set-ups of one kind agree."""
    for name in one.__struct_fields__:
        a, b = getattr(one, name), getattr(other, name)
        if isinstance(a, float) and isinstance(b, float):
            if abs(a - b) > tolerances.relative * max(abs(a), abs(b)) + tolerances.absolute:
                return False
        elif a != b:
            return False
    return True


def _equal_sands(one: RunCondition, other: RunCondition, tolerances: RepeatTolerances) -> bool:
    if one.log_zeta is None or other.log_zeta is None:
        return True
    return abs(one.log_zeta - other.log_zeta) <= tolerances.log_zeta


def _equal_commands(one: RunCondition, other: RunCondition, tolerances: RepeatTolerances) -> bool:
    """True where two commands agree for as long as both go on."""
    a, b = one.command, other.command
    end = min(one.duration, other.duration)
    if (a.vx is None) != (b.vx is None):
        return False
    if end < tolerances.shared * max(one.duration, other.duration):
        return False
    # Speeds are linear between knots: they agree where they agree at the knots of both.
    times = [each.time - each.time[0] for each in (a, b)]
    knots = np.union1d(*times)
    knots = knots[knots <= end]

    def speeds(*both: np.ndarray) -> np.ndarray:
        return np.array([np.interp(knots, t, v) for t, v in zip(times, both, strict=True)])

    turning = speeds(a.omega, b.omega)
    if not _equal_turning(knots, turning, tolerances):
        return False
    if a.vx is None or b.vx is None:
        return True
    carriages = speeds(a.vx, b.vx)
    allowed = tolerances.carriage_speed * float(np.abs(carriages).max()) + tolerances.absolute
    return bool(np.abs(np.diff(carriages, axis=0)).max() <= allowed)


def _equal_turning(
    time: Float[np.ndarray, " knots"],
    speeds: Float[np.ndarray, "2 knots"],
    tolerances: RepeatTolerances,
) -> bool:
    """True where two wheels turn alike: by the same angle at any time, and as fast."""
    difference = speeds[1] - speeds[0]
    off = np.abs(cumulative_trapezoid(difference, time, initial=0.0)).max()
    whole = np.trapezoid(np.abs(speeds).max(axis=0), time)
    scatter = np.sqrt(np.trapezoid(difference**2, time))
    top = np.sqrt(time[-1] - time[0]) * np.abs(speeds).max()
    absolute = tolerances.absolute
    return bool(
        off <= tolerances.turned * whole + absolute
        and scatter <= tolerances.wheel_speed * top + absolute
    )
