"""Which run to make next, so that a named parameter becomes identifiable.

The angular velocity over time, the load and the start angle are moved down the slope of the
parameter's standard error, which comes of the Fisher information of the simulated run.
"""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from drftjax.arrays import require_between
from drftjax.ensemble import map_runs, stack
from drftjax.errors import InputError
from drftjax.integrator import steady_step
from drftjax.rollout import step_times
from drftjax.saved import thinned
from drftjax.setup import CommandSetUp, SetUp
from drftjax.statics import sinkage_under_load
from drftjax.stress import Rounded
from drftjax.trial import ROW_INTERVAL, Trial
from identify.information import (
    MARGIN,
    SMALLEST_EFFECT,
    Instrument,
    Knowledge,
    Objective,
    Profile,
    alike,
    counted,
    knowledge,
    scales,
    sensitivities,
    with_gradient,
)
from identify.limits import Limits
from identify.parameter import Quantity, parameter

DESIGN_SCHEMA = "drft-design"

# Share of the run at its end that the search leaves out.
LEFT_OUT = 0.08
# Runs evaluated in one call: so many are padded to, and only one program is compiled.
TOGETHER = 4

Progress = Callable[[str], None]


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
    steps: int = 3
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


def _percent(knows: Knowledge) -> str:
    return f" ({knows.relative:.2%})" if math.isfinite(knows.relative) else ""


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


def promised(
    setup: SetUp,
    parameter_name: str,
    nuisances: Sequence[str] | None = None,
    instrument: Instrument | None = None,
) -> Option:
    """What one run of a set-up as it stands would tell of a parameter; see `design`."""
    instrument = instrument or Instrument()
    instrument.check()
    judge = _Judge(setup, _quantities(parameter_name, nuisances), instrument, Limits())
    return judge.options([setup.title], [judge.setup_of(thinned(setup.command))])[0]


def search_objective(
    setup: SetUp,
    parameter_name: str,
    nuisances: Sequence[str] | None = None,
    *,
    limits: Limits | None = None,
    instrument: Instrument | None = None,
    search: Search | None = None,
) -> Objective:
    """What a search goes down: the logarithm of a standard error, on coarse rounded plates.

    Args:
        setup, parameter_name, nuisances, limits, instrument, search: As for `design`.

    Raises:
        InputError: for names that cannot be.
    """
    instrument, limits = instrument or Instrument(), limits or Limits()
    judge = _Judge(setup, _quantities(parameter_name, nuisances), instrument, limits)
    return _objective(judge, search or Search())


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


@eqx.filter_jit
def _derived(trials: Trial, quantities: list[Quantity], scale: Array) -> Array:
    return map_runs(lambda trial, scale: sensitivities(trial, quantities, scale), trials, scale)


class _Judge:
    """Evaluates set-ups: what a run of each would tell."""

    def __init__(
        self, setup: SetUp, quantities: list[Quantity], instrument: Instrument, limits: Limits
    ):
        self.base = setup
        self.quantities = quantities
        self.instrument = instrument
        self.limits = limits

    def setup_of(self, command: CommandSetUp, **start: float) -> SetUp:
        """The base set-up under another command, at a step that holds its derivatives."""
        setup = copy.deepcopy(self.base)
        setup.command = command
        built = command.build()
        setup.integrator.method = "held pace"
        setup.integrator.step = steady_step(setup.wheel.radius, built.time, built.omega)
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
        trials = [alike(each, finest, knots, longest) for each in setups]
        scale = scales(trials[0], self.quantities)
        options = []
        for first in range(0, len(trials), TOGETHER):
            some = trials[first : first + TOGETHER]
            padded = some + some[-1:] * (TOGETHER - len(some))
            derived = np.asarray(_derived(stack(padded), self.quantities, jnp.asarray(scale)))
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


@eqx.filter_jit
def _descend(
    start: Float[Array, " free"], objective: Objective, steps: int
) -> Float[Array, " free"]:
    solver = optx.BFGS(rtol=1e-3, atol=1e-3)
    function = lambda c, objective: with_gradient(objective, c)  # noqa: E731
    found = optx.minimise(function, solver, start, objective, max_steps=steps, throw=False)
    return found.value


def _rounded(trial: Trial) -> Trial:
    """The trial with a stress law whose derivatives have no jumps, so that they have slopes."""
    return eqx.tree_at(lambda t: t.simulator.terrain.law.corners, trial, Rounded())


def _objective(judge: _Judge, search: Search) -> Objective:
    """The standard error around the given set-up, on coarse plates with rounded corners."""
    setup = copy.deepcopy(judge.base)
    setup.wheel.plate_size = max(search.plate_size, setup.wheel.plate_size)
    limit = judge.limits
    profile = Profile(search.knots, limit.speed, limit.acceleration, limit.duration, limit.rest)
    setup.command = CommandSetUp(profile.time.tolist(), np.zeros(search.knots + 4).tolist())
    # The whole step is fast, and the rows of the last slow-down, where it is too long, are not
    # needed to tell profiles apart.
    setup.integrator.step = steady_step(
        setup.wheel.radius, np.array([0.0, 1.0]), np.array([0.0, limit.acceleration])
    )
    trial = _rounded(setup.trial())
    loads, depths = np.zeros(0), np.zeros(0)
    if limit.loads is not None:
        loads = np.array(limit.loads) / setup.rig.gravity
        depths = np.array([judge.deeper(each) for each in limit.loads])
    ends = np.asarray(step_times(trial.rows, ROW_INTERVAL))
    until = (limit.duration - limit.rest) * (1 - LEFT_OUT)
    counts = np.concatenate([[1.0], ends <= until]).astype(float)
    scale = scales(trial, judge.quantities)
    weight = judge.instrument.weight()
    real = jnp.asarray
    return Objective(
        trial,
        profile,
        real(loads),
        real(depths),
        real(scale),
        real(weight),
        real(counts),
        tuple(judge.quantities),
    )


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
    ends = [_descend(jnp.asarray(each), objective, search.steps) for each in points]
    options = []
    for start, end in zip(starts, map(np.asarray, ends), strict=True):
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
