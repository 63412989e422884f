"""Safety of a run: what the rig measures of its own motion, held against what was commanded.

`SafetyRule` is the one table of what is looked for and what follows; `SafetySettings` holds every
number. docs/guide/run-a-rig.md shows both as `safety_table` writes them. The loop asks
`SafetyMonitor` on each tick; the procedure asks `MotionAtRest` while the rig must stand.
"""

import enum
import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from hils.control.limits import Reading, ReadingMonitor, Verdict
from hils.control.loop_config import LoopSetUp
from hils.control.measurements import PolledReading
from hils.control.tick import TickOutput
from hils.events import Event


class Action(enum.Enum):
    """Action that follows, in words."""

    ASK = "asked before ARM; refused with --yes, and after ARM"
    HOLD = "zeta held, and reported"
    RAMP = "ramped down"
    END = "ended as by silence: STOP, and an emergency stop where the rig is not seen to rest"
    STOP = "emergency stop"


class _Rule(NamedTuple):
    seen: str
    action: Action
    event: Event


class SafetyRule(enum.Enum):
    """One row of the table: what is seen, the action that follows, and its event in the log.

    Braces name numbers of `SafetySettings`.
    """

    RUNAWAY = _Rule(
        "measured omega beyond the limit, of the wrong sense by {wrong_omega} rad/s, or away from "
        "all commands of the last {window} s by more than {omega_margin} rad/s and {omega_share} "
        "of them: {in_a_row} readings in a row",
        Action.STOP,
        Event.RUNAWAY,
    )
    DRIVE_DEVIATES = _Rule(
        "measured omega away from those commands by more than {lasting_margin} rad/s and "
        "{lasting_share} of them for {lasting_time} s",
        Action.RAMP,
        Event.DRIVE_DEVIATES,
    )
    MOVES_AT_REST = _Rule(
        "at touch-down, while the wheel settles and in the countdown: omega over {rest_omega} "
        "rad/s, of one sign in {rest_readings} readings in a row, or x gone by more than "
        "{rest_travel} m in {in_a_row}",
        Action.STOP,
        Event.MOVES_AT_REST,
    )
    NOT_SLOWING = _Rule(
        "after STOP: omega over {rest_omega} rad/s and not smaller by {slowing_share} than "
        "{slowing_time} s before",
        Action.STOP,
        Event.NOT_SLOWING,
    )
    CARRIAGE_DEVIATES = _Rule(
        "x against the commanded vx over {travel_window} s: off by more than {travel_share} and "
        "{travel_margin} m, or of the other sign, {in_a_row} readings in a row",
        Action.RAMP,
        Event.CARRIAGE_DEVIATES,
    )
    STUCK = _Rule(
        "z or x without any change while it must move: zeta goes back to its value at the last "
        "change and is held",
        Action.HOLD,
        Event.SENSOR_STUCK,
    )
    STAYS_STUCK = _Rule(
        "z stuck for {stuck_time} s more, where the standing wheel's readings showed noise or the "
        "simulated height has changed by {stuck_simulated} m since",
        Action.RAMP,
        Event.STAYS_STUCK,
    )
    READINGS_TOO_OLD = _Rule(
        "the newest reading older than 0.25 s (or five ticks), by the command that it answers or "
        "by the rig's clock",
        Action.END,
        Event.READINGS_TOO_OLD,
    )
    ZETA_DOUBTED = _Rule(
        "zeta(0) from statics off the set-up's by a factor of {zeta_factor}, or no sand's",
        Action.ASK,
        Event.ZETA_DOUBTED,
    )
    SIMULATION_JUMPS = _Rule(
        "the simulated height changes by more than {simulated_jump} m in {simulated_time} s",
        Action.RAMP,
        Event.SIMULATION_JUMPS,
    )
    SPEED_DOUBTED = _Rule(
        "the simulation asks for a vx outside 0 to {rolling_share} r omega of the profile's last "
        "{window} s by more than {rolling_margin} m/s",
        Action.RAMP,
        Event.SPEED_DOUBTED,
    )
    ZETA_AT_BOUND = _Rule(
        "zeta at its lowest or highest value",
        Action.HOLD,
        Event.ZETA_AT_BOUND,
    )

    @property
    def seen(self) -> str:
        """Words for what is seen."""
        return self.value.seen

    @property
    def action(self) -> Action:
        """Action that follows."""
        return self.value.action

    @property
    def event(self) -> Event:
        """Event of the run log."""
        return self.value.event


@dataclass(frozen=True)
class SafetySettings:
    """Numbers of the rules, each with its reason.

    Attributes:
        in_a_row: Readings that must agree: one may be a spike of the sensor.
        window: Commands of so long before count beside the present one [s]: the slowest rig that
            is accepted answers within 0.25 s, and its drive follows within half a second.
        kept_interval: From one kept command to the next, at least [s]: commands change slowly, and
            a tick of a millisecond must not look through hundreds.
        omega_margin: Error of the measured omega that is no danger [rad/s]: half of a usual speed.
        omega_share: The same as a share of the command [-]: more than gearing or a scale is off.
        wrong_omega: Speed the wrong way round that is no noise [rad/s].
        unit_ratio: Measured omega over the command from which on a unit is suspected [-].
        limit_share: Measured omega may exceed the limit by this share [-], as noise.
        lasting_margin, lasting_share: The same for an error that lasts [rad/s], [-]: a drive that
            is off by less is a matter for a diagnosis.
        lasting_time: Time for which it lasts [s].
        rest_omega: Wheel speed that is no noise of a standing wheel [rad/s].
        rest_readings: Readings in which it is so, one after the other [-]: noise changes its sign.
        rest_travel: Travel that is no settling of a standing carriage [m].
        slowing_time: From one look at a wheel that is commanded to stop to the next [s].
        slowing_share: Share of its speed that it must lose from one look to the next [-]: the
            slowest ramp takes some seconds.
        travel_window: Time over which x is compared [s].
        travel_share: Share of the commanded travel [-].
        travel_margin: Travel that is no error [m]: noise and backlash.
        travel_lag: Time by which a carriage may trail its command [s].
        stuck_time: Time for which z may be stuck [s].
        stuck_simulated: Change of the simulated height that a sensor must show [m].
        zeta_factor: zeta(0) by statics over the set-up's, or the inverse, at most [-]: sand
            differs by less, a wrong scale or sign of z by more.
        simulated_jump: Change of the simulated height that no sand allows [m].
        simulated_time: Within this time [s].
        rolling_share: Speed of a wheel that is driven, over r omega, at most [-].
        rolling_margin: Speed that is no error beside it [m/s].
    """

    in_a_row: int = 3
    window: float = 0.75
    kept_interval: float = 0.01
    omega_margin: float = 0.25
    omega_share: float = 0.25
    wrong_omega: float = 0.1
    unit_ratio: float = 20.0
    limit_share: float = 0.1
    lasting_margin: float = 0.05
    lasting_share: float = 0.2
    lasting_time: float = 1.0
    rest_omega: float = 0.05
    rest_readings: int = 10
    rest_travel: float = 5e-3
    slowing_time: float = 0.5
    slowing_share: float = 0.05
    travel_window: float = 0.5
    travel_share: float = 0.2
    travel_margin: float = 3e-3
    travel_lag: float = 0.3
    stuck_time: float = 1.0
    stuck_simulated: float = 1e-3
    zeta_factor: float = 3.0
    simulated_jump: float = 0.01
    simulated_time: float = 0.2
    rolling_share: float = 1.3
    rolling_margin: float = 0.01


DEFAULT_SAFETY = SafetySettings()


class Finding(NamedTuple):
    """A rule that fired.

    Attributes:
        rule: The rule.
        sentence: Words for the operator, with the numbers seen.
        value: Number of its event.
    """

    rule: SafetyRule
    sentence: str
    value: float


def safety_table(settings: SafetySettings = DEFAULT_SAFETY) -> str:
    """The rules as a table in Markdown."""
    rows = ["| seen | action | event in the run log |", "|---|---|---|"]
    for rule in SafetyRule:
        seen = rule.seen.format(**vars(settings))
        rows.append(f"| {seen} | {rule.action.value} | `{rule.event.name.lower()}` |")
    return "\n".join(rows)


class MotionAtRest:
    """Looks for motion of a rig that must stand.

    Args:
        x_scale: Metres a count; 0 where x is not measured.
        settings: Numbers of the rules.
    """

    def __init__(self, x_scale: float, settings: SafetySettings = DEFAULT_SAFETY):
        self._scale, self._settings = x_scale, settings
        self._first: float | None = None
        self._turning = self._going = 0

    def find(self, omega: float, x: float) -> Finding | None:
        """Motion that a new measurement shows.

        Args:
            omega: As measured [rad/s]; NaN where it is not.
            x: As measured [counts].
        """
        settings, rule = self._settings, SafetyRule.MOVES_AT_REST
        sign = 0 if not abs(omega) > settings.rest_omega else 1 if omega > 0 else -1
        self._turning = self._turning + sign if sign * self._turning > 0 else sign
        if abs(self._turning) >= settings.rest_readings:
            sentence = f"the wheel turns at {omega:.3g} rad/s while it is to stand"
            return Finding(rule, sentence, omega)
        if self._first is None:
            self._first = x
        gone = (x - self._first) * self._scale
        self._going = self._going + 1 if abs(gone) > settings.rest_travel else 0
        if self._going >= settings.in_a_row:
            sentence = f"the carriage has gone {gone * 1e3:.3g} mm while it is to stand"
            return Finding(rule, sentence, gone)
        return None


class _Commanded(NamedTuple):
    """A command, from this time on [s], and the travel commanded until then [m]."""

    time: float
    omega: float
    vx: float
    travel: float


class _Travel(NamedTuple):
    """Travel read at a time [s], and the travel commanded until the reading was made [m]."""

    time: float
    read: float
    commanded: float


class SafetyMonitor:
    """Holds each tick of a run against the rules.

    Args:
        loop: Within the rig's limits.
        driven: True where the carriage is driven at the simulated speed.
        settings: Numbers of the rules.
    """

    def __init__(self, loop: LoopSetUp, driven: bool, settings: SafetySettings = DEFAULT_SAFETY):
        self._loop, self._driven, self._settings = loop, driven, settings
        self._radius = loop.setup.wheel.radius
        self._commands = deque[_Commanded]([_Commanded(0.0, 0.0, 0.0, 0.0)])
        self._travels = deque[_Travel]()
        self._heights = deque[tuple[float, float]]()
        self._runaway = self._off = 0
        self._deviates_since = math.nan
        self._stuck_height = math.nan
        self._fired = set[SafetyRule]()

    def find(
        self, output: TickOutput, watch: ReadingMonitor, polled: PolledReading, ramping: bool
    ) -> list[Finding]:
        """Rules that a tick breaks for the first time in this run.

        Args:
            output: Of the tick.
            watch: Memory of the readings after it.
            polled: Newest measurement.
            ramping: True where the wheel is brought to rest already.
        """
        time = output.number * self._loop.tick
        reading = polled.reading
        found: list[Finding | None] = []
        if reading is not None:
            low, high = self._omega_range()
            found += [self._runs_away(reading, low, high), self._deviates(reading, low, high)]
            if self._driven and output.verdict is Verdict.USED:
                found.append(self._carriage(reading, polled.behind))
        found.append(self._stays_stuck(output, watch, time))
        if self._driven:
            found += self._simulation(output, time, ramping)
        self._keep(output, time)
        new = [each for each in found if each is not None and each.rule not in self._fired]
        self._fired.update(each.rule for each in new)
        return new

    def _keep(self, output: TickOutput, time: float) -> None:
        """Keep the command that goes out at this time [s], and forget old ones."""
        if output.demand is None:
            return
        last, tick = self._commands[-1], self._loop.tick
        start = time + tick
        travel = last.travel + last.vx * (start - last.time)
        if (
            len(self._commands) > 1
            and last.time - self._commands[-2].time < self._settings.kept_interval
        ):
            self._commands.pop()
        self._commands.append(_Commanded(start, output.demand.omega, output.demand.vx, travel))
        oldest = start - self._settings.window
        while len(self._commands) > 2 and self._commands[1].time <= oldest:
            self._commands.popleft()

    def _omega_range(self) -> tuple[float, float]:
        every = [each.omega for each in self._commands]
        return min(every), max(every)

    # Wheel --------------------------------------------------------------------------------------

    def _runs_away(self, reading: Reading, low: float, high: float) -> Finding | None:
        settings, omega = self._settings, reading.omega
        most = max(abs(low), abs(high))
        away = max(omega - high, low - omega)
        limit = self._loop.commands.omega * (1 + settings.limit_share)
        backwards = (low >= 0 and omega < -settings.wrong_omega) or (
            high <= 0 and omega > settings.wrong_omega
        )
        wrong = away > settings.omega_margin + settings.omega_share * most
        self._runaway = self._runaway + 1 if wrong or backwards or abs(omega) > limit else 0
        if self._runaway < settings.in_a_row:
            return None
        hint = ""
        if backwards:
            hint = " (is the motor or its encoder wired the other way round?)"
        elif abs(omega) > settings.unit_ratio * most > 0:
            hint = " (does the rig send deg/s, or the speed before the gear?)"
        return Finding(
            SafetyRule.RUNAWAY,
            f"the wheel turns at {omega:.3g} rad/s, commanded were {low:.3g} to {high:.3g} rad/s "
            f"over the last {settings.window:g} s{hint}",
            omega,
        )

    def _deviates(self, reading: Reading, low: float, high: float) -> Finding | None:
        settings, omega = self._settings, reading.omega
        away = max(omega - high, low - omega)
        most = settings.lasting_margin + settings.lasting_share * max(abs(low), abs(high))
        if not away > most:
            self._deviates_since = math.nan
            return None
        if math.isnan(self._deviates_since):
            self._deviates_since = reading.time
        if reading.time - self._deviates_since < settings.lasting_time:
            return None
        return Finding(
            SafetyRule.DRIVE_DEVIATES,
            f"for {settings.lasting_time:g} s the wheel has not turned as commanded: "
            f"{omega:.3g} rad/s measured, {low:.3g} to {high:.3g} rad/s commanded",
            omega,
        )

    # Carriage -----------------------------------------------------------------------------------

    def _carriage(self, reading: Reading, behind: float) -> Finding | None:
        settings = self._settings
        if math.isnan(reading.x):
            return None
        made = reading.time - behind
        at = next((c for c in reversed(self._commands) if c.time <= made), self._commands[0])
        commanded = at.travel + at.vx * max(made - at.time, 0.0)
        travels = self._travels
        travels.append(_Travel(reading.time, reading.x, commanded))
        while len(travels) > 2 and travels[1].time <= reading.time - settings.travel_window:
            travels.popleft()
        first, last = travels[0], travels[-1]
        if last.time - first.time < settings.travel_window * 0.9:
            return None
        gone, asked = last.read - first.read, last.commanded - first.commanded
        speeds = [each.vx for each in self._commands]
        lag = settings.travel_lag * (max(speeds) - min(speeds))
        off = abs(gone - asked) > settings.travel_share * abs(asked) + settings.travel_margin + lag
        self._off = self._off + 1 if off else 0
        if self._off < settings.in_a_row:
            return None
        span = last.time - first.time
        why = "is it driven, and is x_scale right?"
        if gone * asked < 0:
            why = "is its drive or its sensor wired the other way round?"
        return Finding(
            SafetyRule.CARRIAGE_DEVIATES,
            f"the carriage went {gone * 1e3:.3g} mm in {span:.2g} s, {asked * 1e3:.3g} mm were "
            f"commanded ({why})",
            gone / span,
        )

    # Height and simulation ----------------------------------------------------------------------

    def _stays_stuck(
        self, output: TickOutput, watch: ReadingMonitor, time: float
    ) -> Finding | None:
        settings, limits = self._settings, self._loop.readings
        if not watch.stuck:
            self._stuck_height = math.nan
            return None
        if math.isnan(self._stuck_height):
            self._stuck_height = output.before.z
        still = time - watch.still_since
        moved = abs(output.after.z - self._stuck_height) > settings.stuck_simulated
        if still < limits.still + settings.stuck_time or not (limits.noisy_at_rest or moved):
            return None
        return Finding(
            SafetyRule.STAYS_STUCK,
            f"z has not changed for {still:.2g} s while the wheel turns: the scale is stuck",
            still,
        )

    def _simulation(self, output: TickOutput, time: float, ramping: bool) -> list[Finding | None]:
        settings, heights = self._settings, self._heights
        heights.append((time, output.after.z))
        while heights[0][0] < time - settings.simulated_time:
            heights.popleft()
        found: list[Finding | None] = []
        change = heights[-1][1] - heights[0][1]
        if not abs(change) <= settings.simulated_jump:
            sentence = (
                f"the simulated height changes by {change * 1e3:.3g} mm in "
                f"{settings.simulated_time:g} s: zeta is {output.after.zeta:.3g}"
            )
            found.append(Finding(SafetyRule.SIMULATION_JUMPS, sentence, change))
        low, high = self._omega_range()
        asked, margin = output.asked.vx, settings.rolling_margin
        fastest = settings.rolling_share * self._radius * max(high, output.asked.omega, 0.0)
        slowest = settings.rolling_share * self._radius * min(low, output.asked.omega, 0.0)
        if not (ramping or slowest - margin <= asked <= fastest + margin):
            sentence = (
                f"the simulation asks for {asked:.3g} m/s, a wheel that is driven rolls at "
                f"{slowest:.3g} to {fastest:.3g} m/s"
            )
            found.append(Finding(SafetyRule.SPEED_DOUBTED, sentence, asked))
        hold = self._loop.hold
        if hold is not None and output.at_bound:
            sentence = f"zeta is at its bound, {output.after.zeta:.3g}, and is held there"
            found.append(Finding(SafetyRule.ZETA_AT_BOUND, sentence, output.after.zeta))
        return found
