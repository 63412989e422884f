"""Design of the next run, so that a named parameter becomes identifiable.

The angular velocity over time, the load and the start angle are moved down the slope of the
parameter's standard error, which comes of the Fisher information of the simulated run.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drftjax.common.arrays import require_between
from drftjax.common.errors import InputError
from drftjax.setups.command_knots import decimate_command
from drftjax.setups.setup import CommandSetUp, SetUp
from identify.design.fisher_information import (
    SMALLEST_EFFECT,
    InstrumentNoise,
    Objective,
    ParameterInformation,
)
from identify.design.limits import Limits
from identify.design.options import RunEvaluator, RunOption, quantities_named
from identify.design.search import DesignSettings, Progress, local_optimum, objective_of

DESIGN_SCHEMA = "drft-design"


@dataclass(frozen=True, eq=False)
class Design:
    """The run to make next, and those it was chosen from.

    Attributes:
        parameter, unit, nuisances: Names in reports.
        given: The given profile.
        violations: Sentences on limits that it exceeds; none where it can be run.
        best: The run to make: that of least standard error, the given one among them if it can be.
        found: Ends of the descents.
        scan: Trapezoids to rising peak speeds.
        peaks: Those speeds [rad/s].
        others: The best profile under other loads and from other start angles.
        wanted: Standard error that counts as identified, as a share of the value [-].
        model_error: Of x and z, RMS [m].
        noise, channels: See `InstrumentNoise`.
    """

    parameter: str
    unit: str
    nuisances: tuple[str, ...]
    given: RunOption
    violations: tuple[str, ...]
    best: RunOption
    found: tuple[RunOption, ...]
    scan: tuple[RunOption, ...]
    peaks: tuple[float, ...]
    others: tuple[RunOption, ...]
    wanted: float
    model_error: float
    noise: dict[str, float]
    channels: tuple[str, ...]

    @property
    def identifiable(self) -> bool:
        """True if some run within the limits separates the parameter from its nuisances."""
        return math.isfinite(self.best.information.error)

    @property
    def factor(self) -> float:
        """Standard error now over that with the best run added [-]."""
        return (
            self.given.information.error / self.best.information.error if self.identifiable else 1.0
        )

    def shift(self, option: RunOption) -> float:
        """Return the largest shift of the fitted value by the model error."""
        return option.information.shift * self.model_error

    def speed_needed(self, with_model_error: bool = False) -> float | None:
        """Return the peak speed that identifies the parameter [rad/s]; None within the limits.

        Between scanned speeds the error is taken as a power of the speed.

        Args:
            with_model_error: Count the shift by the model error as well.
        """
        value = abs(self.given.information.value)

        def error(each: RunOption) -> float:
            return each.information.error + (self.shift(each) if with_model_error else 0.0)

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
        """Return the outcome in a few sentences."""
        name, now, best = self.parameter, self.given.information, self.best.information
        if not self.identifiable:
            if best.effect <= SMALLEST_EFFECT:
                return f"{name} moves no measured channel: no run within the limits can tell it."
            return (
                f"{name} cannot be told from {best.imitator}: whatever the profile, the nuisances "
                f"({', '.join(self.nuisances)}) imitate all but {best.share:.1g} of its effect. "
                "Hold one of them at a known value, or measure it otherwise."
            )
        peak = math.degrees(max(self.best.setup.command.build().omega))
        if self.best is self.given:
            change = "no run within the limits was found that tells more than the given one"
        elif self.factor >= 1:
            change = f"{self.factor:.3g} times smaller"
        else:
            change = (
                f"{1 / self.factor:.3g} times larger, as the given profile cannot be run: "
                f"{' and '.join(self.violations)}"
            )
        lines = [
            f"{name} = {now.value:.4g}: standard error {now.error:.3g} with the given profile"
            f"{_percent(now)}, {best.error:.3g} with the best one{_percent(best)}, up to "
            f"{peak:.0f} deg/s over {self.best.rim_travel:.3g} m of the rim (the given profile's "
            f"is {self.given.rim_travel:.3g} m): {change}.",
            f"An error of the model itself of {self.model_error * 1e3:.3g} mm in x and z, in its "
            f"worst shape, shifts {name} by {self.shift(self.given):.3g} with the given profile "
            f"and by {self.shift(self.best):.3g} with the best one.",
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


def _percent(knows: ParameterInformation) -> str:
    return f" ({knows.relative:.2%})" if math.isfinite(knows.relative) else ""


def trapezoid(
    limits: Limits,
    radius: float,
    peak: float,
    shortest_hold: float = DesignSettings.shortest_hold,
) -> CommandSetUp:
    """Return a profile up to `peak`, or as near as the limits allow, and down at the largest rate.

    Args:
        limits: Of the rig; the run ends early where its travel does.
        radius: Of the wheel's rim [m].
        peak: Angular velocity that is wanted [rad/s].
        shortest_hold: See `DesignSettings`.
    """
    rest, end = limits.rest, limits.duration - limits.rest
    turn = limits.travel / radius
    ramp = min(
        peak / limits.acceleration,
        (end - rest) / shortest_hold / 2,
        math.sqrt(turn / limits.acceleration / shortest_hold),
    )
    peak = ramp * limits.acceleration
    end = min(end, rest + turn / peak + ramp)
    time = [0.0, rest, rest + ramp, end - ramp, end, end + rest]
    return CommandSetUp(time, [0.0, 0.0, peak, peak, 0.0, 0.0])


def design(
    setup: SetUp,
    parameter_name: str = "lambda",
    *,
    nuisances: Sequence[str] | None = None,
    limits: Limits | None = None,
    instrument: InstrumentNoise | None = None,
    search: DesignSettings | None = None,
    wanted: float = 0.1,
    model_error: float = 5e-5,
    progress: Progress | None = None,
) -> Design:
    """Return the run within the limits that has most information on a parameter.

    Args:
        setup: Wheel, sand and rig as believed, and the given profile.
        parameter_name: Parameter that is to be identified, such as "lambda".
        nuisances: Parameters found from the same run; zeta and lambda where None.
        limits: Of the rig.
        instrument: Measured channels and their noise.
        search: Numbers of the search.
        wanted: Standard error, as a share of the value, that counts as identified [-].
        model_error: Error of the model itself in x and z, RMS [m]; its worst shape is judged.
        progress: Called with a description of the work in progress.

    Raises:
        InputError: for names, limits or set-ups that cannot be.
    """
    limits, instrument, search = (
        limits or Limits(),
        instrument or InstrumentNoise(),
        search or DesignSettings(),
    )
    report = progress or (lambda what: None)
    quantities = quantities_named(parameter_name, nuisances)
    if setup.rig.carriage != "free":
        raise InputError("the carriage is driven; a profile is designed for a free carriage")
    limits.check(setup.wheel.radius)
    instrument.check()
    require_between("the wanted standard error", wanted, 1e-6, 10.0, " of the value")
    require_between("the model error", model_error, 0.0, 0.1, " m")
    require_between("the free knots", search.knots, 2, 40)
    require_between("the scanned speeds", search.scan, 2, 40)
    require_between("the starts", search.starts, 1, search.scan)

    judge = RunEvaluator(setup, quantities, instrument, limits)
    for load in limits.loads or ():
        judge.extra_sinkage(load)  # refuses what the sand does not bear, before the search
    radius = setup.wheel.radius
    hold = search.shortest_hold
    fastest = max(trapezoid(limits, radius, limits.speed, hold).omega)
    peaks = np.geomspace(search.slowest_peak * fastest, fastest, search.scan).tolist()
    given = judge.setup_for(decimate_command(setup.command))
    ramps = [judge.setup_for(trapezoid(limits, radius, peak, hold)) for peak in peaks]
    report(f"the given profile and {search.scan} peak speeds")
    now, *scan = judge.evaluate(["given profile", *map(_trapezoid_name, peaks)], [given, *ramps])

    unseen = not any(math.isfinite(each.information.error) for each in scan)
    found: list[RunOption] = []
    if not unseen:
        order = np.argsort([each.information.error for each in scan])[: search.starts]
        found = local_optimum(judge, search, [scan[index] for index in order], report)
        report("the profiles found, on the real plates")
        found = judge.evaluate([each.name for each in found], [each.setup for each in found])
    # A long plateau at the limit may be best: the search must not lose to where it began, nor to
    # what is run already.
    beyond = tuple(limits.violations(given.command.build(), radius))
    able = [*found, *scan] if beyond else [*found, *scan, now]
    best = min(able, key=lambda each: each.information.error)
    report("other loads and start angles")
    others = [] if unseen else judge.evaluate(*_variations(judge, best.setup))
    return Design(
        quantities[0].label,
        quantities[0].unit,
        tuple(each.label for each in quantities[1:]),
        now,
        beyond,
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


def evaluate_setup(
    setup: SetUp,
    parameter_name: str,
    nuisances: Sequence[str] | None = None,
    instrument: InstrumentNoise | None = None,
) -> RunOption:
    """Information on a parameter of one run of a set-up as it stands; see `design`."""
    instrument = instrument or InstrumentNoise()
    instrument.check()
    judge = RunEvaluator(setup, quantities_named(parameter_name, nuisances), instrument, Limits())
    return judge.evaluate([setup.title], [judge.setup_for(decimate_command(setup.command))])[0]


def search_objective(
    setup: SetUp,
    parameter_name: str,
    nuisances: Sequence[str] | None = None,
    *,
    limits: Limits | None = None,
    instrument: InstrumentNoise | None = None,
    search: DesignSettings | None = None,
) -> Objective:
    """Objective of a search: the logarithm of a standard error, on coarse rounded plates.

    Args:
        setup, parameter_name, nuisances, limits, instrument, search: As for `design`.

    Raises:
        InputError: for names that cannot be.
    """
    instrument, limits = instrument or InstrumentNoise(), limits or Limits()
    judge = RunEvaluator(setup, quantities_named(parameter_name, nuisances), instrument, limits)
    return objective_of(judge, search or DesignSettings())


def _trapezoid_name(peak: float) -> str:
    return f"trapezoid to {math.degrees(peak):.0f} deg/s"


def _variations(judge: RunEvaluator, best: SetUp) -> tuple[list[str], list[SetUp]]:
    """Return names and set-ups of the best run under other loads and from other start angles."""
    own = best.rig.mass_z * best.rig.gravity
    names, setups = [], []
    for load in judge.limits.loads or (0.8 * own, 1.2 * own):
        try:
            setups.append(judge.setup_for(best.command, angle=best.start.angle, load=load))
        except InputError:  # a load that nobody asked for, and that this sand does not bear
            continue
        names.append(f"load {load:.0f} N")
    if best.wheel.shape == "grouser":
        pitch = 2 * math.pi / best.wheel.grouser_count
        for part, word in ((0.25, "a quarter of"), (0.5, "half")):
            angle = best.start.angle + part * pitch
            names.append(f"start angle {word} a grouser pitch on")
            setups.append(judge.setup_for(best.command, angle=angle, load=own))
    return names, setups
