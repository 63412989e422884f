"""Response of all runs to every effect, from one linearisation per run.

This is the design matrix of the screening: a column for every strength of every variant of an
effect's shapes, in units of the strength's typical size.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import jax.numpy as jnp
import numpy as np

from diagnose.dataset import RigDataset, with_zeta
from diagnose.linear.hold_responses import with_hold_responses
from diagnose.linear.input_sensitivity import (
    READINGS,
    InputSensitivity,
    effect_sensitivity,
    propagate,
    shape_grid,
    zeta_sensitivity,
)
from diagnose.linear.linear_fit import (
    DEFAULT_LINEAR_FIT,
    GramMatrices,
    LinearFitSettings,
    block_names,
)
from diagnose.linear.linearized_runs import LinearizedRuns
from diagnose.linear.residual_blocks import SlowFastSplit
from diagnose.model.augmented_model import (
    AugmentedModel,
    directions_within,
    predict,
    predict_with_jacobian,
)
from diagnose.model.interpolation import rows_at
from diagnose.model.linearized_run import LinearizedRun
from diagnose.model.shared_programs import program_of
from diagnose.run_pool import RunPool
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import field_metadata, shapes, strengths
from drftjax.simulation.trial import Trial

# Each of these makes every simulation longer by a fifth and more, at its null, too: powers and arcs
# of every plate. They stay out of programs with many effects.
SLOW_EFFECTS = ("rate_hardening", "depth_power", "cohesion", "height_decrease_arc")


# By block: products of a run's columns with each other, and the number of statements.
Products = tuple[list[np.ndarray], list[int]]


@dataclass(frozen=True)
class ShapeVariant:
    """An effect with its shapes at one point of their grid.

    Attributes:
        effect: Its class.
        shapes: Value of each shape, in the effect's order.
        columns: Numbers of its columns, one for each strength.
        neighbours: Numbers of the variants before and after along each shape; itself at the edge.
            Empty where the columns are those of another effect.
    """

    effect: type[AbstractEffect]
    shapes: tuple[float, ...]
    columns: tuple[int, ...]
    neighbours: tuple[tuple[int, int], ...]


@dataclass(frozen=True, eq=False)
class Regressors:
    """Responses of a dataset's runs to effects, linear about the reference model.

    Attributes:
        dataset: The runs.
        log_zeta: Log zeta of each run over its set-up's, where all is linearised [-], shape
            (runs,).
        variants: Every effect with every combination of shapes.
        columns: By run: derivatives of the compared samples by (own log zeta, every column in
            units of its typical size) [m, N, N m], shape (channels, samples, 1 + columns).
        residual: By run: simulated minus recorded there [m, N, N m], shape (channels, samples).
        splits: By run: maps from its samples to blocks.
        parts: By run, by block: every column but own log zeta, in that block, shape (statements,
            columns).
        gram_matrices: Products of all columns with each other and with the residual.
        settings: Weights of all fits of these responses.
    """

    dataset: RigDataset
    log_zeta: np.ndarray
    variants: tuple[ShapeVariant, ...]
    columns: list[np.ndarray]
    residual: list[np.ndarray]
    splits: list[SlowFastSplit]
    parts: list[list[np.ndarray]] = field(repr=False)
    gram_matrices: GramMatrices = field(repr=False)
    settings: LinearFitSettings = DEFAULT_LINEAR_FIT

    @classmethod
    def of(
        cls,
        dataset: RigDataset,
        linearized: LinearizedRuns,
        effects: Sequence[type[AbstractEffect]],
        pool: RunPool,
        settings: LinearFitSettings = DEFAULT_LINEAR_FIT,
    ) -> "Regressors":
        """Responses of linearised runs to some effects.

        Args:
            dataset: The runs.
            linearized: The same, linearised.
            effects: Classes of the effects.
            pool: Threads.
            settings: Weights of fits.
        """
        _compile_sensitivities(dataset, linearized, effects, pool)
        log_zeta, variants = linearized.log_zeta, shape_variants(effects)
        typical = _typical_sizes(variants)

        def of(run: int) -> tuple[np.ndarray, np.ndarray]:
            plain = dataset.prediction(AugmentedModel(), run, log_zeta[run], np.zeros(0))
            columns = _responses(dataset, run, linearized, effects)
            columns[:, :, 1:] *= typical
            columns = with_hold_responses(
                dataset, run, float(log_zeta[run]), variants, columns, plain
            )
            return columns, plain - dataset.recording(run)

        both = dataset.map(pool, of)
        columns, residual = [c for c, _ in both], [r for _, r in both]
        splits = [
            SlowFastSplit.of(dataset.time(run), each.observation.mean_speed)
            for run, each in enumerate(dataset.runs)
        ]
        together = dataset.map(
            pool, lambda run: _parts(dataset, splits[run], columns[run], residual[run])
        )
        over_one = log_zeta + _log_reference_zeta(dataset)
        gram = _gram_matrices(dataset, [_products(each) for each in together], over_one)
        parts = [[part[:, 1:-1] for part in each] for each in together]
        return cls(dataset, log_zeta, variants, columns, residual, splits, parts, gram, settings)

    @cached_property
    def common_model(self) -> AugmentedModel:
        """Model with all effects that may be in one program, by which others are differentiated."""
        effects = dict.fromkeys(each.effect for each in self.variants)
        return AugmentedModel(tuple(e for e in effects if e.about.name not in SLOW_EFFECTS))

    def common_model_with(self, effects: Sequence[type[AbstractEffect]]) -> AugmentedModel:
        """The same with those of some effects that it lacks, each of which makes it slower."""
        common = self.common_model
        lacking = tuple(sorted({*effects} - {*common.effects}, key=lambda e: e.about.name))
        return AugmentedModel(common.effects + lacking) if lacking else common

    def model_to_differentiate(self, effects: Sequence[type[AbstractEffect]]) -> AugmentedModel:
        """The model by whose program a set of effects is differentiated.

        The dataset's where that has all of them, as it takes half as long; else the common one.
        """
        shared = self.dataset.shared
        return shared if {*effects} <= {*shared.effects} else self.common_model_with(effects)

    def begin_compiling(self, models: Sequence[AugmentedModel], pool: RunPool) -> None:
        """Begin with the programs that simulate some models, and with those that differentiate.

        Args:
            models: What is simulated next.
            pool: Threads.
        """
        for each in models:
            self.dataset.compile(pool, predict, each, waits=False)
        wholes = {self.model_to_differentiate(each.effects) for each in models}
        for whole in (self.dataset.shared, self.common_model):
            if whole in wholes:
                begin_derivatives(self.dataset, whole, pool)

    @cached_property
    def log_reference_zeta(self) -> np.ndarray:
        """Logarithm of the zeta that each run's log zeta counts from, shape (runs,)."""
        return _log_reference_zeta(self.dataset)

    @cached_property
    def noise_power(self) -> np.ndarray:
        """Mean square of the instruments' white noise in each block, shape (blocks,)."""
        found = []
        for channel, kind in block_names(self.dataset.channels):
            power = []
            for run, split in enumerate(self.splits):
                observation = self.dataset.runs[run].observation
                if channel not in observation.channels:
                    continue
                sigma = float(observation.noise[observation.channels.index(channel)])
                mean = float((split.bin_means**2).sum(axis=1).mean())
                slow = mean * (2 if channel == "x" else 1)
                level = 1 / split.bin_means.shape[1]
                if channel == "x":
                    # A run's x begins at what its first samples say, one of them at worst.
                    level = split.travel_share**2 * (1 + level)
                part = {"slow": slow, "fast": 1 - mean, "level": level}[kind]
                power.append(sigma**2 * part)
            found.append(float(np.mean(power)))
        return np.array(found)

    def gram_matrices_of(
        self,
        columns: list[np.ndarray],
        residual: list[np.ndarray],
        log_zeta: np.ndarray,
        pool: RunPool,
    ) -> GramMatrices:
        """Gram matrices of other columns and residuals of the same runs.

        Args:
            columns: By run, own log zeta first, shape (channels, samples, columns).
            residual: By run, shape (channels, samples).
            log_zeta: Log zeta of each run over its set-up's [-], where they are taken.
            pool: Threads.
        """
        dataset = self.dataset

        def of(run: int) -> Products:
            return _products(_parts(dataset, self.splits[run], columns[run], residual[run]))

        return _gram_matrices(dataset, dataset.map(pool, of), log_zeta + self.log_reference_zeta)

    def gram_matrices_beside_all(
        self,
        columns: list[np.ndarray],
        residual: list[np.ndarray],
        log_zeta: np.ndarray,
        pool: RunPool,
    ) -> GramMatrices:
        """The same with every column of the regressors behind those that are given.

        Args:
            columns, residual, log_zeta, pool: As for `gram_matrices_of`.
        """
        known = self.gram_matrices
        count = columns[0].shape[-1]
        size = count + known.gram.shape[-1] - 1
        gram = np.empty((*known.gram.shape[:2], size, size))

        def fill(run: int) -> list[int]:
            given = _parts(self.dataset, self.splits[run], columns[run], residual[run])
            beside = slice(count, -1)
            for block, (part, mine) in enumerate(zip(given, self.parts[run], strict=True)):
                # In place: what pieces are joined from would be copied twice.
                whole, own, cross = gram[run, block], part.T @ part, part.T @ mine
                whole[:count, :count] = own[:-1, :-1]
                whole[:count, -1] = whole[-1, :count] = own[-1, :-1]
                whole[-1, -1] = own[-1, -1]
                whole[:count, beside], whole[beside, :count] = cross[:-1], cross[:-1].T
                whole[-1, beside] = whole[beside, -1] = cross[-1]
                # Products of the regressors with each other exist already.
                whole[beside, beside] = known.gram[run, block, 1:-1, 1:-1]
            return [len(part) for part in given]

        counts = np.array(self.dataset.map(pool, fill))
        over_one = log_zeta + self.log_reference_zeta
        return GramMatrices(block_names(self.dataset.channels), gram, counts, over_one)

    def block_powers(self, residual: list[np.ndarray], pool: RunPool) -> np.ndarray:
        """Part of each run in the mean square of residuals in each block, shape (runs, blocks).

        Args:
            residual: By run, simulated minus recorded [m, N, N m], shape (channels, samples).
            pool: Threads.
        """
        nothing = [np.zeros((*each.shape, 0)) for each in residual]
        matrices = self.gram_matrices_of(nothing, residual, np.zeros(len(residual)), pool)
        return matrices.gram[:, :, -1, -1] / np.maximum(matrices.sample_count.sum(axis=0), 1)


def begin_derivatives(dataset: RigDataset, whole: AugmentedModel, pool: RunPool) -> None:
    """Begin with the program that differentiates sets of some effects.

    Args:
        dataset: The runs.
        whole: Model with all of these effects, one at least.
        pool: Threads.
    """
    directions = directions_within(AugmentedModel(whole.effects[:1]), whole)
    dataset.compile(pool, predict_with_jacobian, directions, waits=False)


def _log_reference_zeta(dataset: RigDataset) -> np.ndarray:
    return np.array(
        [float(np.log(t.simulator.terrain.zeta.value)) for t in dataset.trials]  # pyright: ignore
    )


def _parts(
    dataset: RigDataset, split: SlowFastSplit, columns: np.ndarray, residual: np.ndarray
) -> list[np.ndarray]:
    """Columns of a run and its residual, by block; of no samples where a channel has none.

    Args:
        dataset: The runs.
        split: Map from the run's samples to blocks.
        columns: Shape (channels, samples, columns).
        residual: Shape (channels, samples).
    """
    found = []
    for index, channel in enumerate(dataset.channels):
        both = np.concatenate([columns[index], residual[index][:, None]], axis=1)
        recorded = np.isfinite(both[:, -1]).all()
        parts = split.split(channel, both).values()
        found += parts if recorded else [part[:0] for part in parts]
    return found


def _products(parts: Sequence[np.ndarray]) -> Products:
    """Gram matrix and number of statements of each block's columns, shape (statements, n)."""
    # A response that grows without bounds has no finite products.
    with np.errstate(over="ignore", invalid="ignore"):
        return [part.T @ part for part in parts], [len(part) for part in parts]


def _gram_matrices(
    dataset: RigDataset, products: Sequence[Products], log_zeta: np.ndarray
) -> GramMatrices:
    """Gram matrices from each run's products and log zeta over one reference [-], shape (runs,)."""
    grams, counts = zip(*products, strict=True)
    blocks = block_names(dataset.channels)
    return GramMatrices(blocks, np.array(grams), np.array(counts), log_zeta)


def _responses(
    dataset: RigDataset,
    run: int,
    linearized: LinearizedRuns,
    effects: Sequence[type[AbstractEffect]],
) -> np.ndarray:
    """Derivatives of one run's compared samples by own log zeta and every strength, in its unit.

    Returns:
        Shape (channels, samples, 1 + columns).
    """
    along = linearized.runs[run]
    trial = with_zeta(dataset.trials[run], float(linearized.log_zeta[run]))
    found = [np.asarray(propagate(along, zeta_sensitivity(along)))]
    for each in effects:
        by_program = propagate(along, _sensitivity(each, trial, along))
        found.append(_by_own_strengths(np.asarray(by_program), each))
    picked = [READINGS.index(name) for name in dataset.channels]
    at_nodes = np.concatenate(found, axis=-1)[:, picked]
    node_times = np.asarray(along.time)[: int(along.nodes) + 1]
    return np.moveaxis(rows_at(node_times, at_nodes, dataset.time(run)), 1, 0)


def _compile_sensitivities(
    dataset: RigDataset,
    linearized: LinearizedRuns,
    effects: Sequence[type[AbstractEffect]],
    pool: RunPool,
) -> None:
    """Compile each program once, side by side, before every thread needs all of them."""
    one_of_each = {program_of(each).effect: each for each in effects}.values()
    trial, first = dataset.trials[0], linearized.runs[0]
    pool.map(lambda each: _sensitivity(each, trial, first), one_of_each)


def _sensitivity(
    effect: type[AbstractEffect], trial: Trial, linearized: LinearizedRun
) -> InputSensitivity:
    program, node = program_of(effect), jnp.asarray(linearized.node_interval)
    return effect_sensitivity(
        program.effect, trial, linearized, node, shape_grid(effect), program.held
    )


def _by_own_strengths(columns: np.ndarray, effect: type[AbstractEffect]) -> np.ndarray:
    """Columns by an effect's own strengths, variant by variant, from those of its program."""
    mix = program_of(effect).mix
    return (columns.reshape(*columns.shape[:-1], -1, len(mix)) @ mix).reshape(
        *columns.shape[:-1], -1
    )


def _typical_sizes(variants: Sequence[ShapeVariant]) -> np.ndarray:
    """Typical size of the strength of each column, in its unit, shape (columns,)."""
    return np.array(
        [
            field_metadata(variant.effect)[name]["typical"]
            for variant in variants
            for name in strengths(variant.effect)
        ]
    )


def shape_variants(effects: Sequence[type[AbstractEffect]]) -> tuple[ShapeVariant, ...]:
    """Every combination of shapes on each effect's grid, with columns numbered in that order."""
    found: list[ShapeVariant] = []
    columns = 0
    for effect in effects:
        values = {name: np.asarray(v) for name, v in shape_grid(effect).items()}
        names, count = shapes(effect), len(strengths(effect))
        sizes = [len(field_metadata(effect)[name]["starts"]) for name in names]
        first = len(found)
        for place in np.ndindex(*sizes):
            number = int(np.ravel_multi_index(place, sizes)) if sizes else 0
            given = tuple(float(values[name][number]) for name in names)
            own = tuple(range(columns, columns + count))
            found.append(ShapeVariant(effect, given, own, _neighbours(place, sizes, first)))
            columns += count
    return tuple(found)


def _neighbours(
    place: tuple[int, ...], sizes: Sequence[int], first: int
) -> tuple[tuple[int, int], ...]:
    """Numbers of the variants before and after along each axis of a grid that begins at `first`."""

    def moved(axis: int, step: int) -> int:
        there = list(place)
        there[axis] = min(max(place[axis] + step, 0), sizes[axis] - 1)
        return first + int(np.ravel_multi_index(there, sizes))

    return tuple((moved(axis, -1), moved(axis, 1)) for axis in range(len(sizes)))
