"""Which run to make next, so that a named parameter becomes identifiable.

The angular velocity over time, the load and the start angle are moved down the gradient of the
parameter's standard error. That error comes of the Fisher information of the simulated run, so its
gradient is a second derivative of the simulator: forward over forward, as a run has few of either.
"""

import copy
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import equinox as eqx
import jax.numpy as jnp
import msgspec
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float
from rich.table import Table

from drftjax import __version__
from drftjax.arrays import require_between
from drftjax.ensemble import map_runs, stack
from drftjax.errors import InputError
from drftjax.integrator import LARGEST_CHANGE, STEPS, steady_step
from drftjax.rollout import step_times
from drftjax.saved import thinned
from drftjax.setup import CommandSetUp, SetUp
from drftjax.statics import sinkage_under_load
from drftjax.stress import REST_SPEED
from drftjax.trial import ROW_INTERVAL, Trial
from identify.information import (
    CHANNELS,
    MARGIN,
    SMALLEST_EFFECT,
    Knowledge,
    Objective,
    Profile,
    knowledge,
    scales,
    sensitivities,
    with_gradient,
)
from identify.parameter import Quantity, parameter
from identify.result import UNITS

DESIGN_SCHEMA = "drft-design"

# Wheels that slow down to a stop meet plates at rest again and again; at half the step that
# bounds derivatives on the whole, these bursts are gone from every profile tried.
SAFETY = 2
# Runs evaluated in one call: so many are padded to, and only one program is compiled.
TOGETHER = 4

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Limits:
    """What the rig can do.

    Attributes:
        speed: Largest angular velocity [rad/s].
        acceleration: Largest angular acceleration [rad/s2].
        duration: Of the run, its rests included [s].
        loads: Lowest and highest vertical load [N]; the set-up's own only where None.
    """

    speed: float = math.radians(300.0)
    acceleration: float = math.radians(50.0)
    duration: float = 24.0
    loads: tuple[float, float] | None = None

    @property
    def rest(self) -> float:
        """Rest before and after the motion [s]."""
        return min(1.0, self.duration / 20)

    def check(self, radius: float) -> None:
        """Refuse limits that no run can keep, or that no step can simulate."""
        require_between("the largest speed", math.degrees(self.speed), 1.0, 3000.0, " deg/s")
        fastest = math.degrees(LARGEST_CHANGE * REST_SPEED / (SAFETY * STEPS[-1] * radius))
        require_between(
            "the largest acceleration",
            math.degrees(self.acceleration),
            0.1,
            round(fastest, 1),
            " deg/s2, beyond which derivatives of the simulation are not bounded",
        )
        require_between("the duration", self.duration, 1.0, 600.0, " s")
        if self.loads is not None:
            low, high = self.loads
            require_between("the loads", [low, high], 1.0, 1e4, " N")
            if low >= high:
                raise InputError(f"the loads are {low:g} to {high:g} N; the first must be less")


@dataclass(frozen=True)
class Instrument:
    """What is measured, and how finely.

    Attributes:
        noise: Standard deviation of each channel's white noise [m, N, N m].
        channels: Which of them a run records; the others are judged as additions.
    """

    noise: dict[str, float] = field(
        default_factory=lambda: {"x": 5e-5, "z": 2e-5, "fx": 0.5, "fz": 0.5, "torque": 0.05}
    )
    channels: tuple[str, ...] = ("x", "z")

    def check(self) -> None:
        for name in (*self.noise, *self.channels):
            if name not in CHANNELS:
                raise InputError(f"there is no channel {name!r}; give one of {', '.join(CHANNELS)}")
        for name, value in self.noise.items():
            require_between(f"the noise of {name}", value, 1e-9, 1e6)
        lacking = [name for name in self.channels if name not in self.noise]
        if lacking or not self.channels:
            raise InputError(
                f"the noise of {lacking[0]} is not given" if lacking else "no channel is measured"
            )

    def weight(self, extra: str | None = None) -> np.ndarray:
        """1 / noise of the channels recorded, with one more where named; 0 of the rest."""
        measured = {*self.channels, extra}
        return np.array([1 / self.noise[c] if c in measured else 0.0 for c in CHANNELS])

    @property
    def additions(self) -> list[str]:
        return [c for c in CHANNELS if c in self.noise and c not in self.channels]


@dataclass(frozen=True)
class Search:
    """How hard is searched.

    Attributes:
        knots: Speeds that are free, evenly in time.
        starts: Peak speeds that a descent starts from, the best of the scan.
        steps: Steps of each descent.
        scan: Peak speeds scanned.
        plate_size: Of the wheel while searching [m].
    """

    knots: int = 6
    starts: int = 2
    steps: int = 6
    scan: int = 7
    plate_size: float = 8e-3


@dataclass(frozen=True)
class Option:
    """One run that could be made.

    Attributes:
        name: What is different in it.
        setup: The run, as a set-up.
        knows: What it would tell of the parameter.
        added: The same were this channel recorded as well, by channel.
    """

    name: str
    setup: SetUp
    knows: Knowledge
    added: dict[str, Knowledge]


@dataclass(frozen=True, eq=False)
class Design:
    """The run to make next, beside those it was chosen from.

    Attributes:
        parameter, unit, nuisances: Names in reports.
        now: The profile given.
        best: The run to make.
        found: Where the descents ended.
        scan: Trapezoids to rising peak speeds.
        peaks: Those speeds [rad/s].
        others: The best profile under other loads and from other start angles.
        wanted: Standard error that counts as identified, as a share of the value [-].
        model_error: Of x and z, RMS [m].
        noise, channels: See `Instrument`.
    """

    parameter: str
    unit: str
    nuisances: tuple[str, ...]
    now: Option
    best: Option
    found: tuple[Option, ...]
    scan: tuple[Option, ...]
    peaks: tuple[float, ...]
    others: tuple[Option, ...]
    wanted: float
    model_error: float
    noise: dict[str, float]
    channels: tuple[str, ...]

    @property
    def seen(self) -> bool:
        """Whether any run within the limits tells the parameter from its nuisances."""
        return math.isfinite(self.best.knows.error)

    @property
    def factor(self) -> float:
        """How many times smaller the standard error of the best run is [-]."""
        return self.now.knows.error / self.best.knows.error if self.seen else 1.0

    def shift(self, option: Option) -> float:
        """Largest shift of the fitted value by the model error."""
        return option.knows.shift * self.model_error

    def speed_needed(self, with_model_error: bool = False) -> float | None:
        """Peak speed [rad/s] from which the parameter is identified, or None within the limits.

        Between scanned speeds the error is taken as a power of the speed.

        Args:
            with_model_error: Whether the shift by the model error counts as well.
        """
        value = abs(self.now.knows.value)

        def error(each: Option) -> float:
            return each.knows.error + (self.shift(each) if with_model_error else 0.0)

        shares = np.array([error(each) / value if value else np.inf for each in self.scan])
        below = shares <= self.wanted
        if not below[-1]:
            return None
        # Every faster run must do as well: an error that falls and rises again is no threshold.
        first = int(np.flatnonzero(~below)[-1]) + 1 if not below.all() else 0
        if first == 0 or not np.isfinite(shares[first - 1]):
            return self.peaks[first]
        low, high = np.log(shares[first - 1 : first + 1])
        way = (low - math.log(self.wanted)) / (low - high)
        return float(self.peaks[first - 1] * (self.peaks[first] / self.peaks[first - 1]) ** way)

    def summary(self) -> str:
        """The outcome in a few sentences."""
        name, now, best = self.parameter, self.now.knows, self.best.knows
        if not self.seen:
            if best.effect <= SMALLEST_EFFECT:
                return f"{name} moves no measured channel: no run within the limits can tell it."
            return (
                f"{name} cannot be told from {best.imitator}: whatever the profile, the nuisances "
                f"({', '.join(self.nuisances)}) imitate all but {best.share:.1g} of its effect. "
                "Hold one of them at a known value, or measure it otherwise."
            )
        peak = math.degrees(max(self.best.setup.command.build().omega))
        lines = [
            f"{name} = {now.value:.4g}: standard error {now.error:.3g} with the given profile"
            f"{_percent(now)}, {best.error:.3g} with the best one{_percent(best)}, up to "
            f"{peak:.0f} deg/s: {self.factor:.3g} times smaller.",
            f"An error of the model itself of {self.model_error * 1e3:.3g} mm in x and z, in its "
            f"worst shape, shifts {name} by {self.shift(self.now):.3g} with the given profile and "
            f"by {self.shift(self.best):.3g} with the best one.",
        ]
        for model, words in ((False, "by white noise alone"), (True, "with that model error")):
            needed = self.speed_needed(model)
            speed = (
                "not within the limits"
                if needed is None
                else f"from a peak of about {math.degrees(needed):.0f} deg/s on"
                if needed > self.peaks[0]
                else f"at every speed scanned, {math.degrees(needed):.0f} deg/s and up"
            )
            lines.append(f"Identified to {self.wanted:.0%} {words}: {speed}.")
        return "\n".join(lines)

    def table(self) -> Table:
        """Every run judged, its standard error and the factor gained over the given profile."""
        unit = "" if self.unit == "-" else f" [{self.unit}]"
        table = Table(title=f"standard error of {self.parameter}{unit}, beside {self._beside()}")
        table.add_column("run")
        table.add_column("standard error", justify="right")
        table.add_column("of the value", justify="right")
        table.add_column("factor gained", justify="right")
        table.add_column(f"shift by {self.model_error * 1e3:.3g} mm", justify="right")

        def add(name: str, knows: Knowledge) -> None:
            factor = self.now.knows.error / knows.error if math.isfinite(knows.error) else 0.0
            shift = knows.shift * self.model_error
            share = f"{knows.relative:.2%}" if math.isfinite(knows.relative) else "-"
            table.add_row(name, f"{knows.error:.3g}", share, f"{factor:.3g}", f"{shift:.3g}")

        for head, options in (("", [self.now]), ("best: ", [self.best])):
            for each in options:
                add(head + each.name, each.knows)
                for channel, more in each.added.items():
                    add(f"  with {channel} ({self.noise[channel]:g} {UNITS[channel]})", more)
            table.add_section()
        for group in (self.others, self.found, self.scan):
            for each in group:
                add(each.name, each.knows)
            table.add_section()
        return table

    def _beside(self) -> str:
        return ", ".join(self.nuisances) or "nothing else unknown"

    def document(self) -> dict:
        """The design as plain values, in the layout of the JSON file."""

        def plain(option: Option) -> dict:
            return {
                "name": option.name,
                **_numbers(option.knows),
                "added": {name: _numbers(each) for name, each in option.added.items()},
                "setup": msgspec.to_builtins(option.setup),
            }

        return {
            "schema": DESIGN_SCHEMA,
            "schema_version": 1,
            "software": f"drftjax {__version__}",
            "parameter": self.parameter,
            "unit": self.unit,
            "nuisances": list(self.nuisances),
            "noise": self.noise,
            "channels": list(self.channels),
            "identifiable": self.seen,
            "factor": self.factor,
            "wanted": self.wanted,
            "model_error": self.model_error,
            "speed_needed": self.speed_needed(),
            "speed_needed_with_model_error": self.speed_needed(True),
            "summary": self.summary(),
            "given": plain(self.now),
            "best": plain(self.best),
            "found": [plain(each) for each in self.found],
            "scan": [
                {"peak": peak, **plain(each)}
                for peak, each in zip(self.peaks, self.scan, strict=True)
            ],
            "others": [plain(each) for each in self.others],
        }

    def toml(self) -> str:
        """The run to make, as a set-up file."""
        document = msgspec.to_builtins(self.best.setup)
        built = self.best.setup.command.build()
        time, omega = np.round(built.time, 3), np.round(np.degrees(built.omega), 3)
        document["command"] |= {
            "time": time.tolist(),
            "omega": (omega + 0.0).tolist(),
            "omega_unit": "deg/s",
        }
        document["title"] = f"{self.best.setup.title}, designed for {self.parameter}"
        tables = {
            name: document.pop(name) for name in list(document) if isinstance(document[name], dict)
        }
        lines = [f"# {line}" for line in self.summary().splitlines()]
        lines += [f"{name} = {_toml(value)}" for name, value in document.items()]
        for name, table in tables.items():
            lines += ["", f"[{name}]"]
            lines += [f"{key} = {_toml(v)}" for key, v in table.items() if v is not None]
        return "\n".join(lines) + "\n"


def _toml(value: object) -> str:
    """A value of a set-up as TOML writes it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    # Text and numbers are written alike in JSON and TOML, but for the letters beyond ASCII
    # that JSON may escape in pairs.
    return json.dumps(value, ensure_ascii=False)


def _percent(knows: Knowledge) -> str:
    return f" ({knows.relative:.2%})" if math.isfinite(knows.relative) else ""


def _numbers(knows: Knowledge) -> dict[str, float | str | None]:
    """What a run tells; None where it tells nothing, as JSON has no infinity."""
    values = {name: getattr(knows, name) for name in ("value", "error", "alone", "share", "effect")}
    values["shift_per_metre"] = knows.shift
    finite = {name: float(v) if math.isfinite(v) else None for name, v in values.items()}
    return {**finite, "imitator": knows.imitator}


def trapezoid(limits: Limits, peak: float) -> CommandSetUp:
    """Up to `peak` [rad/s], or as near as the duration allows, and down at the largest rate."""
    rest, end = limits.rest, limits.duration - limits.rest
    ramp = min(peak / limits.acceleration, (end - rest) / 2.02)
    peak = ramp * limits.acceleration
    time = [0.0, rest, rest + ramp, end - ramp, end, limits.duration]
    return CommandSetUp(time, [0.0, 0.0, peak, peak, 0.0, 0.0])


def design(
    setup: SetUp,
    parameter_name: str = "lambda",
    *,
    nuisances: Sequence[str] | None = None,
    limits: Limits | None = None,
    instrument: Instrument | None = None,
    search: Search | None = None,
    wanted: float = 0.1,
    model_error: float = 5e-5,
    progress: Progress | None = None,
) -> Design:
    """The run within the limits that tells most of a parameter.

    Args:
        setup: What is believed of wheel, sand and rig, and the profile given so far.
        parameter_name: Parameter that is to be identified, such as "lambda".
        nuisances: What must be found from the same run; zeta and lambda where None.
        limits: What the rig can do.
        instrument: What is measured.
        search: How hard is searched.
        wanted: Standard error, as a share of the value, that counts as identified [-].
        model_error: Error of the model itself in x and z, RMS [m]; its worst shape is judged.
        progress: Called with what is being done.

    Raises:
        InputError: for names, limits or set-ups that cannot be.
    """
    limits, instrument, search = limits or Limits(), instrument or Instrument(), search or Search()
    report = progress or (lambda what: None)
    quantities = _quantities(parameter_name, nuisances)
    if setup.rig.carriage != "free":
        raise InputError("the carriage is driven; a profile is designed for a free carriage")
    limits.check(setup.wheel.radius)
    instrument.check()
    require_between("the wanted standard error", wanted, 1e-6, 10.0, " of the value")
    require_between("the model error", model_error, 0.0, 0.1, " m")
    require_between("the free knots", search.knots, 2, 40)
    require_between("the scanned speeds", search.scan, 2, 40)
    require_between("the starts", search.starts, 1, search.scan)

    judge = _Judge(setup, quantities, instrument, limits)
    peaks = np.geomspace(limits.speed / 12, limits.speed, search.scan).tolist()
    given = judge.setup_of(thinned(setup.command))
    ramps = [judge.setup_of(trapezoid(limits, peak)) for peak in peaks]
    report(f"the given profile and {search.scan} peak speeds")
    now, *scan = judge.options(["given profile", *map(_trapezoid_name, peaks)], [given, *ramps])

    unseen = not any(math.isfinite(each.knows.error) for each in scan)
    found: list[Option] = []
    if not unseen:
        order = np.argsort([each.knows.error for each in scan])[: search.starts]
        found = _descended(judge, search, [scan[index] for index in order], report)
        report("the profiles found, on the real plates")
        found = judge.options([each.name for each in found], [each.setup for each in found])
    # A long plateau at the limit may be best: the search must not lose to where it began.
    best = min([*found, *scan], key=lambda each: each.knows.error)
    report("other loads and start angles")
    others = [] if unseen else judge.options(*_variations(judge, best.setup))
    return Design(
        quantities[0].label,
        quantities[0].unit,
        tuple(each.label for each in quantities[1:]),
        now,
        best,
        tuple(found),
        tuple(scan),
        tuple(peaks),
        tuple(others),
        wanted,
        model_error,
        instrument.noise,
        instrument.channels,
    )


def _trapezoid_name(peak: float) -> str:
    return f"trapezoid to {math.degrees(peak):.0f} deg/s"


def _quantities(name: str, nuisances: Sequence[str] | None) -> list[Quantity]:
    target = parameter(name, shared=True).quantity
    given = ["zeta", "lambda"] if nuisances is None else nuisances
    others = [parameter(each, shared=True).quantity for each in given]
    names = [each.name for each in others]
    if nuisances is not None and target.name in names:
        raise InputError(f"{name} is asked for, so it cannot be a nuisance as well")
    if len(set(names)) < len(names):
        raise InputError("a nuisance is named twice; name each once")
    return [target, *(each for each in others if each.name != target.name)]


class _Judge:
    """Evaluates set-ups: what a run of each would tell."""

    def __init__(
        self, setup: SetUp, quantities: list[Quantity], instrument: Instrument, limits: Limits
    ):
        self.base = setup
        self.quantities = quantities
        self.instrument = instrument
        self.limits = limits
        self._derive = eqx.filter_jit(
            lambda trials, scale: map_runs(
                lambda trial, scale: sensitivities(trial, quantities, scale), trials, scale
            )
        )

    def setup_of(self, command: CommandSetUp, **start: float) -> SetUp:
        """The base set-up under another command, at a step that holds its derivatives."""
        setup = copy.deepcopy(self.base)
        setup.command = command
        built = command.build()
        setup.integrator.method = "held pace"
        step = steady_step(setup.wheel.radius, built.time, built.omega)
        setup.integrator.step = max(step / SAFETY, STEPS[-1])
        if "angle" in start:
            setup.start.angle = start["angle"]
        if "load" in start:
            setup.rig.mass_z = float(start["load"] / setup.rig.gravity)
            setup.start.sinkage += self.deeper(start["load"])
        return setup

    def load(self) -> float:
        return self.base.rig.mass_z * self.base.rig.gravity

    def deeper(self, load: float) -> float:
        """How much deeper a wheel under another load stands at the start [m]."""
        simulator = self.base.trial().simulator
        zeta = simulator.terrain.zeta
        factor = float(getattr(zeta, "value", np.array([1.0])).ravel()[0])
        depths = [
            float(sinkage_under_load(simulator, factor, each)) for each in (load, self.load())
        ]
        return depths[0] - depths[1]

    def options(self, names: Sequence[str], setups: Sequence[SetUp]) -> list[Option]:
        """What a run of each set-up would tell, on the set-up's own plates."""
        finest = min(each.integrator.step for each in setups)
        knots = max(len(each.command.time) for each in setups)
        longest = max(each.command.time[-1] - each.command.time[0] for each in setups)
        trials = [_alike(each, finest, knots, longest) for each in setups]
        scale = scales(trials[0], self.quantities)
        options = []
        for first in range(0, len(trials), TOGETHER):
            some = trials[first : first + TOGETHER]
            padded = some + some[-1:] * (TOGETHER - len(some))
            derived = np.asarray(self._derive(stack(padded), jnp.asarray(scale)))
            for place, derivatives in enumerate(derived[: len(some)], start=first):
                options.append(self._option(names[place], setups[place], derivatives, scale[0]))
        return options

    def _option(self, name: str, setup: SetUp, derivatives: np.ndarray, scale: float) -> Option:
        counts = counted(setup, derivatives.shape[1])
        value = float(self.quantities[0].read(setup.trial()))

        def told(extra: str | None = None) -> Knowledge:
            weight = self.instrument.weight(extra)
            return knowledge(derivatives, weight, counts, self.quantities, value, scale)

        return Option(name, setup, told(), {each: told(each) for each in self.instrument.additions})


def counted(setup: SetUp, rows: int) -> np.ndarray:
    """1 for the rows until the wheel has stopped for good, as a fit compares them; else 0."""
    command = setup.command.build()
    time = command.time - command.time[0]
    moving = np.flatnonzero(command.omega != 0)
    end = time[min(moving[-1] + 1, len(time) - 1)] if len(moving) else time[-1]
    return (np.arange(rows) * ROW_INTERVAL <= end + 1e-9).astype(float)


def _alike(setup: SetUp, step: float, knots: int, duration: float) -> Trial:
    """The set-up's trial with so many knots, and rows for so long, that it can be stacked."""
    setup = copy.deepcopy(setup)
    setup.integrator.step = step
    trial = setup.trial()
    missing = knots - len(trial.time)
    later = trial.time[-1] + jnp.arange(1.0, missing + 1)
    rows = math.ceil(duration / (trial.every * step) - 1e-9)
    hold = lambda values: jnp.concatenate([values, jnp.repeat(values[-1], missing)])  # noqa: E731
    time = jnp.concatenate([trial.time, later])
    known = trial.simulator, trial.start, time, hold(trial.omega), hold(trial.vx)
    return Trial(*known, trial.step, trial.every, rows)


def _descend(
    start: Float[Array, " free"], objective: Objective, steps: int
) -> Float[Array, " free"]:
    solver = optx.BFGS(rtol=1e-3, atol=1e-3)
    function = lambda c, objective: with_gradient(objective, c)  # noqa: E731
    found = optx.minimise(function, solver, start, objective, max_steps=steps, throw=False)
    return found.value


def _objective(judge: _Judge, search: Search) -> Objective:
    """The standard error around the given set-up, on coarse plates."""
    setup = copy.deepcopy(judge.base)
    setup.wheel.plate_size = max(search.plate_size, setup.wheel.plate_size)
    limit = judge.limits
    profile = Profile(search.knots, limit.speed, limit.acceleration, limit.duration, limit.rest)
    setup.command = CommandSetUp(profile.time.tolist(), np.zeros(search.knots + 4).tolist())
    # Coarse plates reach rest one by one less often, and bear the whole step.
    setup.integrator.step = steady_step(
        setup.wheel.radius, np.array([0.0, 1.0]), np.array([0.0, limit.acceleration])
    )
    trial = setup.trial()
    loads, depths = np.zeros(0), np.zeros(0)
    if limit.loads is not None:
        loads = np.array(limit.loads) / setup.rig.gravity
        depths = np.array([judge.deeper(each) for each in limit.loads])
    ends = np.concatenate([step_times(trial.rows, ROW_INTERVAL)])
    counts = np.concatenate([[1.0], ends <= limit.duration - limit.rest + 1e-9]).astype(float)
    scale = scales(trial, judge.quantities)
    weight = judge.instrument.weight()
    numbers = [jnp.asarray(each) for each in (loads, depths, scale, weight, counts)]
    return Objective(trial, profile, *numbers, tuple(judge.quantities))


def _descended(
    judge: _Judge, search: Search, starts: list[Option], report: Progress
) -> list[Option]:
    objective = _objective(judge, search)
    profile = objective.profile
    points = []
    for each in starts:
        command = each.setup.command
        speeds = np.interp(profile.time[2:-2], command.time, command.omega)
        extra = [judge.base.start.angle]
        if judge.limits.loads is not None:
            low, high = judge.limits.loads
            share = np.clip((judge.load() - low) / (high - low), MARGIN, 1 - MARGIN)
            extra = [math.log(share / (1 - share)), *extra]
        points.append(np.concatenate([profile.coordinates(speeds), extra]))
    report(f"descending from {len(starts)} peak speeds, {search.steps} steps each")
    descend = eqx.filter_jit(eqx.filter_vmap(_descend, in_axes=(0, None, None)))
    ends = descend(jnp.asarray(np.array(points)), objective, search.steps)
    options = []
    for start, end in zip(starts, np.asarray(ends), strict=True):
        if not np.isfinite(end).all():
            continue
        knots = profile.knots
        omega = np.asarray(profile.omega(jnp.asarray(end[:knots])))
        command = CommandSetUp(profile.time.tolist(), omega.tolist())
        chosen = {"angle": float(end[-1])}
        if judge.limits.loads is not None:
            low, high = judge.limits.loads
            chosen["load"] = low + (high - low) / (1 + math.exp(-end[knots]))
        name = f"descended from {start.name}"
        options.append(Option(name, judge.setup_of(command, **chosen), start.knows, {}))
    return options


def _variations(judge: _Judge, best: SetUp) -> tuple[list[str], list[SetUp]]:
    """The best run under other loads, and from other start angles."""
    own = best.rig.mass_z * best.rig.gravity
    loads = judge.limits.loads or (0.8 * own, 1.2 * own)
    names, setups = [], []
    for load in loads:
        names.append(f"load {load:.0f} N")
        setups.append(judge.setup_of(best.command, angle=best.start.angle, load=load))
    if best.wheel.shape == "grouser":
        pitch = 2 * math.pi / best.wheel.grouser_count
        for part, word in ((0.25, "a quarter of"), (0.5, "half")):
            angle = best.start.angle + part * pitch
            names.append(f"start angle {word} a grouser pitch on")
            setups.append(judge.setup_of(best.command, angle=angle, load=own))
    return names, setups
