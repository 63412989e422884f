"""Size of a mechanism's effect on the readings, beyond a zeta fitted to every run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, inf

import numpy as np

from diagnose.blind.generation.random_mechanisms import Mechanism
from diagnose.blind.plant import plant
from diagnose.blind.plant.plant import DEFAULT_PLANT, Part, PlantSettings
from diagnose.blind.plant.rig import DEFAULT_RIG, GRAVITY, PlantRig
from diagnose.blind.plant.run_plan import PlannedRun
from drftjax.common.errors import InputError


@dataclass(frozen=True)
class EffectSizeSettings:
    """Noise floors, and the search for a strength.

    Attributes:
        noise_floor_x, noise_floor_z: RMS that noise and the scatter of zeta leave in a channel [m].
        noise_floor_force: RMS that noise leaves in a force, over the load [-], and in the torque,
            over the load times the radius.
        zeta_nudge: Relative step of zeta for the derivative of a run [-].
        step_refinement: Ratio of a fit's time step to the step of the runs compared here [-].
            Differences of runs need no fine steps: these are twice as long as a fit's.
        max_step: Longest step of these runs, however long a fit's is [s]: the plant's own longest.
        attempts: Most strengths that are tried.
        strength_ratio: Least and greatest ratio of one strength tried to the one before [-].
        size_ratio: Least and greatest ratio of the wanted size to one found that ends the search.
        min_strength_change: Relative change of the strength below which the search ends [-].
        strength_reduction: Divisor of a strength at which the plant cannot run [-].
        min_floors: Least size that the next strength is scaled from [noise floors].
    """

    noise_floor_x: float = 8e-5
    noise_floor_z: float = 3e-5
    noise_floor_force: float = 2e-3
    zeta_nudge: float = 0.01
    step_refinement: float = 0.5
    max_step: float = 5e-3
    attempts: int = 6
    strength_ratio: tuple[float, float] = (0.02, 20.0)
    size_ratio: tuple[float, float] = (0.75, 1.33)
    min_strength_change: float = 0.05
    strength_reduction: float = 3.0
    min_floors: float = 1e-3

    def noise_floors(self, rig: PlantRig = DEFAULT_RIG) -> dict[str, float]:
        """Noise floor of each channel that a rig records [m, N, N m]."""
        floors = {"x": self.noise_floor_x, "z": self.noise_floor_z}
        if rig.is_driven:
            force = self.noise_floor_force * rig.mass_z * GRAVITY
            floors |= {"fx": force, "fz": force, "torque": force * rig.radius}
        return floors


DEFAULT_EFFECT_SIZE = EffectSizeSettings()


@dataclass(frozen=True)
class EffectSize:
    """Root mean squares over the runs of the changes that a mechanism makes, by channel.

    Attributes:
        total: Change at the same zeta [m, N, N m].
        beyond_zeta: Part of it that zeta does not remove, in the same units.
        noise_floors: Noise floors, in the same units.
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
        gap = {}
        for name, floor in self.noise_floors.items():
            unit, per_si = {"x": ("mm", 1e3), "z": ("mm", 1e3), "torque": ("Nm", 1.0)}.get(
                name, ("N", 1.0)
            )
            gap[name] = {
                f"whole_{unit}": per_si * self.total[name],
                f"left_{unit}": per_si * self.beyond_zeta[name],
                "floors": self.beyond_zeta[name] / floor,
            }
        return {"floors": self.floors, "gap": gap}


@dataclass(frozen=True)
class EffectSizeProbe:
    """A few runs of the plant without a mechanism, and their derivative by log zeta.

    With a free carriage, a zeta of its own is fitted to every run: it has the mean sinkage. Forces
    tell more, so runs of a driven carriage share one zeta, and the scatter of zeta from run to run
    is part of the noise floors.

    Attributes:
        runs: Commands and loads.
        zeta: Scaling factor [-].
        groups: Groups of effects that their program holds, all at strength zero but for `base`.
        settings: Noise floors and numbers of the search.
        plant_settings: Resolution of the plant.
        rig: Wheel, masses, carriage and sand.
        base: Parts of the plant that are there in any case.
        floors: Noise floor by channel [m, N, N m].
        reference: Channels of each run without a mechanism, shape (channels, rows), in these units.
        slope: Derivative of `reference` by log zeta.
    """

    runs: tuple[PlannedRun, ...]
    zeta: float
    groups: tuple[str, ...]
    settings: EffectSizeSettings
    plant_settings: PlantSettings
    rig: PlantRig
    base: tuple[Part, ...]
    floors: Mapping[str, float]
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
        rig: PlantRig = DEFAULT_RIG,
        base: Sequence[Part] = (),
        zeta_scatter: float = 0.0,
    ) -> "EffectSizeProbe":
        """Simulate the runs without a mechanism, at two values of zeta.

        Args:
            runs, zeta, groups, settings, plant_settings, rig, base: As the attributes.
            zeta_scatter: Standard deviation of log zeta between runs, with a driven carriage [-].
        """
        floors, nudge = settings.noise_floors(rig), settings.zeta_nudge
        bare = cls(tuple(runs), zeta, groups, settings, plant_settings, rig, tuple(base), floors)
        reference = tuple(bare._channels((), run, 1.0 * zeta) for run in runs)
        nudged = tuple(bare._channels((), run, (1 + nudge) * zeta) for run in runs)
        slope = tuple((b - a) / nudge for a, b in zip(reference, nudged, strict=True))
        if rig.is_driven:
            spread = _rms(slope, floors)
            floors = {name: hypot(floors[name], zeta_scatter * spread[name]) for name in floors}
        return replace(bare, reference=reference, slope=slope, floors=floors)

    def _channels(self, parts: Sequence[Part], run: PlannedRun, zeta: float) -> np.ndarray:
        """Channels of one run, shape (channels, rows) [m, N, N m]."""
        longest = plant.fit_step(run, self.zeta, self.rig) / self.settings.max_step
        refinement = max(self.settings.step_refinement, longest)
        resolution = replace(self.plant_settings, step_refinement=refinement)
        everything = (*self.base, *parts)
        reading = plant.run_plant(everything, run, zeta, self.groups, resolution, self.rig)
        logged = reading.since(run.logged_from)
        return np.stack([getattr(logged, name) for name in self.floors])

    def size(self, parts: Sequence[Part]) -> EffectSize:
        """Size of the effect of mechanisms on these runs.

        Raises:
            InputError: The plant cannot run with them.
        """
        scale = 1 / np.array(list(self.floors.values()))[:, None]
        slopes = [scale * each for each in self.slope]
        changes = [
            scale * (self._channels(parts, run, self.zeta) - reference)
            for run, reference in zip(self.runs, self.reference, strict=True)
        ]
        shifts = [
            (float((slope * change).sum()), float((slope**2).sum()))
            for slope, change in zip(slopes, changes, strict=True)
        ]
        if self.rig.is_driven:
            shifts = [tuple(map(sum, zip(*shifts, strict=True)))] * len(shifts)
        left = [
            change - along / square * slope
            for change, slope, (along, square) in zip(changes, slopes, shifts, strict=True)
        ]
        total, beyond_zeta = (
            _rms([each / scale for each in values], self.floors) for values in (changes, left)
        )
        return EffectSize(total, beyond_zeta, dict(self.floors))

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
            distance = abs(np.log(max(size.floors, settings.min_floors) / target))
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


def _rms(changes: Sequence[np.ndarray], floors: Mapping[str, float]) -> dict[str, float]:
    """RMS of changes by channel, in their units."""

    def rms(row: int) -> float:
        joined = np.concatenate([each[row] for each in changes])
        return float(np.sqrt(np.mean(joined**2)))

    return {name: rms(row) for row, name in enumerate(floors)}
