"""A case on the bench: every effect's columns along every run, from one linearisation."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from diagnose.dataset import RigDataset, with_zeta
from diagnose.linear.input_sensitivity import (
    READINGS,
    InputSensitivity,
    effect_sensitivity,
    propagate,
    shape_grid,
    zeta_sensitivity,
)
from diagnose.linear.linear_fit import GramMatrices, block_names
from diagnose.linear.residual_blocks import SlowFastSplit
from diagnose.model.augmented_model import AugmentedModel
from diagnose.model.linearized_run import LinearizedRun
from diagnose.model.shared_programs import program_of
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import field_metadata, shapes, strengths
from drftjax.simulation.trial import Trial


@dataclass(frozen=True)
class ShapeVariant:
    """An effect with shapes from its grid.

    Attributes:
        effect: Its class.
        shapes: Value of each shape, in the effect's order.
        columns: Numbers of its columns, one for each strength.
        near: Numbers of other variants, before and after along each shape; itself at the edge.
    """

    effect: type[AbstractEffect]
    shapes: tuple[float, ...]
    columns: tuple[int, ...]
    neighbours: tuple[tuple[int, int], ...]


@dataclass(frozen=True, eq=False)
class Regressors:
    """Columns of a case.

    Attributes:
        case: Its runs.
        log_zeta: Each run's, over its set-up's, where all is linearised.
        variants: Every effect with every combination of shapes.
        columns: By run: derivatives of the compared samples by (own log zeta, every column in
            units of its typical size), shape (channels, samples, 1 + columns).
        residual: By run: simulated less recorded there, shape (channels, samples).
        splitters: By run.
    """

    dataset: RigDataset
    log_zeta: np.ndarray
    variants: tuple[ShapeVariant, ...]
    columns: list[np.ndarray]
    residual: list[np.ndarray]
    splits: list[SlowFastSplit]

    @classmethod
    def of(
        cls, case: RigDataset, log_zeta: np.ndarray, effects: Sequence[type[AbstractEffect]]
    ) -> "Regressors":
        """The case linearised at these zetas, with these effects' columns."""
        variants, scale = _variants(effects)
        picked = [READINGS.index(name) for name in case.channels]

        def of(run: int) -> tuple[np.ndarray, np.ndarray]:
            path = case.linearized(run, log_zeta[run])
            trial = with_zeta(case.trials[run], log_zeta[run])
            node = jnp.asarray(case.node_interval(run))
            found = [np.asarray(propagate(path, zeta_sensitivity(path)))]
            for each in effects:
                by_program = propagate(path, _sensitivity(each, trial, path, node))
                found.append(_of_effect(np.asarray(by_program), each))
            at_nodes = np.concatenate(found, axis=-1)[:, picked]
            at_nodes[:, :, 1:] *= scale
            nodes = int(path.nodes)
            columns = _at(case.time(run), np.asarray(path.time)[: nodes + 1], at_nodes)
            plain = case.prediction(AugmentedModel(), run, log_zeta[run], np.zeros(0))
            return columns, plain - case.recording(run)

        # Compiled once, side by side, before every thread needs all of them.
        first = case.linearized(0, log_zeta[0])
        node = jnp.asarray(case.node_interval(0))
        one_of_each = {program_of(each).effect: each for each in effects}.values()
        list(
            case.threads.map(
                lambda each: _sensitivity(each, case.trials[0], first, node), one_of_each
            )
        )
        both = case.map_runs(of)
        splitters = [SlowFastSplit.of(case.time(run)) for run in range(len(case.runs))]
        return cls(case, log_zeta, variants, [c for c, _ in both], [r for _, r in both], splitters)

    @cached_property
    def log_reference_zeta(self) -> np.ndarray:
        """Logarithm of the zeta that each run's log zeta counts from."""
        return np.array(
            [float(np.log(t.simulator.terrain.zeta.value)) for t in self.dataset.trials]  # pyright: ignore
        )

    @cached_property
    def gram_matrices(self) -> GramMatrices:
        """Products of all columns with each other and with what the baseline leaves."""
        return self.gram_matrices_of(self.columns, self.residual, self.log_zeta)

    @cached_property
    def noise_power(self) -> np.ndarray:
        """Mean square of the instruments' white noise in each block."""
        found = []
        for channel, kind in block_names(self.dataset.channels):
            power = []
            for run, splitter in enumerate(self.splits):
                observation = self.dataset.runs[run].observation
                if channel not in observation.channels:
                    continue
                sigma = float(observation.noise[observation.channels.index(channel)])
                mean = float((splitter.bin_means**2).sum(axis=1).mean())
                part = {"slow": mean * (2 if channel == "x" else 1), "fast": 1 - mean}[kind]
                power.append(sigma**2 * part)
            found.append(float(np.mean(power)))
        return np.array(found)

    def gram_matrices_of(
        self, columns: list[np.ndarray], residual: list[np.ndarray], log_zeta: np.ndarray
    ) -> GramMatrices:
        """Products of some columns (own zeta first) and residuals, by run and block."""

        def of(run: int) -> tuple[np.ndarray, np.ndarray]:
            grams, counts = [], []
            for index, channel in enumerate(self.dataset.channels):
                both = np.concatenate([columns[run][index], residual[run][index][:, None]], axis=1)
                recorded = np.isfinite(both[:, -1]).all()
                parts = self.splits[run].split(channel, both)
                for part in parts.values():
                    part = part if recorded else np.zeros_like(part)
                    grams.append(part.T @ part)
                    counts.append(len(part) if recorded else 0)
            return np.array(grams), np.array(counts)

        found = self.dataset.map_runs(of)
        return GramMatrices(
            block_names(self.dataset.channels),
            np.array([gram for gram, _ in found]),
            np.array([count for _, count in found]),
            log_zeta + self.log_reference_zeta,
        )


def _sensitivity(
    effect: type[AbstractEffect], trial: Trial, path: LinearizedRun, node: Array
) -> InputSensitivity:
    program = program_of(effect)
    return effect_sensitivity(program.effect, trial, path, node, shape_grid(effect), program.held)


def _of_effect(columns: np.ndarray, effect: type[AbstractEffect]) -> np.ndarray:
    """Columns by an effect's own strengths, variant by variant, from those of its program."""
    mix = program_of(effect).mix
    return (columns.reshape(*columns.shape[:-1], -1, len(mix)) @ mix).reshape(
        *columns.shape[:-1], -1
    )


def _variants(
    effects: Sequence[type[AbstractEffect]],
) -> tuple[tuple[ShapeVariant, ...], np.ndarray]:
    variants: list[ShapeVariant] = []
    scale: list[float] = []
    for effect in effects:
        values = {name: np.asarray(v) for name, v in shape_grid(effect).items()}
        names = shapes(effect)
        sizes = [len(field_metadata(effect)[name]["starts"]) for name in names]
        first = len(variants)
        for place in np.ndindex(*sizes):
            number = int(np.ravel_multi_index(place, sizes)) if sizes else 0
            near = []
            for axis, size in enumerate(sizes):
                pair = []
                for step in (-1, 1):
                    moved = list(place)
                    moved[axis] = min(max(place[axis] + step, 0), size - 1)
                    pair.append(first + int(np.ravel_multi_index(moved, sizes)))
                near.append((pair[0], pair[1]))
            count = len(strengths(effect))
            columns = tuple(range(len(scale), len(scale) + count))
            scale += [field_metadata(effect)[name]["typical"] for name in strengths(effect)]
            given = tuple(float(values[name][number]) for name in names)
            variants.append(ShapeVariant(effect, given, columns, tuple(near)))
    return tuple(variants), np.array(scale)


def _at(time: np.ndarray, nodes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values at nodes, at other times; shape (channels, samples, columns)."""
    place = np.clip(np.searchsorted(nodes, time, side="right") - 1, 0, len(nodes) - 2)
    share = np.clip((time - nodes[place]) / (nodes[place + 1] - nodes[place]), 0, 1)
    share = share[:, None, None]
    between = values[place] * (1 - share) + values[place + 1] * share
    return np.moveaxis(between, 1, 0)
