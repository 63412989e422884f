"""Gauss-Newton steps on one run's zeta(t), with the weight and noise that the data ask for."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from msgspec.structs import replace as replace_struct

from drftjax.common.errors import RunError
from drftjax.physics.command import Command
from drftjax.recorded.batch import Batch
from drftjax.recorded.commanded_motion import is_commanded_to_move
from drftjax.recorded.observation import (
    SMALLEST_NOISE,
    Observation,
    sampling_intervals,
    white_noise,
)
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.setups.terrain_setup import ZetaKnots
from drftjax.simulation.trial import Trial
from identify.zeta_path.evidence import (
    InstrumentFloor,
    LaggedProducts,
    Posterior,
    most_probable,
    smoothest_given,
    smoothness_prior,
)
from identify.zeta_path.path import CHANNELS, ZetaPath, between, cardinal
from identify.zeta_path.simulate import placed, with_zeta_knots

# A step of log zeta that the linearisation is trusted for.
LONGEST_MOVE = 0.3


MOST_STEPS = 25


# Steps end where no knot moves by so much of its standard error.
SMALL_MOVE = 0.3


# They also end where the log probability changes by less than this from one to the next.
SMALL_GAIN = 0.5


# And where the evidence grows no more and what a step promises is less than this share of the
# misfit, half a percent of the residual: under that the noise wanders with the corners of the run.
SMALL_PROMISE = 0.01


# So many refusals in a row, each a step half as long: what is left lies under the simulation's
# resolution, as stops make the misfit rough.
MOST_REFUSED = 3


# Of the first step's second differences: as good as a straight line.
FIRST_WEIGHT = 1e7


# Travel and the noise's correlation join only once a step is shorter than this, in standard errors,
# or lowers the misfit by less than this share of it.
NEAR = 1.0


NEAR_GAIN = 0.1


# Of what travel has summed up: from one sample to the next as good as all of it is left.
SUMMED_CORRELATION = 0.9999


# A knot tells nothing where its samples alone, were all other knots known, leave log zeta open by
# more than this, zeta within a factor e. Nor does one where the wheel stands: its derivative says
# how it would sink further, but a stronger sand would leave it where it is.
TELLS_NOTHING = 1.0


class ZetaPathSolver:
    """One run on its way: where it is, and what its last linearisation said.

    Args:
        candidate: The run.
        batch: The runs that are simulated side by side.
        number: Of this one in the batch.
        grid: Its knots from the run's start [s].
        curve: The spline through as many knots as the batch's longest run has.
        begun: The same run's path to go on from, at other values of what is not fitted here.

    Attributes:
        coordinates: Where to simulate next, as `identify.zeta_path.simulate.placed` takes them.
        settled, converged: Whether no step is left to make, and whether the path is found.
    """

    def __init__(
        self,
        candidate: PreparedRun,
        batch: Batch,
        number: int,
        grid: np.ndarray,
        curve: Float[Array, "ends knots"],
        begun: "ZetaPathSolver | None" = None,
    ):
        self.candidate = candidate
        self.grid, self.knots, self.curve = grid, len(grid), curve
        self.batch, self.number = batch, number
        self.trial: Trial = jax.tree.map(lambda leaf: leaf[number], batch.trials)
        self.channels = batch.channels
        self.counts = np.asarray(batch.observed.weight[number, 0]) > 0
        self.values = np.asarray(batch.observed.values[number])[:, self.counts]
        time = candidate.observation.time[candidate.observation.counts]
        self.intervals = sampling_intervals(time)
        zeta = _believed_zeta(candidate.trial, grid)
        self.coordinates = np.r_[np.log(zeta), 0.0, 0.0]
        self.level = float(np.log(zeta).mean())
        self.moves = _moves(candidate.trial, grid)
        self.lasting = _lasting(time, grid[1] - grid[0])
        self.near = begun is not None
        if begun is not None:
            self.coordinates = begun.coordinates
        self.refused = 0
        self.last: Posterior | None = None
        self.followed = ["z"]
        self.joint = False
        self.promise = np.inf
        self.evidence = -np.inf
        self.objective = np.inf
        self.origin = self.coordinates
        self.move = np.zeros_like(self.coordinates)
        self.residual = np.zeros_like(self.values)
        self.slopes: np.ndarray | None = None
        self.lent = False
        self.steps = 0
        self.settled = self.converged = False

    def advance(self, predicted: np.ndarray, derivative: np.ndarray) -> None:
        """One step: weight, noise and the next linearisation, from this one's numbers.

        Args:
            predicted: Simulated channels at `coordinates` [m], shape (channels, samples).
            derivative: By the coordinates, shape (channels, samples, coordinates).

        Raises:
            RunError: where the run cannot be simulated at the zeta it starts from.
        """
        residual = predicted[:, self.counts] - self.values
        slopes = derivative[:, self.counts]
        known = self.slopes is not None or np.isfinite(slopes).all()
        if not (known and np.isfinite(residual).all()):
            if self.steps == 0:
                raise RunError(
                    self.candidate.name, "its simulation diverges at the zeta it starts from"
                )
            self._shorten()
            return
        gain = np.inf if self.last is None else self.objective - self._objective(residual)
        smooth = self._is_smooth(slopes)
        if gain < -1.0:
            if smooth and self.lent:
                self.slopes = slopes
            self._shorten()
            return
        self.steps += 1
        self.refused = 0
        self.residual = residual
        self.lent = not (smooth or self.slopes is None)
        if self.slopes is None or not self.lent:
            self.slopes = slopes
        # A change of what is followed, and by which noise, is no gain that can be measured.
        still = gain < (SMALL_GAIN if self.joint else NEAR_GAIN * self.objective)
        changed, self.joint = self.joint != self.near, self.near
        self.last, bends_freely = self._believed(self.slopes)
        still = still and bends_freely and not changed
        self.origin = self.coordinates
        self.objective = self._objective(residual)
        move = self.last.mean - self.coordinates
        self.promise = 0.5 * float(move @ np.linalg.solve(self.last.covariance, move))
        if changed:
            self.evidence = -np.inf
        level = self.last.evidence < self.evidence + SMALL_GAIN
        still = still or (self.joint and level and self.promise < SMALL_PROMISE * self.objective)
        self.evidence = max(self.evidence, self.last.evidence)
        share = move / np.sqrt(np.diag(self.last.covariance))
        told = self.moves & (self._own_error() <= TELLS_NOTHING)
        farthest = np.abs(share[: self.knots][told]).max(initial=0.0)
        self.converged = bool(self.joint and (still or farthest < SMALL_MOVE))
        self.near = self.near or still or farthest < NEAR
        # Moved along x a run is the same run, however far.
        bent = np.abs(np.delete(move, self.knots)).max()
        self.move = move * min(1.0, LONGEST_MOVE / max(bent, 1e-300))
        if self.converged or self.steps == MOST_STEPS:
            self.settled = True
        else:
            self.coordinates = self.origin + self.move

    @property
    def padded(self) -> np.ndarray:
        """`coordinates` with knots after the run's last one, which bear on nothing."""
        missing = self.curve.shape[1] - self.knots
        return np.insert(self.coordinates, [self.knots] * missing, 0.0)

    def _believed(self, slopes: np.ndarray) -> tuple[Posterior, bool]:
        """What the linearised run says, and whether its path bends as much as the data ask for."""
        self.followed = [*self.channels] if self.joint else ["z"]
        picked = [self.channels.index(name) for name in self.followed]
        # Of what is left, not of what was read: a wheel that speeds up scatters from sample to
        # sample by more than its instruments do.
        instruments = [
            InstrumentFloor(
                max(white_noise(self.residual[n]), SMALLEST_NOISE[name]), self.lasting[name]
            )
            for name, n in zip(self.followed, picked, strict=True)
        ]
        products = [
            self._products(np.c_[slopes[n], slopes[n] @ self.coordinates - self.residual[n]])
            for n in picked
        ]
        noise = [
            instrument.white(np.sqrt(np.mean(self.residual[n] ** 2)))
            for instrument, n in zip(instruments, picked, strict=True)
        ]
        if self.joint:
            kept = None if self.last is None else self.last.weight
            found = most_probable(products, self.knots, self.level, noise, instruments, kept)
            return found, True
        # A misfit would pass for noise that lasts; white noise of its size pulls on. Travel waits:
        # where it contradicts the sinkage, whichever is met first would have its way.
        # A standing wheel does not rise: a path that swings too far at a stop is not drawn back, so
        # paths start straight and bend a little more with every step.
        least = FIRST_WEIGHT / 10.0**self.steps
        found = smoothest_given(products, self.knots, self.level, noise, least)
        return found, found.weight > 2 * least

    def _is_smooth(self, slopes: np.ndarray) -> bool:
        """Whether a derivative says how the run goes on, not how a jump of the wheel multiplies.

        A knot's zeta e times as large moves no wheel up or down by more than its radius. In place
        of another kind, the nearest derivative that is smooth is lent.
        """
        radius = float(self.trial.simulator.wheel.radius)
        steepest = np.abs(slopes[self.channels.index("z")]).max()
        return bool(steepest < radius and np.isfinite(slopes).all())

    def _shorten(self) -> None:
        """Half the last step: the straight line promised what the simulation does not keep."""
        self.move = self.move / 2
        self.coordinates = self.origin + self.move
        self.steps += 1
        self.refused += 1
        if self.refused == MOST_REFUSED or self.steps >= MOST_STEPS:
            self.coordinates = self.origin
            self.settled = (self.joint and not self.lent) or self.steps >= MOST_STEPS
            self.converged = bool(self.joint and self.promise < NEAR_GAIN * self.objective)
            # White noise was not the way on; from here the noise is found with the path.
            self.near, self.refused = True, 0
            self.last = self.last if self.settled else None

    def _objective(self, residual: np.ndarray) -> float:
        """Half the misfit and the bends at the last weight and noise."""
        misfit = sum(
            float(
                self._products(residual[self.channels.index(name), :, None]).whitened(noise)[0, 0]
            )
            for name, noise in zip(self.followed, self.posterior.noise, strict=True)
        )
        prior, away = self._bends()
        return 0.5 * (misfit + float(away @ prior @ away))

    @property
    def posterior(self) -> Posterior:
        """What the last linearisation said."""
        assert self.last is not None
        return self.last

    def information_with(self, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Second derivative and slope of half the misfit and the bends, by path and other numbers.

        Args:
            slopes: Derivative of the channels by the other numbers, shape (channels, samples,
                numbers), where they are compared.

        Returns:
            Shapes (all, all) and (all,), the path's coordinates before the numbers'.
        """
        picked = [self.channels.index(name) for name in self.followed]
        assert self.slopes is not None
        columns = [np.c_[self.slopes[n], slopes[n], self.residual[n]] for n in picked]
        noise = self.posterior.noise
        whole = np.sum(
            [self._products(c).whitened(n) for c, n in zip(columns, noise, strict=True)], axis=0
        )
        information, pull = whole[:-1, :-1], whole[:-1, -1]
        prior, away = self._bends()
        size = len(away)
        information[:size, :size] += prior
        pull[:size] += prior @ away
        return information, pull

    def widen(self, covariance: np.ndarray) -> None:
        """Count what other uncertain numbers add to the covariance of the path."""
        self.last = replace(self.posterior, covariance=self.posterior.covariance + covariance)

    def _bends(self) -> tuple[np.ndarray, np.ndarray]:
        """Precision of the prior, and how far the coordinates lie from its mean."""
        centre = np.r_[np.full(self.knots, self.level), 0.0, 0.0]
        away = self.coordinates - centre
        return smoothness_prior(self.knots, len(centre), self.posterior.weight), away

    def _products(self, columns: np.ndarray) -> LaggedProducts:
        return LaggedProducts.of(columns, self.intervals)

    def _own_error(self) -> np.ndarray:
        own = np.diag(self.posterior.information)[: self.knots]
        return 1 / np.sqrt(np.maximum(own, np.finfo(float).tiny))

    def path(self) -> ZetaPath:
        """zeta(t) as the steps left it."""
        own = self._own_error()
        told = self.moves & (own <= TELLS_NOTHING)
        spread = np.sqrt(np.diag(self.posterior.covariance)[: self.knots])
        # The prior would draw its line on through a standstill, and be sure of it.
        spread = np.where(told, spread, np.hypot(spread, np.maximum(own, TELLS_NOTHING)))
        value = np.exp(self.coordinates[: self.knots])
        ends = between(self.grid)
        curve, coordinates = map(jnp.asarray, (cardinal(self.grid, ends), self.coordinates))
        trial = placed(with_zeta_knots(self.trial, ends), curve, coordinates)
        place = np.asarray(trial.start.position)
        lines = np.asarray(trial.simulator.terrain.zeta.value)  # pyright: ignore
        terrain = replace_struct(
            self.candidate.setup.terrain, zeta=ZetaKnots(ends.tolist(), lines.tolist())
        )
        start = replace_struct(
            self.candidate.setup.start, x=float(place[0]), sinkage=float(-place[1])
        )
        noise = [(n.spread, n.correlation) for n in self.posterior.noise]
        rmse = np.sqrt(np.mean(self.residual**2, axis=1)).tolist()
        return ZetaPath(
            name=self.candidate.name,
            time=self.grid,
            value=value,
            error=np.where(spread < 1e6, value * spread, np.inf),
            identified=told,
            weight=float(self.posterior.weight),
            noise=dict(zip(self.followed, noise, strict=True)),
            rmse=dict(zip(self.channels, rmse, strict=True)),
            steps=self.steps,
            converged=self.converged,
            trial=trial,
            setup=replace_struct(self.candidate.setup, terrain=terrain, start=start),
        )


def sinkage_and_travel(each: PreparedRun) -> Observation:
    """Sinkage and travel of a run, where it has them."""
    observation = each.observation
    channels = tuple(name for name in CHANNELS if name in observation.channels)
    if "z" not in channels:
        raise RunError(each.name, "has no /measured/z, so its sinkage is not known")
    picked = [observation.channels.index(name) for name in channels]
    return replace(
        observation,
        channels=channels,
        values=observation.values[picked],
        noise=observation.noise[picked],
    )


def _lasting(time: np.ndarray, spacing: float) -> dict[str, float]:
    """Largest correlation of a sample with the one before that passes for noise, by channel.

    Sinkage follows zeta within a fraction of a second, so whatever lasts longer than knots can draw
    is zeta's to explain: up to the knots' highest frequency, 1 / (2 spacing), the noise is to be as
    good as white, its correlation time no more than spacing / pi. Travel sums up slip, and keeps
    whatever else has hindered the wheel to the run's end.
    """
    interval = float(np.median(np.diff(time)))
    return {"z": float(np.exp(-np.pi * interval / spacing)), "x": SUMMED_CORRELATION}


def _believed_zeta(trial: Trial, time: np.ndarray) -> np.ndarray:
    """zeta of the trial's own at `time` [s], [-]."""
    zeta = trial.simulator.terrain.zeta
    first = Command(trial.omega[0], trial.vx[0], trial.omega[0])  # no set-up's zeta reads it
    return np.array([float(zeta(jnp.asarray(t), first)) for t in time])


def _moves(trial: Trial, grid: np.ndarray) -> np.ndarray:
    """Whether wheel or carriage is asked to move anywhere between a knot's two neighbours."""
    edges = np.r_[grid[0], grid, grid[-1]]
    inside = np.linspace(edges[:-2], edges[2:], 65)[1:-1]
    return np.asarray(is_commanded_to_move(trial, inside).any(axis=0))
