"""Size of a mechanism's effect on the readings, beyond a zeta fitted to every run."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from diagnose.blind.generation.random_mechanisms import Mechanism
from diagnose.blind.plant import plant
from diagnose.blind.plant.plant import DEFAULT_PLANT, Part, PlantSettings
from diagnose.blind.plant.run_plan import PlannedRun
from diagnose.blind.plant.sensors import PlantReading
from drftjax.common.errors import InputError


@dataclass(frozen=True)
class EffectSizeSettings:
    """Noise floors, and the search for a strength.

    Attributes:
        noise_floor_x, noise_floor_z: RMS that noise and the scatter of zeta leave in a channel [m].
        zeta_nudge: Relative step of zeta for the derivative of a run [-].
        step_refinement: Ratio of a fit's time step to the step of the runs compared here [-].
            Differences of runs need no fine steps: these are twice as long as a fit's.
        max_step: Longest step of these runs, however long a fit's is [s].
        attempts: Most strengths that are tried.
        strength_ratio: Least and greatest ratio of one strength tried to the one before [-].
        size_ratio: Least and greatest ratio of the wanted size to one found that ends the search.
        min_strength_change: Relative change of the strength below which the search ends [-].
        strength_reduction: Divisor of a strength at which the plant cannot run [-].
        min_floors: Least size that the next strength is scaled from [noise floors].
    """

    noise_floor_x: float = 8e-5
    noise_floor_z: float = 3e-5
    zeta_nudge: float = 0.01
    step_refinement: float = 0.5
    max_step: float = 2e-3
    attempts: int = 6
    strength_ratio: tuple[float, float] = (0.02, 20.0)
    size_ratio: tuple[float, float] = (0.75, 1.33)
    min_strength_change: float = 0.05
    strength_reduction: float = 3.0
    min_floors: float = 1e-3

    @property
    def noise_floors(self) -> dict[str, float]:
        """Noise floor by channel [m]."""
        return {"x": self.noise_floor_x, "z": self.noise_floor_z}


DEFAULT_EFFECT_SIZE = EffectSizeSettings()


@dataclass(frozen=True)
class EffectSize:
    """Root mean squares over the runs of the changes that a mechanism makes, by channel.

    Attributes:
        total: Change at the same zeta [m].
        beyond_zeta: Part of it that a zeta fitted to each run does not remove [m].
        noise_floors: Noise floors [m].
    """

    total: dict[str, float]
    beyond_zeta: dict[str, float]
    noise_floors: dict[str, float]

    @property
    def floors(self) -> float:
        """`beyond_zeta` in noise floors, in the channel where that is more [-]."""
        return max(self.beyond_zeta[name] / floor for name, floor in self.noise_floors.items())

    def document(self) -> dict:
        """Size as a label holds it."""
        gap = {
            name: {
                "whole_mm": 1e3 * self.total[name],
                "left_mm": 1e3 * self.beyond_zeta[name],
                "floors": 1e3 * self.beyond_zeta[name] / (1e3 * floor),
            }
            for name, floor in self.noise_floors.items()
        }
        return {"floors": self.floors, "gap": gap}


@dataclass(frozen=True)
class EffectSizeProbe:
    """A few runs of the plant without a mechanism, and their derivative by log zeta.

    Attributes:
        runs: Commands and loads.
        zeta: Scaling factor [-].
        groups: Groups of effects that their program holds, all at strength zero.
        settings: Noise floors and numbers of the search.
        plant_settings: Resolution of the plant.
        reference: Channels of each run without a mechanism, shape (2, rows) [noise floors].
        slope: Derivative of `reference` by log zeta.
    """

    runs: tuple[PlannedRun, ...]
    zeta: float
    groups: tuple[str, ...]
    settings: EffectSizeSettings
    plant_settings: PlantSettings
    reference: tuple[np.ndarray, ...] = ()
    slope: tuple[np.ndarray, ...] = ()

    @classmethod
    def of(
        cls,
        runs: Sequence[PlannedRun],
        zeta: float,
        groups: tuple[str, ...],
        settings: EffectSizeSettings = DEFAULT_EFFECT_SIZE,
        plant_settings: PlantSettings = DEFAULT_PLANT,
    ) -> "EffectSizeProbe":
        """Simulate the runs without a mechanism, at two values of zeta."""
        bare, nudge = cls(tuple(runs), zeta, groups, settings, plant_settings), settings.zeta_nudge
        reference = tuple(bare._channels((), run, 1.0 * zeta) for run in runs)
        nudged = tuple(bare._channels((), run, (1 + nudge) * zeta) for run in runs)
        slope = tuple((b - a) / nudge for a, b in zip(reference, nudged, strict=True))
        return replace(bare, reference=reference, slope=slope)

    def _channels(self, parts: Sequence[Part], run: PlannedRun, zeta: float) -> np.ndarray:
        """Channels of one run, shape (2, rows) [noise floors]."""
        refinement = max(
            self.settings.step_refinement, plant.fit_step(run) / self.settings.max_step
        )
        resolution = replace(self.plant_settings, step_refinement=refinement)
        reading: PlantReading = plant.run_plant(parts, run, zeta, self.groups, resolution)
        floors = self.settings.noise_floors
        return np.stack([getattr(reading, name) / floor for name, floor in floors.items()])

    def size(self, parts: Sequence[Part]) -> EffectSize:
        """Size of the effect of mechanisms on these runs.

        Raises:
            InputError: The plant cannot run with them.
        """
        total, beyond_zeta = [], []
        for run, reference, slope in zip(self.runs, self.reference, self.slope, strict=True):
            change = self._channels(parts, run, self.zeta) - reference
            log_zeta = float((slope * change).sum() / (slope**2).sum())
            total.append(change)
            beyond_zeta.append(change - log_zeta * slope)
        floors = self.settings.noise_floors
        return EffectSize(_rms(total, floors), _rms(beyond_zeta, floors), floors)

    def find_strength(self, mechanism: Mechanism, target: float) -> tuple[float, EffectSize]:
        """Search the strength at which a mechanism has a wanted size, within what a rig may have.

        The size is about proportional to the strength, so each try scales the one before.

        Args:
            mechanism: Mechanism of settled form.
            target: Wanted size [noise floors].

        Returns:
            The strength tried whose size is nearest in ratio, in the unit of the mechanism, and
            that size.

        Raises:
            InputError: The plant can run at no strength that was tried.
        """
        settings = self.settings
        strength, best = min(mechanism.typical_strength, mechanism.max_strength), None
        nearest = inf
        for _ in range(settings.attempts):
            try:
                size = self.size([mechanism.build(strength)])
            except InputError:
                strength /= settings.strength_reduction
                continue
            distance = abs(np.log(size.floors / target))
            if best is None or distance < nearest:
                best, nearest = (strength, size), distance
            ratio = target / max(size.floors, settings.min_floors)
            following = strength * np.clip(ratio, *settings.strength_ratio)
            following = float(np.clip(following, 0, mechanism.max_strength))
            lowest, highest = settings.size_ratio
            is_settled = abs(following / strength - 1) < settings.min_strength_change
            if lowest < ratio < highest or is_settled:
                break
            strength = following
        if best is None:
            raise InputError(f"the plant runs at no strength of {mechanism.kind}")
        return best


def _rms(changes: list[np.ndarray], floors: dict[str, float]) -> dict[str, float]:
    """RMS of changes in noise floors, by channel [m]."""

    def rms(row: int) -> float:
        joined = np.concatenate([each[row] for each in changes])
        return float(np.sqrt(np.mean(joined**2)))

    return {name: rms(row) * floor for row, (name, floor) in enumerate(floors.items())}
