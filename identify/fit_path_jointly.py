"""Other numbers fitted beside the zeta(t) of each run: lambda of all, or what each has for itself.

Paths are fitted at given values, then the values move by Gauss-Newton with the paths free to
follow, and so on: variable projection. With a run's derivatives by its path, $u$, and by the
values, $\\theta$, whitened by the noise that the path was found with, and the path's prior, the
information on the values is the Schur complement, summed over runs,

$$A_{\\theta\\theta} - A_{\\theta u} A_{uu}^{-1} A_{u\\theta},$$

so what a zeta(t) could do as well tells nothing of them.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float

from drftjax.common.errors import InputError, RunError
from drftjax.recorded.batch import Batch, PaddedObservations, device_mesh, map_over_runs
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.simulation.trial import Trial
from identify.parameters.parameter import Parameter
from identify.results.values import Value, values_of
from identify.solver.problem import coordinates_of
from identify.zeta_path.gauss_newton import ZetaPathSolver
from identify.zeta_path.simulate import predict_path
from identify.zeta_path.smoother import path_solvers

# What every path finds for itself.
OF_THE_PATH = ("start.x", "start.sinkage")


# A step of a bounded or positive number's coordinate that the linearisation is trusted for, and of
# one that may have any size, in typical changes.
LONGEST_MOVE = 1.0


MOST_TURNS = 20


# Turns end where no value would move by so much of its standard error.
SMALL_MOVE = 0.1


# Of a coordinate that the runs see nothing of: an error of 10,000.
LEAST_INFORMATION = 1e-8


# How far from a coordinate its derivative may be taken: no derivative changes by a tenth over it.
CLOSE_BY = np.linspace(-0.04, 0.04, 5)


# A step is refused where the log evidence falls by more than this, which paths that stop elsewhere
# in the rough make by themselves, and halved so often.
NOTICEABLE = 1.0


MOST_REFUSED = 3


Progress = Callable[[str, int, float], None]


@dataclass(frozen=True, eq=False)
class JointFit:
    """Paths with numbers beside them.

    Attributes:
        parameters: What was fitted beside them, shared ones first.
        places: Of each run's values among the coordinates, in the parameters' order.
        steps: Each run's path, its covariance that of a path whose other numbers are uncertain.
        runs: The runs with the values put in.
        coordinates: Of the values: shared, then each run's own, shape (coordinates,).
        covariance: Of these, shape (coordinates, coordinates).
        turns: Gauss-Newton steps of the values.
        converged: Whether they settled.
    """

    parameters: tuple[Parameter, ...]
    places: list[np.ndarray]
    solvers: list[ZetaPathSolver]
    runs: list[PreparedRun]
    coordinates: np.ndarray
    covariance: np.ndarray
    iterations: int
    converged: bool

    @property
    def labels(self) -> tuple[str, ...]:
        """A name for each coordinate: "lambda", "rig.mass_z of slow_a"."""
        shared = [p.quantity.label for p in self.parameters if p.shared]
        own = [p.quantity.label for p in self.parameters if not p.shared]
        return (*shared, *(f"{label} of {run.name}" for run in self.runs for label in own))

    @property
    def values(self) -> tuple[dict[str, Value], list[dict[str, Value]]]:
        """Shared values, and each run's own."""
        error = np.sqrt(np.diag(self.covariance))
        each = [
            values_of(self.parameters, jnp.asarray(self.coordinates[place]), error[place])
            for place in self.places
        ]
        shared = [p.quantity.name for p in self.parameters if p.shared]
        own = [p.quantity.name for p in self.parameters if not p.shared]
        common = {name: each[0][name] for name in shared}
        return common, [{name: found[name] for name in own} for found in each]

    @property
    def covariance_of_values(self) -> np.ndarray:
        """Covariance of the values, in their units squared, ordered as `labels`."""
        slope = np.zeros(len(self.coordinates))
        for place in self.places:
            slope[place] = [
                float(p.bijector.slope(jnp.asarray(at)))
                for p, at in zip(self.parameters, self.coordinates[place], strict=True)
            ]
        return slope[:, None] * self.covariance * slope


def require_joint_parameters(parameters: Sequence[Parameter]) -> None:
    """Refuse what a path finds itself.

    Raises:
        InputError: names the parameter.
    """
    for each in parameters:
        if each.quantity.is_zeta:
            raise InputError(
                f"{each.quantity.label} is what a path is of; leave it out, or fit zeta as a "
                "constant or by phases"
            )
        if each.quantity.name in OF_THE_PATH:
            raise InputError(f"each path finds its own {each.quantity.name}; leave it out")


def fit_jointly(
    runs: Sequence[PreparedRun],
    parameters: Sequence[Parameter],
    knot_spacing: float,
    progress: Progress | None = None,
) -> JointFit:
    """zeta(t) of each run and the parameters, by what all runs say together.

    Args:
        runs: Runs of the same kind of wheel, law and carriage.
        parameters: What is fitted beside the paths; shared ones first in what is returned.
        knot_spacing: Of the paths [s].
        progress: Called with the stage and the turn.

    Raises:
        RunError: where a run has no such number, or cannot be fitted at the values it starts from.
        InputError: where a parameter is of the path itself.
    """
    if not parameters:
        steps = path_solvers(runs, knot_spacing)
        settled = all(each.converged for each in steps)
        nowhere = [np.zeros(0, int)] * len(steps)
        return JointFit((), nowhere, steps, [*runs], np.zeros(0), np.zeros((0, 0)), 0, settled)
    require_joint_parameters(parameters)
    report = progress or (lambda stage, turn, evidence: None)
    fit = _JointProblem(runs, parameters)
    now = fit.start()
    best = fit.paths_at(now, knot_spacing, None)
    turns = refused = 0
    halved, converged = 1.0, False
    linear = fit.linearize(now, best)
    while turns < MOST_TURNS:
        report("paths, and numbers beside them", turns, np.nan)
        information, slope = fit.normal_equations(now, linear)
        covariance = _inverse(information)
        move = -covariance @ slope
        error = np.sqrt(np.diag(covariance))
        if np.all(np.abs(move) <= SMALL_MOVE * error):
            converged = True
            break
        move *= halved * min(1.0, LONGEST_MOVE / np.abs(move).max())
        turns += 1
        try:
            tried = fit.paths_at(now + move, knot_spacing, best)
        except RunError:
            tried = None
        if tried is None or fit.evidence(now + move, tried) < fit.evidence(now, best) - NOTICEABLE:
            refused, halved = refused + 1, halved / 2
            if refused == MOST_REFUSED:
                break
            continue
        now, best, refused, halved = now + move, tried, 0, 1.0
        linear = fit.linearize(now, best)
    covariance = _inverse(fit.normal_equations(now, linear)[0])
    fit.widen(best, linear, covariance)
    converged = converged and all(each.converged for each in best)
    places = [fit.places_of(run) for run in range(len(best))]
    placed = fit.runs_at(now)
    return JointFit(fit.parameters, places, best, placed, now, covariance, turns, converged)


class _JointProblem:
    """Runs and parameters, and what one linearisation of all says of the parameters."""

    def __init__(self, runs: Sequence[PreparedRun], parameters: Sequence[Parameter]):
        self.runs = list(runs)
        shared = [each for each in parameters if each.shared]
        self.parameters = (*shared, *(each for each in parameters if not each.shared))
        self.shared = len(shared)

    def start(self) -> np.ndarray:
        """Coordinates of the runs as they stand; shared ones from the first run."""
        for each in self.runs:
            try:
                for parameter in self.parameters:
                    parameter.require_start(each.trial)
            except InputError as problem:
                raise RunError(each.name, str(problem)) from None
        every = np.array(
            [[float(p.coordinate(c.trial)) for p in self.parameters] for c in self.runs]
        )
        return np.r_[every[0, : self.shared], every[:, self.shared :].ravel()]

    def places_of(self, run: int) -> np.ndarray:
        """Places of a run's coordinates, in the parameters' order."""
        return coordinates_of(run, len(self.parameters), self.shared)

    def runs_at(self, coordinates: np.ndarray) -> list[PreparedRun]:
        """The runs with these values in trial and set-up."""
        found = []
        for run, each in enumerate(self.runs):
            own = coordinates[self.places_of(run)]
            setup = copy.deepcopy(each.setup)
            for parameter, at in zip(self.parameters, own, strict=True):
                parameter.quantity.record(setup, float(parameter.bijector.value(jnp.asarray(at))))
            found.append(replace(each, setup=setup, trial=_with(each.trial, self.parameters, own)))
        return found

    def paths_at(
        self, coordinates: np.ndarray, spacing: float, begun: list[ZetaPathSolver] | None
    ) -> list[ZetaPathSolver]:
        """The paths at these values."""
        return path_solvers(self.runs_at(coordinates), spacing, begun)

    def evidence(self, coordinates: np.ndarray, steps: Sequence[ZetaPathSolver]) -> float:
        """Log probability of all runs, and of what was believed."""
        prior, _ = self._priors(coordinates)
        return sum(each.posterior.evidence for each in steps) - 0.5 * float(prior @ prior)

    def _priors(self, coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals of the priors and their derivatives, by coordinate."""
        residual, slope = np.zeros(len(coordinates)), np.zeros(len(coordinates))
        for run in range(len(self.runs)):
            for place, parameter in zip(self.places_of(run), self.parameters, strict=True):
                at = jnp.asarray(coordinates[place])
                found = jax.jvp(parameter.prior_residual, (at,), (jnp.ones_like(at),))
                residual[place], slope[place] = map(float, found)
        return residual, slope

    def linearize(
        self, coordinates: np.ndarray, steps: Sequence[ZetaPathSolver]
    ) -> list["_Linear"]:
        """Second derivatives and slope of half the misfit of each run, where its path ended."""
        slopes: dict[int, np.ndarray] = {}
        for batch in {id(each.batch): each.batch for each in steps}.values():
            alike = [run for run, each in enumerate(steps) if each.batch is batch]
            size = len(batch.order)
            curves = np.zeros((size, *steps[alike[0]].curve.shape))
            paths = np.zeros((size, len(steps[alike[0]].padded)))
            own = np.zeros((size, len(self.parameters)))
            for run in alike:
                at = steps[run].number
                curves[at], paths[at] = steps[run].curve, steps[run].padded
                own[at] = coordinates[self.places_of(run)]
            inputs = map(jnp.asarray, (curves, paths, own))
            found = np.asarray(_slopes(batch, device_mesh(), self.parameters, *inputs))
            slopes |= {run: found[steps[run].number] for run in alike}
        return [
            _Linear(len(each.coordinates), *each.information_with(slopes[run][:, each.counts]))
            for run, each in enumerate(steps)
        ]

    def normal_equations(
        self, coordinates: np.ndarray, linear: Sequence["_Linear"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Information on the values with every path free, and the slope of half the misfit."""
        prior, prior_slope = self._priors(coordinates)
        information = np.diag(prior_slope**2)
        slope = prior_slope * prior
        for run, each in enumerate(linear):
            place = self.places_of(run)
            own, pull = each.with_path_free()
            information[np.ix_(place, place)] += own
            slope[place] += pull
        return information, slope

    def widen(
        self, steps: Sequence[ZetaPathSolver], linear: Sequence["_Linear"], covariance: np.ndarray
    ) -> None:
        """Count the values' uncertainty in that of the paths."""
        for run, (each, here) in enumerate(zip(steps, linear, strict=True)):
            place = self.places_of(run)
            each.widen(here.follows @ covariance[np.ix_(place, place)] @ here.follows.T)


@dataclass(frozen=True, eq=False)
class _Linear:
    """One run linearised by path and values, in that order.

    Attributes:
        path: Number of the path's coordinates.
        information: Second derivative of half the misfit and the bends, shape (all, all).
        slope: Their first, shape (all,).
    """

    path: int
    information: np.ndarray
    slope: np.ndarray

    @cached_property
    def follows(self) -> np.ndarray:
        """Change of the path, turned round, by which it makes up for one of each value."""
        return np.linalg.solve(
            self.information[: self.path, : self.path], self.information[: self.path, self.path :]
        )

    def with_path_free(self) -> tuple[np.ndarray, np.ndarray]:
        """Information and slope by the values."""
        coupling = self.information[: self.path, self.path :]
        own = self.information[self.path :, self.path :] - coupling.T @ self.follows
        return own, self.slope[self.path :] - self.follows.T @ self.slope[: self.path]


def _inverse(information: np.ndarray) -> np.ndarray:
    """Covariance; very large, not infinite, along what the runs do not see."""
    size, axes = np.linalg.eigh(information)
    return (axes / np.maximum(size, LEAST_INFORMATION)) @ axes.T


def _with(trial, parameters: Sequence[Parameter], coordinates):
    for parameter, at in zip(parameters, coordinates, strict=True):
        trial = parameter.quantity.write(trial, parameter.bijector.value(jnp.asarray(at)))
    return trial


@eqx.filter_jit
def _slopes(
    batch: Batch,
    mesh: Mesh,
    parameters: tuple[Parameter, ...],
    curves: Float[Array, "runs ends knots"],
    paths: Float[Array, "runs path"],
    coordinates: Float[Array, "runs values"],
) -> Float[Array, "runs channels samples values"]:
    """Derivative of every run's channels by its values' coordinates, its path as it is.

    The calmest of those at values close by: where a jump of the wheel is about to move by a step,
    the derivative says how the jump multiplies, up to a thousandfold, not how the run goes on.
    """

    def one(
        trial: Trial, observed: PaddedObservations, _, own: tuple[Array, Array, Array]
    ) -> Array:
        curve, path, here = own

        def simulated(at: Array) -> Array:
            return predict_path(_with(trial, parameters, at), observed, batch.channels, curve, path)

        found = jax.vmap(jax.jacfwd(simulated))(here + CLOSE_BY[:, None])
        size = jnp.linalg.norm(jnp.nan_to_num(found, nan=jnp.inf), axis=(1, 2))
        return jnp.take_along_axis(found, jnp.argmin(size, axis=0)[None, None, None], axis=0)[0]

    return map_over_runs(batch, mesh, one, (), (curves, paths, coordinates))
