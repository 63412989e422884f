r"""Fisher information of a trial on its parameters, before it is made.

With the derivatives $J_c = \partial y_c / \partial\theta$ of each channel at its rows and white
instrument noise $\sigma_c$, the information is $F = \sum_c J_c^\top J_c / \sigma_c^2$. The
information on one parameter, where the others (nuisances) are found from the same run, is the Schur
complement $s = F_{tt} - F_{tn} F_{nn}^{-1} F_{nt}$, and its standard error $1 / \sqrt{s}$.
"""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.common.arrays import as_real, require_between
from drftjax.common.errors import InputError
from drftjax.runlog.record import CHANNELS
from drftjax.runlog.schema import UNITS
from drftjax.setups.setup import SetUp
from drftjax.simulation.ensemble import map_runs
from drftjax.simulation.trial import ROW_INTERVAL, Trial, pad_trial
from identify.parameters.parameter import Quantity

POSITIONS = ("x", "z")


# Share of a parameter's effect that its nuisances cannot imitate, at least: below it lie rounding
# and plates that turn over, and the run does not identify the parameter [-].
SMALLEST_SHARE = 1e-5


# Smallest effect of a parameter, in standard deviations over the whole run [-].
SMALLEST_EFFECT = 1e-9


# Speeds and loads start this share of the way inside their bounds: a sigmoid has a slope there [-].
BOUND_MARGIN = 0.01


# Turn of the wheel that stands for no limit [rad]; infinity would leave no derivative.
UNLIMITED_TURN = 1e9


def parameter_scales(trial: Trial, quantities: Sequence[Quantity]) -> np.ndarray:
    """Scale of each parameter: its own size, or its unit where it is zero."""
    values = np.array([abs(float(each.read(trial))) for each in quantities])
    return np.where(values > 0, values, 1.0)


def sensitivities(
    trial: Trial, quantities: Sequence[Quantity], scale: Float[Array, " parameters"]
) -> Float[Array, "channels rows parameters"]:
    """Return exact derivatives of every channel at every row by parameter, per `scale`.

    One forward sweep for all parameters; it may itself be differentiated.

    Args:
        trial: Run to differentiate.
        quantities: Parameters.
        scale: Size of one unit of each, from `scales`.
    """

    def simulated(change: Float[Array, " parameters"]) -> Float[Array, "channels rows"]:
        changed = trial
        for index, quantity in enumerate(quantities):
            value = quantity.read(trial) + scale[index] * change[index]
            changed = quantity.write(changed, value)
        output = changed.run()
        return jnp.stack([getattr(output, each) for each in CHANNELS])

    return jax.jacfwd(simulated)(jnp.zeros(len(quantities), scale.dtype))


def information(
    derivatives: Float[Array, "channels rows parameters"],
    weight: Float[Array, " channels"],
    counts: Float[Array, " rows"],
) -> Float[Array, "parameters parameters"]:
    """Return the Fisher information of a run.

    Args:
        derivatives: From `sensitivities`.
        weight: 1 / noise of each channel, 0 of one that is not measured.
        counts: 1 for rows that are compared, 0 for others.
    """
    weighted = derivatives * weight[:, None, None] * counts[None, :, None]
    return jnp.einsum("crp,crq->pq", weighted, weighted)


def log_error(fisher: Float[Array, "parameters parameters"]) -> Float[Array, ""]:
    """Return the logarithm of the first parameter's standard error, the others eliminated."""
    # Nuisances in units of their own effect: the solve then loses no digits to their sizes.
    size = jnp.sqrt(jnp.diag(fisher))
    others = fisher[1:, 1:] / jnp.outer(size[1:], size[1:])
    mixed = fisher[0, 1:] / size[1:]
    remaining = fisher[0, 0] - mixed @ jnp.linalg.solve(others, mixed)
    return -0.5 * jnp.log(remaining)


@dataclass(frozen=True)
class ParameterInformation:
    """Information of one run on the first of its parameters.

    Attributes:
        value: The parameter's own value.
        error: Its standard error by white noise, nuisances eliminated; infinite where it is not
            identified.
        alone: The same, were every nuisance known.
        share: Part of its effect that the nuisances cannot imitate [-].
        imitator: Nuisance that imitates it most, or "" without any.
        effect: Its effect over the whole run, in standard deviations, for a change by its scale.
        shift: Largest shift of the fitted value by a model error of 1 m RMS in each position.
    """

    value: float
    error: float
    alone: float
    share: float
    imitator: str
    effect: float
    shift: float

    @property
    def relative(self) -> float:
        """Standard error as a share of the value [-]; infinite for a value of zero."""
        return self.error / abs(self.value) if self.value else float("inf")


def parameter_information(
    derivatives: np.ndarray,
    weight: np.ndarray,
    counts: np.ndarray,
    quantities: Sequence[Quantity],
    value: float,
    scale: float,
) -> ParameterInformation:
    """Information on the first parameter from the derivatives of a run.

    By a QR decomposition rather than the information, which has only half the digits.

    Args:
        derivatives, weight, counts: As for `information`.
        quantities: The parameters, the one asked for first.
        value, scale: Its value, and the size of a unit of its derivative.

    Raises:
        InputError: where the simulation diverges.
    """
    if not np.isfinite(derivatives).all():
        raise InputError("the simulation diverges on this profile; a lower acceleration may hold")
    whitened = derivatives * weight[:, None, None] * counts[None, :, None]
    columns = whitened.reshape(-1, len(quantities))
    target, others = columns[:, 0], columns[:, 1:]
    scale, effect = float(scale), float(np.linalg.norm(target))
    sizes = np.linalg.norm(others, axis=0)
    seen = np.flatnonzero(sizes > SMALLEST_EFFECT)
    basis = others[:, seen] / sizes[seen]
    cosines = np.abs(basis.T @ target) / max(effect, SMALLEST_EFFECT)
    imitator = quantities[1 + seen[int(np.argmax(cosines))]].label if len(seen) else ""
    left = target
    if len(seen):
        # Nuisances that imitate one another span less than they are; the rest must not count.
        vectors, values, _ = np.linalg.svd(basis, full_matrices=False)
        span = vectors[:, values > SMALLEST_SHARE * values[0]]
        for _ in range(2):  # the second takes away what rounding left of the first
            left = left - span @ (span.T @ left)
    remains = float(np.linalg.norm(left))
    share = remains / effect if effect > SMALLEST_EFFECT else 0.0
    if share <= SMALLEST_SHARE:
        return ParameterInformation(value, np.inf, np.inf, share, imitator, effect, np.inf)
    # Fitted change = gain . whitened error; the worst error of a channel lies along its gain.
    gain = (left / remains**2).reshape(whitened.shape[:2])
    number = float(counts.sum())
    worst = sum(
        weight[index] * np.linalg.norm(gain[index]) * np.sqrt(number)
        for index, channel in enumerate(CHANNELS)
        if channel in POSITIONS
    )
    return ParameterInformation(
        value, scale / remains, scale / effect, share, imitator, effect, scale * float(worst)
    )


@dataclass(frozen=True)
class InstrumentNoise:
    """Measured channels and their noise.

    Attributes:
        noise: Standard deviation of each channel's white noise [m, N, N m].
        channels: Those that a run records; the others are evaluated as additions.
    """

    noise: dict[str, float] = field(
        default_factory=lambda: {"x": 5e-5, "z": 2e-5, "fx": 0.5, "fz": 0.5, "torque": 0.05}
    )
    channels: tuple[str, ...] = ("x", "z")

    def check(self) -> None:
        """Raise InputError for channels that are not known, or without noise."""
        for name in (*self.noise, *self.channels):
            if name not in CHANNELS:
                raise InputError(f"there is no channel {name!r}; give one of {', '.join(CHANNELS)}")
        for name, value in self.noise.items():
            require_between(f"the noise of {name}", value, 1e-9, 1e6, f" {UNITS['measured'][name]}")
        lacking = [name for name in self.channels if name not in self.noise]
        if lacking or not self.channels:
            raise InputError(
                f"the noise of {lacking[0]} is not given" if lacking else "no channel is measured"
            )

    def weight(self, extra: str | None = None) -> np.ndarray:
        """Return 1 / noise of the recorded channels and one more where named; 0 of the rest."""
        measured = {*self.channels, extra}
        return np.array([1 / self.noise[c] if c in measured else 0.0 for c in CHANNELS])

    @property
    def additions(self) -> list[str]:
        """Channels that are not recorded but could be."""
        return [c for c in CHANNELS if c in self.noise and c not in self.channels]


def compared_rows(setup: SetUp, rows: int, interval: float = ROW_INTERVAL) -> np.ndarray:
    """Return 1 for the rows until wheel and carriage stop for good, which a fit compares, else 0.

    Args:
        setup: Gives the command.
        rows: Their number, the start's included.
        interval: Time between them [s].
    """
    command = setup.command.build()
    time = command.time - command.time[0]
    driven = 0.0 if command.vx is None else command.vx
    moving = np.flatnonzero((command.omega != 0) | (driven != np.zeros_like(time)))
    end = time[min(moving[-1] + 1, len(time) - 1)] if len(moving) else time[-1]
    return (np.arange(rows) * interval <= end + 1e-9).astype(float)


def stackable_trial(setup: SetUp, step: float, knots: int, duration: float) -> Trial:
    """Return the set-up's trial with this number of knots and duration [s], to be stacked."""
    setup = copy.deepcopy(setup)
    setup.integrator.step = step
    trial = setup.trial()
    return pad_trial(trial, math.ceil(duration / (trial.every * step) - 1e-9), knots)


def _at_most_farthest(turn: float) -> Float[Array, ""]:
    return jnp.minimum(as_real(turn), UNLIMITED_TURN)


class SpeedProfile(eqx.Module):
    """Speeds at even knots, as a smooth function of free coordinates, inside a rig's limits.

    Each knot lies between the lowest and the highest speed that the last one, the acceleration and
    the stop ahead allow; the sigmoid of its coordinate is the share of the way between. All are
    slowed down alike where the wheel would turn too far. Every profile within the limits that is
    not slowed down has exactly one set of coordinates.

    Attributes:
        knots: Their number.
        speed, acceleration: The largest [rad/s, rad/s2].
        duration, rest: Of the run, and of its rests at both ends [s].
        turn: Farthest that the wheel may turn [rad].
    """

    # Arrays, so that one compiled program serves all limits.
    knots: int = eqx.field(static=True)
    speed: Float[Array, ""] = eqx.field(converter=as_real)
    acceleration: Float[Array, ""] = eqx.field(converter=as_real)
    duration: Float[Array, ""] = eqx.field(converter=as_real)
    rest: Float[Array, ""] = eqx.field(converter=as_real)
    turn: Float[Array, ""] = eqx.field(converter=_at_most_farthest, default=UNLIMITED_TURN)

    @property
    def time(self) -> Float[Array, " all"]:
        """Knots, rests included [s]."""
        moving = jnp.linspace(self.rest, self.duration - self.rest, self.knots + 2)
        return jnp.concatenate([jnp.zeros(1, moving.dtype), moving, self.duration[None]])

    def _reach(self, index: int, last: Array) -> tuple[Array, Array]:
        """Return the lowest and highest speed that can follow `last` [rad/s]."""
        change = self.acceleration * (self.duration - 2 * self.rest) / (self.knots + 1)
        stop = jnp.minimum(self.speed, change * (self.knots - index))
        return jnp.maximum(0.0, last - change), jnp.minimum(stop, last + change)

    def omega(self, coordinates: Float[Array, " knots"]) -> Float[Array, " all"]:
        """Return the angular velocity at `time` [rad/s]."""
        speeds = [jnp.zeros((), coordinates.dtype)]
        for index in range(self.knots):
            low, high = self._reach(index, speeds[-1])
            speeds.append(low + (high - low) * jax.nn.sigmoid(coordinates[index]))
        nought = jnp.zeros((), coordinates.dtype)
        omega = jnp.stack([nought, *speeds, nought, nought])
        # A wheel that hardly turns may turn as far as it does.
        turned = jnp.maximum(jnp.trapezoid(omega, self.time), 1.0 / UNLIMITED_TURN)
        return omega * jnp.minimum(1.0, self.turn / turned)

    def coordinates(self, wanted: np.ndarray) -> np.ndarray:
        """Return the coordinates of the profile nearest to these speeds at the knots [rad/s]."""
        places, last = [], jnp.zeros(())
        for index, speed in enumerate(wanted):
            low, high = self._reach(index, last)
            share = float(np.clip((speed - low) / (high - low), BOUND_MARGIN, 1 - BOUND_MARGIN))
            places.append(math.log(share / (1 - share)))
            last = low + (high - low) * share
        return np.array(places)


class Objective(eqx.Module):
    """Logarithm of the standard error as a function of a run's free coordinates.

    Coordinates: the profile's knots, then the load within its bounds where it is free, then the
    start angle in radians.

    Attributes:
        trial: The run but for its free coordinates.
        profile: Of the angular velocity.
        loads: Lowest and highest mass on the wheel [kg]; empty where it is not free.
        depths: Additional sinkage of the standing wheel under them [m].
        scale, weight, counts: See `sensitivities` and `information`.
        quantities: The parameter, then its nuisances.
    """

    trial: Trial
    profile: SpeedProfile
    loads: Float[Array, " bounds"]
    depths: Float[Array, " bounds"]
    scale: Float[Array, " parameters"]
    weight: Float[Array, " channels"]
    counts: Float[Array, " rows"]
    quantities: tuple[Quantity, ...]

    def trial_at(self, coordinates: Float[Array, " free"]) -> Trial:
        """Return the run at these coordinates."""
        trial = self.trial
        knots = self.profile.knots
        position, mass = trial.start.position, trial.simulator.rig.mass_z
        if self.loads.size:
            share = jax.nn.sigmoid(coordinates[knots])
            mass = self.loads[0] + share * (self.loads[1] - self.loads[0])
            deeper = self.depths[0] + share * (self.depths[1] - self.depths[0])
            position = position.at[1].add(-deeper)
        return eqx.tree_at(
            lambda t: (t.omega, t.start.angle, t.start.position, t.simulator.rig.mass_z),
            trial,
            (self.profile.omega(coordinates[:knots]), coordinates[-1], position, mass),
        )

    def __call__(self, coordinates: Float[Array, " free"]) -> Float[Array, ""]:
        derivatives = sensitivities(self.trial_at(coordinates), self.quantities, self.scale)
        return log_error(information(derivatives, self.weight, self.counts))


@eqx.filter_custom_jvp
def with_gradient(objective: Objective, coordinates: Float[Array, " free"]) -> Float[Array, ""]:
    """Return the objective, with its whole gradient as derivative at once.

    A solver may then linearise it without storing every step of the run.
    """
    return objective(coordinates)


@with_gradient.def_jvp
def _with_gradient_jvp(primals, tangents):
    objective, coordinates = primals
    value, gradient = value_and_gradient(objective, coordinates)
    return value, gradient @ tangents[1]


def value_and_gradient(
    objective: Objective, coordinates: Float[Array, " free"]
) -> tuple[Float[Array, ""], Float[Array, " free"]]:
    """The objective [-] and its exact gradient, forward over forward: a sweep for each coordinate.

    It is a slope to follow where the trial's stress law is rounded
    (`drftjax.physics.stress.Rounded`); `docs/guide/design.md` has what it is otherwise.
    """

    def along(line: tuple[Array, Array], objective: Objective) -> tuple[Array, Array]:
        at, direction = line
        return jax.jvp(objective, (at,), (direction,))

    directions = jnp.eye(len(coordinates))
    # Were the place the same for all, a solver would keep every step of a run there.
    places = jnp.broadcast_to(coordinates, directions.shape)
    values, gradient = map_runs(along, (places, directions), objective)
    return values[0], gradient
