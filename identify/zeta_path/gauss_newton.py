"""Gauss-Newton steps on one run's zeta(t), at the smoothness and noise of largest evidence."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
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
from identify.solver.descent import NormalEquations, gauss_newton
from identify.zeta_path.evidence import (
    InstrumentFloor,
    LaggedProducts,
    LinearizedPath,
    PathPosterior,
    smoothness_prior,
)
from identify.zeta_path.path import CHANNELS, ZetaPath, cardinal_splines, segment_ends
from identify.zeta_path.settings import ZETA_PATH_SETTINGS, ZetaPathSettings
from identify.zeta_path.simulate import START_COORDINATES, path_trial, with_zeta_knots


class ZetaPathSolver:
    """Iteration on the zeta(t) of one run; whoever holds it simulates, and calls `advance`.

    The first steps fit sinkage alone, by white noise and a path that starts straight and may bend
    more with every step. Once these are short, travel and correlated noise are fitted too.

    Args:
        run: The run.
        batch: Runs that are simulated side by side.
        number: Of this one in the batch.
        grid: Knots from the run's start [s], shape (knots,).
        curve: Spline through as many knots as the batch's longest run has, as a matrix from values
            at the knots to the ends of its segments.
        begun: An earlier path of the same run to go on from, at other values of what is not fitted
            here.
        settings: Decision numbers.

    Attributes:
        coordinates: Place of the next simulation, as `identify.zeta_path.simulate.path_trial` takes
            it: log zeta at the knots, then the start's.
        counts: True for samples that are compared, shape (samples,).
        settled: No step is left to make.
        converged: The path is found.
        steps: Steps taken, rejected ones included.
        step_error: Error of the simulated channels by their step, which is taken off, at the run's
            samples, shape (channels, samples); None until the path is close.
    """

    def __init__(
        self,
        run: PreparedRun,
        batch: Batch,
        number: int,
        grid: Float[np.ndarray, " knots"],
        curve: Float[Array, "ends knots"],
        begun: "ZetaPathSolver | None" = None,
        settings: ZetaPathSettings = ZETA_PATH_SETTINGS,
    ):
        self.run, self.settings = run, settings
        self.grid, self.knots, self.curve = grid, len(grid), curve
        self.batch, self.number = batch, number
        self.trial: Trial = jax.tree.map(lambda leaf: leaf[number], batch.trials)
        self.channels = batch.channels
        self.counts = np.asarray(batch.observed.weight[number, 0]) > 0
        self.values = np.asarray(batch.observed.values[number])[:, self.counts]
        time = run.observation.time[run.observation.counts]
        self.intervals = sampling_intervals(time)
        zeta = _initial_zeta(run.trial, grid)
        self.coordinates = np.r_[np.log(zeta), 0.0, 0.0]
        self.level = float(np.log(zeta).mean())
        self.moving = _moving_knots(run.trial, grid)
        self.largest_correlation = {
            "z": _sinkage_correlation(time, grid[1] - grid[0]),
            "x": settings.travel_correlation,
        }
        self.close = begun is not None
        if begun is not None:
            self.coordinates = begun.coordinates
        self.rejections = 0
        self.last: PathPosterior | None = None
        self.fitted_channels = ["z"]
        self.all_channels = False
        self.predicted_gain = np.inf
        self.evidence = -np.inf
        self.objective = np.inf
        self.origin = self.coordinates
        self.descent = gauss_newton(settings.kept_promise)
        self.linear = self._linearized(np.eye(len(self.coordinates)), 0 * self.coordinates)
        self.size, self.search = self.descent.begin(self.linear)
        self.residual = np.zeros_like(self.values)
        self.slopes = np.zeros((*self.values.shape, len(self.coordinates)))
        self.steps = 0
        self.settled = self.converged = False
        self.step_error: np.ndarray | None = None

    def take_off(self, step_error: Float[np.ndarray, "channels padded"]) -> None:
        """Take note of the error by the step, which predictions are free of from here on."""
        self.step_error = step_error[:, : len(self.run.observation.time)]
        self.objective = np.inf  # With the error and without it, misfits are not comparable.

    def advance(
        self,
        predicted: Float[np.ndarray, "channels samples"],
        derivative: Float[np.ndarray, "channels samples coordinates"],
    ) -> None:
        """Take one step: weight, noise and next place, from a linearisation at `coordinates`.

        Args:
            predicted: Simulated channels [m].
            derivative: By the coordinates [m].

        Raises:
            RunError: where the run cannot be simulated at the zeta it starts from.
        """
        residual, slopes = predicted[:, self.counts] - self.values, derivative[:, self.counts]
        if not (np.isfinite(slopes).all() and np.isfinite(residual).all()):
            if self.steps == 0:
                raise RunError(self.run.name, "its simulation diverges at the zeta it starts from")
            self._counts(np.inf)
            self._step_back()
            return
        gain = np.inf if self.last is None else self.objective - self._objective(residual)
        # Stops make the misfit rough: what loses next to nothing counts as well.
        if gain < -self.settings.roughness and not self._counts(self.objective - gain):
            self._step_back()
            return
        self.steps += 1
        self.rejections = 0
        self.residual, self.slopes = residual, slopes
        self._step_from_here(gain)

    def _step_from_here(self, gain: float) -> None:
        """Set the next place, and whether the path is found, by the slopes at this one."""
        numbers = self.settings
        # Another choice of channels and noise makes gains incomparable.
        small = numbers.small_gain if self.all_channels else numbers.close_gain * self.objective
        changed, self.all_channels = self.all_channels != self.close, self.close
        self.last, bends_freely = self._maximize_evidence()
        still = gain < small and bends_freely and not changed
        self.origin = self.coordinates
        self.objective = self._objective(self.residual)
        move = self.last.mean - self.coordinates
        self.predicted_gain = 0.5 * float(move @ np.linalg.solve(self.last.covariance, move))
        if changed:
            self.evidence = -np.inf
        level = self.last.evidence < self.evidence + numbers.small_gain
        little = self.predicted_gain < numbers.small_promise * self.objective
        still = still or (self.all_channels and level and little)
        self.evidence = max(self.evidence, self.last.evidence)
        share = move / np.sqrt(np.diag(self.last.covariance))
        farthest = np.abs(share[: self.knots][self._identified()]).max(initial=0.0)
        self.converged = bool(self.all_channels and (still or farthest < numbers.small_step))
        self.close = self.close or still or farthest < numbers.close_step
        prior, _ = self._prior()
        information = self.last.information + prior
        self.linear = self._linearized(information, -information @ move)
        self.size, self.search = self.descent.begin(self.linear)
        if self.converged or self.steps == numbers.max_steps:
            self.settled = True
        else:
            self.coordinates = self._next_place()

    def step_error_of(self, observation: Observation) -> Float[np.ndarray, "channels samples"]:
        """Return the error by the step of all of an observation's channels, zero where unknown."""
        found = np.zeros_like(observation.values)
        if self.step_error is not None:
            for channel, error in zip(self.channels, self.step_error, strict=True):
                found[observation.channels.index(channel)] = error
        return found

    @property
    def padded(self) -> Float[np.ndarray, " all"]:
        """`coordinates` with knots after the run's last one, which no sample depends on."""
        return self._padded(self.coordinates)

    def _padded(self, coordinates: np.ndarray) -> np.ndarray:
        missing = self.curve.shape[1] - self.knots
        return np.insert(coordinates, [self.knots] * missing, 0.0)

    def _maximize_evidence(self) -> tuple[PathPosterior, bool]:
        """Return the linearised run's posterior, and whether its path bends as the data ask for."""
        self.fitted_channels = [*self.channels] if self.all_channels else ["z"]
        picked = [self.channels.index(name) for name in self.fitted_channels]
        slopes = self.slopes
        # Scatter of the residual, not of the readings: a wheel that speeds up moves from sample to
        # sample by more than its instruments scatter.
        instruments = [
            InstrumentFloor(
                max(white_noise(self.residual[n]), SMALLEST_NOISE[name]),
                self.largest_correlation[name],
            )
            for name, n in zip(self.fitted_channels, picked, strict=True)
        ]
        products = [
            self._products(np.c_[slopes[n], slopes[n] @ self.coordinates - self.residual[n]])
            for n in picked
        ]
        noise = [
            instrument.white_noise(np.sqrt(np.mean(self.residual[n] ** 2)))
            for instrument, n in zip(instruments, picked, strict=True)
        ]
        linear = LinearizedPath(products, self.knots, self.level, self.settings)
        if self.all_channels:
            kept = None if self.last is None else self.last.weight
            return linear.maximize_evidence(noise, instruments, kept), True
        # A misfit would pass for correlated noise; white noise of its size pulls on. Travel waits:
        # where it contradicts the sinkage, whichever is fitted first would decide.
        # A standing wheel does not rise: a path that swings too far at a stop is not drawn back, so
        # paths start straight and bend a little more with every step.
        least = self.settings.first_weight / 10.0**self.steps
        found = linear.maximize_evidence_given_noise(noise, least)
        return found, found.weight > 2 * least

    def _next_place(self) -> np.ndarray:
        """Return the place of the next simulation: the descent's step, no longer than trusted."""
        free = jnp.ones(len(self.padded), bool)
        move = self.descent.next_move(self.linear, self.size, free, jnp.asarray(np.inf))
        move = np.delete(np.asarray(move)[0], np.s_[self.knots : self.curve.shape[1]])
        # Moved along x a run is the same run, however far.
        bent = np.abs(np.delete(move, self.knots)).max()
        longest = self.settings.longest_step * float(self.size[0])
        return self.origin + move * min(1.0, longest / max(bent, 1e-300))

    def _counts(self, objective: float) -> bool:
        """Return whether the last step keeps what its slope promises; if not, halve it."""
        move = self._padded(self.coordinates - self.origin)[None]
        here = self.linear._replace(loss=np.array([self.objective]))
        ends = np.array([objective])
        counts, self.size, self.search = self.descent.judge(here, move, ends, self.search)
        return bool(counts[0])

    def _linearized(self, information: np.ndarray, slope: np.ndarray) -> NormalEquations:
        """Return a problem with coordinates of knots after the run's last one, which stay."""
        size = len(self.padded)
        at = np.r_[0 : self.knots, size - START_COORDINATES : size]
        whole = np.eye(size)
        whole[np.ix_(at, at)] = information
        return NormalEquations(np.zeros(1), self._padded(slope)[None], whole[None])

    def _step_back(self) -> None:
        """Take a shorter step: the simulation does not keep what the linearisation promised."""
        numbers = self.settings
        self.coordinates = self._next_place()
        self.steps += 1
        self.rejections += 1
        if self.rejections == numbers.max_rejections or self.steps >= numbers.max_steps:
            self.coordinates = self.origin
            self.settled = self.all_channels or self.steps >= numbers.max_steps
            little = self.predicted_gain < numbers.close_gain * self.objective
            self.converged = bool(self.all_channels and little)
            # White noise leads no further; from here on the noise is found with the path.
            self.close, self.rejections = True, 0
            self.last = self.last if self.settled else None

    def _objective(self, residual: np.ndarray) -> float:
        """Return half the misfit and the prior's square at the last weight and noise."""
        misfit = sum(
            float(
                self._products(residual[self.channels.index(name), :, None]).whitened_gram(n)[0, 0]
            )
            for name, n in zip(self.fitted_channels, self.posterior.noise, strict=True)
        )
        prior, away = self._prior()
        return 0.5 * (misfit + float(away @ prior @ away))

    @property
    def posterior(self) -> PathPosterior:
        """PathPosterior of the last linearisation."""
        assert self.last is not None
        return self.last

    def information_with(
        self, slopes: Float[np.ndarray, "channels samples numbers"]
    ) -> tuple[Float[np.ndarray, "all all"], Float[np.ndarray, " all"]]:
        """Return second derivative and slope of half the misfit and the prior's square.

        Args:
            slopes: Derivative of the channels by other numbers, where they are compared.

        Returns:
            By the path's coordinates, then the other numbers.
        """
        picked = [self.channels.index(name) for name in self.fitted_channels]
        by_path = self.slopes
        columns = [np.c_[by_path[n], slopes[n], self.residual[n]] for n in picked]
        pairs = zip(columns, self.posterior.noise, strict=True)
        whole = np.sum([self._products(c).whitened_gram(n) for c, n in pairs], axis=0)
        information, pull = whole[:-1, :-1], whole[:-1, -1]
        prior, away = self._prior()
        size = len(away)
        information[:size, :size] += prior
        pull[:size] += prior @ away
        return information, pull

    def widen(self, covariance: Float[np.ndarray, "coordinates coordinates"]) -> None:
        """Add to the covariance of the path what other uncertain numbers make of it."""
        self.last = replace(self.posterior, covariance=self.posterior.covariance + covariance)

    def _prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the prior's precision, and the distance of the coordinates from its mean."""
        centre = np.r_[np.full(self.knots, self.level), 0.0, 0.0]
        precision = smoothness_prior(
            self.knots, len(centre), self.posterior.weight, self.settings.level_spread
        )
        return precision, self.coordinates - centre

    def _products(self, columns: np.ndarray) -> LaggedProducts:
        return LaggedProducts.of(columns, self.intervals)

    def _error_of_own_samples(self) -> Float[np.ndarray, " knots"]:
        """Return the standard error of log zeta at each knot, were all other knots known."""
        own = np.diag(self.posterior.information)[: self.knots]
        return 1 / np.sqrt(np.maximum(own, np.finfo(float).tiny))

    def _identified(self) -> Bool[np.ndarray, " knots"]:
        return self.moving & (self._error_of_own_samples() <= self.settings.unidentified_error)

    def path(self) -> ZetaPath:
        """Return zeta(t) at the place of the last linearisation."""
        identified = self._identified()
        spread = np.sqrt(np.diag(self.posterior.covariance)[: self.knots])
        # The prior would continue its line through a standstill, with a small error.
        own = np.maximum(self._error_of_own_samples(), self.settings.unidentified_error)
        spread = np.where(identified, spread, np.hypot(spread, own))
        value = np.exp(self.coordinates[: self.knots])
        ends = segment_ends(self.grid)
        curve, coordinates = map(jnp.asarray, (cardinal_splines(self.grid, ends), self.coordinates))
        trial = path_trial(with_zeta_knots(self.trial, ends), curve, coordinates)
        place = np.asarray(trial.start.position)
        lines = np.asarray(trial.simulator.terrain.zeta.value)  # pyright: ignore
        terrain = replace_struct(
            self.run.setup.terrain, zeta=ZetaKnots(ends.tolist(), lines.tolist())
        )
        start = replace_struct(self.run.setup.start, x=float(place[0]), sinkage=float(-place[1]))
        noise = [(n.spread, n.correlation) for n in self.posterior.noise]
        rmse = np.sqrt(np.mean(self.residual**2, axis=1)).tolist()
        return ZetaPath(
            name=self.run.name,
            time=self.grid,
            value=value,
            error=np.where(spread < 1e6, value * spread, np.inf),
            identified=identified,
            weight=float(self.posterior.weight),
            noise=dict(zip(self.fitted_channels, noise, strict=True)),
            rmse=dict(zip(self.channels, rmse, strict=True)),
            steps=self.steps,
            converged=self.converged,
            trial=trial,
            setup=replace_struct(self.run.setup, terrain=terrain, start=start),
        )


def sinkage_and_travel(run: PreparedRun) -> Observation:
    """Return the sinkage of a run, and its travel where it has one.

    Raises:
        RunError: where the run has no sinkage.
    """
    observation = run.observation
    channels = tuple(name for name in CHANNELS if name in observation.channels)
    if "z" not in channels:
        raise RunError(run.name, "has no /measured/z, so its sinkage is not known")
    return observation.in_order(channels)


def _sinkage_correlation(time: np.ndarray, spacing: float) -> float:
    """Return the largest correlation of sinkage's noise from one sample to the next [-].

    Sinkage follows zeta within a fraction of a second: what lasts longer than knots can resolve is
    for zeta to explain. Up to the knots' highest frequency, 1 / (2 spacing), the noise is to be
    almost white, so its correlation time is at most spacing / pi.
    """
    interval = float(np.median(np.diff(time)))
    return float(np.exp(-np.pi * interval / spacing))


def _initial_zeta(trial: Trial, time: np.ndarray) -> np.ndarray:
    """Return zeta of the trial's own at `time` [s], [-]."""
    zeta = trial.simulator.terrain.zeta
    first = Command(trial.omega[0], trial.vx[0], trial.omega[0])  # no set-up's zeta reads it
    return np.array([float(zeta(jnp.asarray(t), first)) for t in time])


def _moving_knots(trial: Trial, grid: np.ndarray) -> np.ndarray:
    """Return whether wheel or carriage is to move anywhere between a knot's two neighbours."""
    edges = np.r_[grid[0], grid, grid[-1]]
    inside = np.linspace(edges[:-2], edges[2:], 65)[1:-1]
    return np.asarray(is_commanded_to_move(trial, inside).any(axis=0))
