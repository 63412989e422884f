"""Joint fit of parameters and the zeta(t) of each run, by variable projection.

Paths are fitted at given values of the parameters, then the values move by Gauss-Newton with the
paths free to follow, and so on (G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973). With
a run's derivatives by its path, $u$, and by the values, $\\theta$, whitened by the noise that the
path was found with, and the path's prior, the information on the values is the Schur complement,
summed over runs,

$$A_{\\theta\\theta} - A_{\\theta u} A_{uu}^{-1} A_{u\\theta},$$

so that an effect that a zeta(t) could have as well is no information on them.
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
from identify.solver.descent import NormalEquations, gauss_newton
from identify.solver.problem import coordinates_of
from identify.uncertainty.model_error import MISFIT_SETTINGS, MisfitSettings
from identify.zeta_path.gauss_newton import ZetaPathSolver
from identify.zeta_path.settings import ZETA_PATH_SETTINGS, ZetaPathSettings
from identify.zeta_path.simulate import predict_path
from identify.zeta_path.smoother import path_solvers

# Numbers that every path has among its own coordinates.
PATH_COORDINATES = ("start.x", "start.sinkage")


@dataclass(frozen=True)
class JointFitSettings:
    """Decision numbers of parameters fitted jointly with the zeta(t) of each run.

    Attributes:
        longest_step: Longest step of a parameter's coordinate that the linearisation is trusted
            for.
        max_iterations: Gauss-Newton steps of the parameters, at most.
        small_step: The iteration has converged where no parameter would move by so much of its
            standard error.
        least_information: Information on a coordinate that the runs do not determine: an error of
            10,000.
        noticeable: Fall of the log evidence for which a step is rejected; paths that stop elsewhere
            in the rough make a smaller one by themselves.
        max_rejections: Rejected steps in a row, each half as long, at most.
        path: Decision numbers of the paths.
        misfit: Numbers that say from when on a model does not fit.
    """

    longest_step: float = 1.0
    max_iterations: int = 20
    small_step: float = 0.1
    least_information: float = 1e-8
    noticeable: float = 1.0
    max_rejections: int = 3
    path: ZetaPathSettings = ZETA_PATH_SETTINGS
    misfit: MisfitSettings = MISFIT_SETTINGS


JOINT_FIT_SETTINGS = JointFitSettings()


Progress = Callable[[str, int, float], None]


@dataclass(frozen=True, eq=False)
class JointFit:
    """Parameters and paths of a joint fit.

    Attributes:
        parameters: Fitted parameters, shared ones first.
        places: Places of each run's values among the coordinates, in the parameters' order.
        solvers: Each run's path; its covariance includes that of the parameters.
        runs: The runs with the values put in.
        coordinates: Of the values: shared, then each run's own, shape (coordinates,).
        covariance: Of these, shape (coordinates, coordinates).
        iterations: Gauss-Newton steps of the values.
        converged: True where values and paths converged.
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
        """Shared values by name, and each run's own."""
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
    """Raise InputError for parameters that are part of every path.

    Raises:
        InputError: names the parameter.
    """
    for each in parameters:
        if each.quantity.is_zeta:
            raise InputError(
                f"{each.quantity.label} is what a path is of; leave it out, or fit zeta as a "
                "constant or by phases"
            )
        if each.quantity.name in PATH_COORDINATES:
            raise InputError(f"each path finds its own {each.quantity.name}; leave it out")


def fit_jointly(
    runs: Sequence[PreparedRun],
    parameters: Sequence[Parameter],
    knot_spacing: float,
    progress: Progress | None = None,
    settings: JointFitSettings = JOINT_FIT_SETTINGS,
) -> JointFit:
    """Fit the zeta(t) of each run and the parameters, to all runs together.

    Args:
        runs: Runs of the same kind of wheel, law and carriage.
        parameters: Parameters beside the paths; shared ones come first in the result.
        knot_spacing: Of the paths [s].
        progress: Called with the stage and the iteration.
        settings: Decision numbers.

    Raises:
        RunError: where a run has no such number, or cannot be fitted at the values it starts from.
        InputError: where a parameter is part of every path.
    """
    if not parameters:
        steps = path_solvers(runs, knot_spacing, settings=settings.path)
        settled = all(each.converged for each in steps)
        nowhere = [np.zeros(0, int)] * len(steps)
        return JointFit((), nowhere, steps, [*runs], np.zeros(0), np.zeros((0, 0)), 0, settled)
    require_joint_parameters(parameters)
    report = progress or (lambda stage, turn, evidence: None)
    fit = _JointProblem(runs, parameters, settings)
    now = fit.start()
    best = fit.paths_at(now, knot_spacing, None)
    iterations = rejected = 0
    halved, converged = 1.0, False
    descent, free = gauss_newton(settings.path.kept_promise), np.ones(len(now), bool)
    longest = np.asarray(settings.longest_step)
    linear = fit.linearize(now, best)
    while iterations < settings.max_iterations:
        report("paths, and numbers beside them", iterations, np.nan)
        information, slope = fit.normal_equations(now, linear)
        covariance = _inverse(information, settings.least_information)
        at = NormalEquations(np.zeros(1), slope[None], information[None])
        whole = np.asarray(descent.next_move(at, np.ones(1), free, longest))[0]
        error = np.sqrt(np.diag(covariance))
        if np.all(np.abs(covariance @ slope) <= settings.small_step * error):
            converged = True
            break
        move = halved * whole
        iterations += 1
        try:
            tried = fit.paths_at(now + move, knot_spacing, best)
        except RunError:
            tried = None
        if (
            tried is None
            or fit.evidence(now + move, tried) < fit.evidence(now, best) - settings.noticeable
        ):
            rejected, halved = rejected + 1, halved / 2
            if rejected == settings.max_rejections:
                break
            continue
        now, best, rejected, halved = now + move, tried, 0, 1.0
        linear = fit.linearize(now, best)
    covariance = _inverse(fit.normal_equations(now, linear)[0], settings.least_information)
    fit.widen(best, linear, covariance)
    converged = converged and all(each.converged for each in best)
    places = [fit.places_of(run) for run in range(len(best))]
    placed = fit.runs_at(now)
    return JointFit(fit.parameters, places, best, placed, now, covariance, iterations, converged)


class _JointProblem:
    """Runs and parameters of a joint fit, with their linearisation."""

    def __init__(
        self,
        runs: Sequence[PreparedRun],
        parameters: Sequence[Parameter],
        settings: JointFitSettings = JOINT_FIT_SETTINGS,
    ):
        self.settings = settings
        self.runs = list(runs)
        shared = [each for each in parameters if each.shared]
        self.parameters = (*shared, *(each for each in parameters if not each.shared))
        self.shared = len(shared)

    def start(self) -> np.ndarray:
        """Return the coordinates of the runs' own values; shared ones from the first run."""
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
        """Return the places of a run's coordinates, in the parameters' order."""
        return coordinates_of(run, len(self.parameters), self.shared)

    def runs_at(self, coordinates: np.ndarray) -> list[PreparedRun]:
        """Return the runs with these values in trial and set-up."""
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
        """Return the paths at these values."""
        return path_solvers(self.runs_at(coordinates), spacing, begun, self.settings.path)

    def evidence(self, coordinates: np.ndarray, steps: Sequence[ZetaPathSolver]) -> float:
        """Return the log probability of all runs and of the priors."""
        prior, _ = self._priors(coordinates)
        return sum(each.posterior.evidence for each in steps) - 0.5 * float(prior @ prior)

    def _priors(self, coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals of the priors and their derivatives, by coordinate."""
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
        """Return second derivatives and slope of half the misfit of each run, at its path's end."""
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
        """Return information on the values with every path free, and half the misfit's slope."""
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
        """Add the values' uncertainty to that of the paths."""
        for run, (each, here) in enumerate(zip(steps, linear, strict=True)):
            place = self.places_of(run)
            each.widen(here.follows @ covariance[np.ix_(place, place)] @ here.follows.T)


@dataclass(frozen=True, eq=False)
class _Linear:
    """One run linearised by path and values, in that order.

    Attributes:
        path: Number of the path's coordinates.
        information: Second derivative of half the misfit and the prior's square, shape (all, all).
        slope: Their first, shape (all,).
    """

    path: int
    information: np.ndarray
    slope: np.ndarray

    @cached_property
    def follows(self) -> np.ndarray:
        """Negative change of the path that follows one unit of each value, shape (path, values)."""
        return np.linalg.solve(
            self.information[: self.path, : self.path], self.information[: self.path, self.path :]
        )

    def with_path_free(self) -> tuple[np.ndarray, np.ndarray]:
        """Return information and slope by the values, the path eliminated."""
        coupling = self.information[: self.path, self.path :]
        own = self.information[self.path :, self.path :] - coupling.T @ self.follows
        return own, self.slope[self.path :] - self.follows.T @ self.slope[: self.path]


def _inverse(information: np.ndarray, least: float) -> np.ndarray:
    """Return the covariance; very large, not infinite, along undetermined directions."""
    size, axes = np.linalg.eigh(information)
    return (axes / np.maximum(size, least)) @ axes.T


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
    """Return the derivative of every run's channels by its values' coordinates, its path held."""

    def one(
        trial: Trial, observed: PaddedObservations, _, own: tuple[Array, Array, Array]
    ) -> Array:
        curve, path, here = own

        def simulated(at: Array) -> Array:
            return predict_path(_with(trial, parameters, at), observed, batch.channels, curve, path)

        return jax.jacfwd(simulated)(here)

    return map_over_runs(batch, mesh, one, (), (curves, paths, coordinates))
