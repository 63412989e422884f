"""The grousered wheel of the CMU data: which effect explains the zeta that falls with slip?

One zeta and one effect's numbers are fitted to the steady sinkages at all slips but one, and the
slip left out is predicted; then high slips are predicted from low ones.

    python -m tests.studies.cmu_gap [--data FOLDER]
"""

import argparse
import dataclasses
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from diagnose.model.augmented_model import AugmentedModel
from drftjax.common.jax_config import configure_jax
from drftjax.effects import composition
from drftjax.effects.base import StepContext
from drftjax.effects.catalogue import effect_class, field_metadata
from drftjax.physics.state import State
from drftjax.simulation.simulator import Simulator
from tests.studies import cmu_data as data
from tests.studies import cmu_driving as driving
from tests.studies.cmu import NOMINAL_LOAD, summarise
from tests.studies.cmu_steady import Setting, pitch_of

# Effects that can bear on the steady sinkage of a driven wheel under a measured load. The others
# act on a free carriage, on changes of speed, once a turn, on the force alone, or alike at every
# slip.
EFFECTS = (
    "speed_gain",
    "wheel_radius",
    "grouser_height",
    "loosening",
    "slip_softening",
    "rate_hardening",
    "depth_hardening",
    "rigid_floor",
    "cohesion",
    "momentum_flux",
    "height_decrease",
    "excavation",
)
# What a number may not leave, where the effect itself does not say.
RANGE = {
    "speed_gain.gain": (-0.3, 0.3),
    "wheel_radius.excess": (-0.01, 0.01),
    "grouser_height.excess": (-0.005, 0.005),
    "loosening.loss": (0.0, 0.98),
    "slip_softening.loss": (0.0, 0.98),
    "depth_hardening.excess": (-2.0, 0.98),
    "momentum_flux.excess": (-100.0, 1e3),
}
# A shape may go this much beyond the values that the catalogue starts it from.
BEYOND = 3.0
# The rim runs at the carriage's speed until the step; means are of 70 to 75 s, and creep is counted
# from 40 to 45 s [s], [m/s].
STEP_AT, EARLY_AT, MEAN_AT, BEFORE = 19.5, 42.5, 72.5, 0.010
# Wheel angles over a pitch, and halvings of the sinkage's range: to a micrometre.
ANGLES, HALVINGS = 12, 17
FIRST_ZETA = 0.8
TURNS, ENOUGH, FIRST_DAMPING, MOST_DAMPING = 30, 1e-6, 1e-3, 1e8
# Slips that high ones are predicted from, and the settings in between.
LOW, BETWEEN = (0.0, 0.2, 0.5), (0.0, 0.5, 0.9)
# Explanations shown slip by slip.
SHOWN = 3
MM = 1e3

Reals = data.Reals
Rows = NDArray[np.bool_]


class Steady(eqx.Module):
    """Sinkage from the rim [m] and forward force of the sand [N] of every row."""

    sinkage: Float[Array, " rows"]
    forward: Float[Array, " rows"]


def steady(
    model: AugmentedModel,
    simulator: Simulator,
    setting: Setting,
    at: Float[Array, " free"],
    until: float = MEAN_AT,
) -> Steady:
    """The height that carries each row's load over a pitch, with effects and what they remember.

    Args:
        model: Effects.
        simulator: Wheel and sand.
        setting: Of every row.
        at: log zeta, and the effects' coordinates; differentiable in these.
        until: Time since the carriage set off [s].
    """
    simulator = dataclasses.replace(simulator, effects=model.build(at[1:])).prepared()
    effects, radius = simulator.effects, simulator.wheel.radius
    pitch = pitch_of(simulator.wheel)
    angles = jnp.arange(ANGLES if pitch else 1) / ANGLES * (pitch or 1.0)
    limit = jax.lax.stop_gradient(simulator.wheel.cut().sinkage_limit)

    def one(setting: Setting) -> tuple[Float[Array, ""], Float[Array, ""]]:
        nought = jnp.zeros_like(setting.vx)
        speed = jnp.stack([setting.vx, nought])
        memory = composition.begin(effects, State.at_rest(nought))
        omega, _ = composition.wheel_speed(effects, memory, setting.omega, nought, nought + 1.0)
        phases = ((STEP_AT, BEFORE / data.OUTER_RADIUS + nought), (until, omega))
        time, moment = 0.0, None
        for end, turning in phases:
            place = jnp.stack([setting.vx * end, nought])
            span = nought + end - time
            moment = StepContext(nought + end, span, place, speed, nought, turning, turning, radius)
            # What remembers here grows evenly while the speeds stay, so one long step is exact.
            memory = composition.advance(effects, memory, moment)
            time = end
        assert moment is not None
        zeta = jnp.exp(at[0]) * composition.zeta_factor(effects, memory, moment)

        def force(sinkage: Float[Array, ""]) -> Float[Array, "2"]:
            place = jnp.stack([setting.vx * until, -sinkage])

            def turned(angle: Float[Array, ""]) -> Float[Array, "3"]:
                return simulator.wrench(place, speed, angle, omega, zeta, memory=memory)

            piled = composition.loads(effects, memory, place, speed, moment, of_the_sand=True)
            return jax.vmap(turned)(angles)[:, :2].mean(0) + piled

        def halve(_, bracket):
            low, high = bracket
            middle = (low + high) / 2
            short = force(middle)[1] < setting.load
            return jnp.where(short, middle, low), jnp.where(short, high, middle)

        ends = jax.lax.fori_loop(0, HALVINGS, halve, (-limit / 4, limit))
        found = jax.lax.stop_gradient((ends[0] + ends[1]) / 2)
        # One step of Newton's carries the derivative by the numbers.
        stiffness = jax.lax.stop_gradient(jax.grad(lambda h: force(h)[1])(found))
        found = found - (force(found)[1] - setting.load) / stiffness
        return found, force(found)[0]

    return Steady(*jax.vmap(one)(setting))


@eqx.filter_jit
def _steady(
    model: AugmentedModel, simulator: Simulator, setting: Setting, at, until: float
) -> Steady:
    return steady(model, simulator, setting, at, until)


@eqx.filter_jit
def _sloped(model: AugmentedModel, simulator: Simulator, setting: Setting, at, until: float):
    """Sinkages [mm] and their derivatives by `at`."""

    def sinkage(at):
        return MM * steady(model, simulator, setting, at, until).sinkage

    return sinkage(at), jax.jacfwd(sinkage)(at)


@dataclass(frozen=True)
class Explanation:
    """Effects that may explain rows, beside one zeta for all of them."""

    model: AugmentedModel
    reading: driving.Reading
    rows: data.SteadyRows

    @cached_property
    def setting(self) -> Setting:
        return self.reading.setting(self.rows)

    @cached_property
    def measured(self) -> Reals:
        """Sinkage from the simulated rim [mm]."""
        return MM * (self.rows.sinkage - self.reading.below_rim)

    def sinkage(self, at: Reals, until: float = MEAN_AT) -> Reals:
        """Simulated [mm]."""
        found = _steady(self.model, self.reading.simulator, self.setting, jnp.asarray(at), until)
        return MM * np.asarray(found.sinkage)

    def forward(self, at: Reals) -> Reals:
        """Simulated forward force [N]."""
        found = _steady(self.model, self.reading.simulator, self.setting, jnp.asarray(at), MEAN_AT)
        return np.asarray(found.forward)

    def bounds(self) -> tuple[Reals, Reals]:
        """Least and most of every coordinate."""
        low, high = [np.log(0.05)], [np.log(20.0)]
        for free in self.model.free:
            effect = self.model.effects[free.index]
            about = field_metadata(effect)[free.field]
            if free.scale is None:
                reach = np.log(about["starts"])
                least, most = reach.min() - np.log(BEYOND), reach.max() + np.log(BEYOND)
            else:
                given = RANGE.get(f"{effect.about.name}.{free.field}", (about["least"], np.inf))
                least, most = np.array(given) / free.scale
            low.append(least)
            high.append(most)
        return np.array(low), np.array(high)

    def starts(self) -> Iterator[Reals]:
        """Where fits start: either sign of a strength, shapes at the ends of their values."""
        null = np.concatenate([[np.log(FIRST_ZETA)], self.model.null()])
        strong = [1 + i for i, free in enumerate(self.model.free) if free.scale is not None]
        shapes = [1 + i for i, free in enumerate(self.model.free) if free.scale is None]
        for sign in (1.0, -1.0) if strong else (1.0,):
            for end in (0, -1) if shapes else (0,):
                start = null.copy()
                start[strong] = sign
                for place in shapes:
                    free = self.model.free[place - 1]
                    about = field_metadata(self.model.effects[free.index])[free.field]
                    start[place] = np.log(about["starts"][end])
                yield np.clip(start, *self.bounds())

    def fitted(self, chosen: Rows, starts: Sequence[Reals] | None = None) -> Reals:
        """Coordinates that come closest to the chosen rows' sinkage, in least squares."""
        found = [self._descended(chosen, s) for s in (starts or list(self.starts()))]
        return min(found, key=lambda each: each[1])[0]

    def _descended(self, chosen: Rows, at: Reals) -> tuple[Reals, float]:
        """Levenberg's method between the bounds; the sum of squares at its end [mm2]."""
        low, high = self.bounds()

        def look(at: Reals) -> tuple[Reals, Reals, float]:
            simulator, setting = self.reading.simulator, self.setting
            values, slope = _sloped(self.model, simulator, setting, jnp.asarray(at), MEAN_AT)
            left = (np.asarray(values) - self.measured)[chosen]
            return left, np.asarray(slope)[chosen], float(left @ left)

        left, slope, cost = look(at)
        damping = FIRST_DAMPING
        for _ in range(TURNS):
            gram = slope.T @ slope
            gram += damping * np.diag(np.diag(gram) + 1e-9)
            gradient = slope.T @ left
            # A number on its bound that would leave it stays there.
            free = ~(((at <= low) & (gradient > 0)) | ((at >= high) & (gradient < 0)))
            if not free.any():
                break
            step = np.zeros_like(at)
            step[free] = np.linalg.solve(gram[np.ix_(free, free)], -gradient[free])
            moved = np.clip(at + step, low, high)
            found = look(moved)
            if np.isfinite(found[2]) and found[2] < cost:
                gained = cost - found[2]
                at, (left, slope, cost) = moved, found
                damping = max(damping / 5, 1e-9)
                if gained < ENOUGH * cost:
                    break
            else:
                damping *= 5
                if damping > MOST_DAMPING:
                    break
        return at, cost

    def missed(self, fitted: Rows, told: Rows, known: Reals) -> Reals:
        """Errors [mm] at the rows `told` of a fit to the rows `fitted`; it starts at `known`."""
        first = next(iter(self.starts()))
        at = self.fitted(fitted, [known, first] if len(known) > 1 else [known])
        return (self.sinkage(at) - self.measured)[told]


@dataclass(frozen=True)
class Judged:
    """What one explanation is worth.

    Attributes:
        of: The explanation.
        at: Its coordinates, fitted to all driven rows.
        fitted: Errors of that fit [mm].
        unseen: Errors at each row, its slip left out of the fit [mm].
        high: Errors at slips 0.75 and 0.9, from slips 0 to 0.5 [mm].
        between: Errors at slips 0.2 and 0.75, from slips 0, 0.5 and 0.9 [mm].
        force: Forward force, simulated less measured, of the fit to all [N].
    """

    of: Explanation
    at: Reals
    fitted: Reals
    unseen: Reals
    high: Reals
    between: Reals
    force: Reals

    @property
    def name(self) -> str:
        return " + ".join(self.of.model.names) or "none"

    def told(self) -> str:
        """zeta and the effects' numbers."""
        words = [f"zeta {np.exp(self.at[0]):.2f}"]
        for free, value in zip(self.of.model.free, self.at[1:], strict=True):
            unit = field_metadata(self.of.model.effects[free.index])[free.field]["unit"]
            shown = f"{free.field} {float(free.value(value)):.3g}"
            words.append(shown if unit == "-" else f"{shown} {unit}")
        return ", ".join(words)


def judged(names: Sequence[str], reading: driving.Reading, rows: data.SteadyRows) -> Judged:
    """Fit effects to all slips, and predict the slips that they were not fitted to."""
    of = Explanation(AugmentedModel(tuple(effect_class(name) for name in names)), reading, rows)
    every = np.ones(rows.slip.shape, bool)
    at = of.fitted(every)
    unseen = np.zeros(rows.slip.shape)
    for slip in np.unique(rows.nominal):
        told = rows.nominal == slip
        unseen[told] = of.missed(~told, told, at)
    high, between = (
        of.missed(used, ~used, at) for used in (np.isin(rows.nominal, k) for k in (LOW, BETWEEN))
    )
    fitted = of.sinkage(at) - of.measured
    return Judged(of, at, fitted, unseen, high, between, of.forward(at) - rows.forward)


def driven_rows(rows: data.SteadyRows) -> data.SteadyRows:
    """Rows from slip 0 to 0.9."""
    kept = rows.between(0, 0.9)
    names = ("vx", "omega", "load", "sinkage", "forward")
    return data.SteadyRows(*(getattr(rows, name)[kept] for name in names))


def on_smooth(one: Judged, smooth: data.SteadyRows) -> float:
    """Error [mm] on the smooth wheel with the same numbers of the effects, zeta its own."""
    if "grouser_height" in one.of.model.names:
        return float("nan")
    of = Explanation(one.of.model, driving.circle(), smooth)

    def cost(log_zeta: float) -> float:
        return driving.rms(of.sinkage(np.r_[log_zeta, one.at[1:]]) - of.measured)

    low, high = np.log(0.1), np.log(4.0)
    for _ in range(26):
        third = (high - low) / 3
        right = cost(low + third) > cost(high - third)
        low, high = (low + third, high) if right else (low, high - third)
    return cost((low + high) / 2)


def piled(one: Judged) -> tuple[float, float]:
    """The steady resistance of a heap (bulldozing) that explains the forward force best [N].

    It bears on the force alone and is the same at every slip.

    Returns:
        The resistance, and the error of the force with it, each slip left out in turn [N].
    """
    nominal = one.of.rows.nominal
    left = np.zeros_like(one.force)
    for slip in np.unique(nominal):
        told = nominal == slip
        left[told] = one.force[told] - max(0.0, one.force[~told].mean())
    return max(0.0, float(one.force.mean())), driving.rms(left)


def effects_table(title: str, found: Sequence[Judged], smooth: data.SteadyRows) -> Table:
    """Every explanation, the best on left-out slips first."""
    table = Table(title=f"{title}, slip 0 to 0.9: sinkage RMSE mm", title_justify="left")
    for column in (
        "effect",
        "all 11 rows",
        "slip left out",
        "0.75, 0.9 from 0 to 0.5",
        "0.2, 0.75 from others",
        "smooth wheel",
        "Fx N",
        "Fx N with a heap",
        "heap N",
        "numbers",
    ):
        table.add_column(column, justify="left" if column in ("effect", "numbers") else "right")
    for each in sorted(found, key=lambda each: driving.rms(each.unseen)):
        errors = (each.fitted, each.unseen, each.high, each.between)
        heap, with_heap = piled(each)
        other = on_smooth(each, smooth)
        table.add_row(
            each.name,
            *(f"{driving.rms(error):.2f}" for error in errors),
            "-" if np.isnan(other) else f"{other:.2f}",
            *(f"{value:.2f}" for value in (driving.rms(each.force), with_heap, heap)),
            each.told(),
        )
    return table


def slips_table(found: Sequence[Judged]) -> Table:
    """Sinkage by slip, each predicted from the other slips."""
    rows = found[0].of.rows
    table = Table(title="Each slip predicted from the others, sinkage mm", title_justify="left")
    for column in ("slip", "n", "measured", *(each.name for each in found)):
        table.add_column(column, justify="right")
    below = found[0].of.reading.below_rim * MM
    for slip in np.unique(rows.nominal):
        here = rows.nominal == slip
        measured = rows.sinkage[here] * MM
        table.add_row(
            f"{slip:g}",
            str(here.sum()),
            f"{measured.mean():.1f}",
            *(f"{(e.of.measured + below + e.unseen)[here].mean():.1f}" for e in found),
        )
    return table


def creep_table(found: Sequence[Judged], runs: Sequence[data.Series]) -> Table:
    """What effects with a memory say of the rise of sinkage from 40-45 s to 70-75 s."""
    table = Table(title="Creep from 40-45 s to 70-75 s, mm", title_justify="left")
    for column in ("slip", "runs", "measured", *(each.name for each in found)):
        table.add_column(column, justify="right")
    for each in summarise([run for run in runs if data.setting_of(run.slip) >= 0]):
        mine = [run for run in runs if data.setting_of(run.slip) == each.slip]
        rows = data.SteadyRows(
            vx=np.array([run.vx for run in mine]),
            omega=np.array([run.rim_speed for run in mine]) / data.OUTER_RADIUS,
            load=np.full(len(mine), NOMINAL_LOAD),
            sinkage=np.zeros(len(mine)),
            forward=np.zeros(len(mine)),
        )
        creeps = []
        for one in found:
            of = Explanation(one.of.model, one.of.reading, rows)
            creeps.append((of.sinkage(one.at) - of.sinkage(one.at, EARLY_AT)).mean())
        table.add_row(
            f"{each.slip:g}",
            str(len(mine)),
            f"{each.creep.mean() * MM:.2f}",
            *(f"{creep:.2f}" for creep in creeps),
        )
    return table


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=data.default_folder())
    folder: Path = parser.parse_args().data
    if not folder.is_dir():
        sys.exit(f"{folder}: there is no such folder; the CMU data are not part of this project")
    configure_jax()
    console = Console(width=200)
    both = driving.both_tables(folder)
    grouser, smooth = (driven_rows(both[wheel]) for wheel in (data.GROUSER, data.SMOOTH))
    readings = (driving.grousered("24 grousers, tips"), driving.circle())
    for reading in readings:
        names = [(), *((name,) for name in EFFECTS)]
        if reading.name == "circle":
            names.remove(("grouser_height",))
        found = [judged(each, reading, grouser) for each in names]
        console.print(effects_table(reading.name, found, smooth))
        by_name = {each.name: each for each in found}
        best = sorted(found, key=lambda each: driving.rms(each.unseen))[:SHOWN]
        console.print(slips_table([by_name["none"], *best]))
        told = [by_name[name] for name in ("none", "excavation", "loosening", "slip_softening")]
        console.print(creep_table(told, data.series(folder, data.GROUSER)))


if __name__ == "__main__":
    main()
