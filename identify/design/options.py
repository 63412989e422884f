"""Evaluation of candidate runs by their Fisher information on a parameter."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from drftjax.common.errors import InputError
from drftjax.setups.setup import CommandSetUp, SetUp
from drftjax.simulation.ensemble import map_runs, stack
from drftjax.simulation.statics import standing_sinkage
from drftjax.simulation.step_choice import choose_step
from drftjax.simulation.trial import Trial
from identify.design.fisher_information import (
    InstrumentNoise,
    ParameterInformation,
    compared_rows,
    parameter_information,
    parameter_scales,
    sensitivities,
    stackable_trial,
)
from identify.design.limits import Limits, travel_of
from identify.parameters.parameter import Quantity, parameter

# Runs evaluated in one call; fewer are padded to it, so that only one program is compiled.
RUNS_A_CALL = 4


@dataclass(frozen=True)
class RunOption:
    """One run that could be made.

    Attributes:
        name: Description of what is different in it.
        setup: The run, as a set-up.
        information: On the parameter.
        added: The same, were this channel recorded as well, by channel.
    """

    name: str
    setup: SetUp
    information: ParameterInformation
    added: dict[str, ParameterInformation]

    @property
    def rim_travel(self) -> float:
        """Travel of the rim [m]; that of the wheel is shorter by slip."""
        return travel_of(self.setup.command.build(), self.setup.wheel.radius)


def quantities_named(name: str, nuisances: Sequence[str] | None) -> list[Quantity]:
    """Return the parameter of this name, then the nuisances: zeta and lambda where none are given.

    Raises:
        InputError: for names that are not known, or come twice.
    """
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


class RunEvaluator:
    """Evaluator of set-ups by the information of their runs.

    Args:
        setup: Wheel, sand and rig of all runs.
        quantities: The parameter, then its nuisances.
        instrument: Measured channels and their noise.
        limits: Of the rig.
    """

    def __init__(
        self, setup: SetUp, quantities: list[Quantity], instrument: InstrumentNoise, limits: Limits
    ):
        self.base = setup
        self.quantities = quantities
        self.instrument = instrument
        self.limits = limits

    @cached_property
    def step(self) -> float:
        """Integrator step of all runs [s], chosen for the fastest profile that the rig can run."""
        setup = copy.deepcopy(self.base)
        setup.command = self.limits.fastest_profile()
        setup.rig.carriage = "free"
        return choose_step(setup.trial()).step

    def setup_for(self, command: CommandSetUp, **start: float) -> SetUp:
        """Return the base set-up under another command.

        Args:
            command: The command.
            start: "angle" of the wheel [rad] and "load" on it [N], where others than the base's.
        """
        setup = copy.deepcopy(self.base)
        setup.command = command
        setup.integrator.step = self.step
        if "angle" in start:
            setup.start.angle = start["angle"]
        if "load" in start:
            setup.rig.mass_z = float(start["load"] / setup.rig.gravity)
            setup.start.sinkage += self.extra_sinkage(start["load"])
        return setup

    def load(self) -> float:
        """Return the load on the wheel of the base set-up [N]."""
        return self.base.rig.mass_z * self.base.rig.gravity

    def extra_sinkage(self, load: float) -> float:
        """Additional sinkage at the start of a wheel under another load [m]."""
        simulator = self.base.trial().simulator
        zeta = simulator.terrain.zeta
        factor = float(getattr(zeta, "value", np.array([1.0])).ravel()[0])
        depths = [standing_sinkage(simulator, factor, each) for each in (load, self.load())]
        return depths[0] - depths[1]

    def evaluate(self, names: Sequence[str], setups: Sequence[SetUp]) -> list[RunOption]:
        """Information of a run of each set-up, on the set-up's own plates."""
        knots = max(len(each.command.time) for each in setups)
        longest = max(each.command.time[-1] - each.command.time[0] for each in setups)
        trials = [stackable_trial(each, self.step, knots, longest) for each in setups]
        scale = parameter_scales(trials[0], self.quantities)
        options = []
        for first in range(0, len(trials), RUNS_A_CALL):
            some = trials[first : first + RUNS_A_CALL]
            padded = some + some[-1:] * (RUNS_A_CALL - len(some))
            derived = np.asarray(_derived(stack(padded), self.quantities, jnp.asarray(scale)))
            for place, derivatives in enumerate(derived[: len(some)], start=first):
                options.append(self._option(names[place], setups[place], derivatives, scale[0]))
        return options

    def _option(self, name: str, setup: SetUp, derivatives: np.ndarray, scale: float) -> RunOption:
        counts = compared_rows(setup, derivatives.shape[1])
        value = float(self.quantities[0].read(setup.trial()))

        def known(extra: str | None = None) -> ParameterInformation:
            weight = self.instrument.weight(extra)
            return parameter_information(derivatives, weight, counts, self.quantities, value, scale)

        return RunOption(
            name, setup, known(), {each: known(each) for each in self.instrument.additions}
        )
