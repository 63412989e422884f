"""How much of a mechanism shows: what is left of it once every run's zeta is fitted again."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.blind.generation.random_mechanisms import Mechanism
from diagnose.blind.plant import plant
from diagnose.blind.plant.plant import Part
from diagnose.blind.plant.run_plan import PlannedRun
from diagnose.blind.plant.sensors import PlantReading
from drftjax.common.errors import InputError

# What noise and the scatter of zeta leave in a channel [m].
FLOORS = {"x": 8e-5, "z": 3e-5}


NUDGE = 0.01


# Differences of runs need no fine steps: these are twice as long as a fit's, within reason [s].
PROBE_FINER, LONGEST_STEP = 0.5, 2e-3


ATTEMPTS = 6


def _in_floors(reading: PlantReading) -> np.ndarray:
    return np.stack([getattr(reading, name) / floor for name, floor in FLOORS.items()])


def _run(
    parts: Sequence[Part], profile: PlannedRun, zeta: float, groups: tuple[str, ...]
) -> PlantReading:
    finer = max(PROBE_FINER, profile.steady_step() / LONGEST_STEP)
    return plant.run_plant(parts, profile, zeta, groups, finer)


@dataclass(frozen=True)
class EffectSize:
    """Root mean squares over the runs.

    Attributes:
        x, z: All that a mechanism changes [m], at the same zeta.
        x_left, z_left: What of it a zeta fitted to each run leaves [m].
    """

    x: float
    z: float
    x_left: float
    z_left: float

    @property
    def floors(self) -> float:
        """What is left, in floors, in the channel that shows more of it."""
        return max(self.x_left / FLOORS["x"], self.z_left / FLOORS["z"])


@dataclass(frozen=True)
class EffectSizeProbe:
    """A few runs of a plant with nothing wrong, and how zeta changes them.

    Attributes:
        profiles, zeta: The runs.
        groups: Groups of effects that their program holds, all at strength zero.
        sound: Their channels in floors.
        slope: The derivative of these by log zeta.
    """

    profiles: tuple[PlannedRun, ...]
    zeta: float
    groups: tuple[str, ...]
    all_finite: tuple[np.ndarray, ...]
    slope: tuple[np.ndarray, ...]

    @classmethod
    def of(
        cls, profiles: Sequence[PlannedRun], zeta: float, groups: tuple[str, ...]
    ) -> "EffectSizeProbe":
        def channels(factor: float) -> tuple[np.ndarray, ...]:
            runs = (_run((), each, factor * zeta, groups) for each in profiles)
            return tuple(_in_floors(each) for each in runs)

        sound, nudged = channels(1.0), channels(1 + NUDGE)
        slope = tuple((b - a) / NUDGE for a, b in zip(sound, nudged, strict=True))
        return cls(tuple(profiles), zeta, groups, sound, slope)

    def gap(self, parts: Sequence[Part]) -> EffectSize:
        """How much `parts` show in these runs.

        Raises:
            InputError: where the plant cannot run with them.
        """
        whole, left = [], []
        for profile, sound, slope in zip(self.profiles, self.all_finite, self.slope, strict=True):
            run = _run(parts, profile, self.zeta, self.groups)
            change = _in_floors(run) - sound
            refit = float((slope * change).sum() / (slope**2).sum())
            whole.append(change)
            left.append(change - refit * slope)

        def size(changes: list[np.ndarray], row: int, name: str) -> float:
            joined = np.concatenate([each[row] for each in changes])
            return float(np.sqrt(np.mean(joined**2))) * FLOORS[name]

        names = list(FLOORS)
        return EffectSize(
            **{name: size(whole, names.index(name), name) for name in names},
            **{f"{name}_left": size(left, names.index(name), name) for name in names},
        )

    def strength(self, mechanism: Mechanism, target: float) -> tuple[float, EffectSize]:
        """The strength at which a mechanism shows by about `target` floors, if a rig may have it.

        Returns:
            That strength, and the gap that it gives.

        Raises:
            InputError: where no strength lets the plant run.
        """
        size, best = min(mechanism.typical, mechanism.most), None
        for _ in range(ATTEMPTS):
            try:
                gap = self.gap([mechanism.build(size)])
            except InputError:
                size /= 3
                continue
            if best is None or abs(np.log(gap.floors / target)) < abs(
                np.log(best[1].floors / target)
            ):
                best = size, gap
            ratio = target / max(gap.floors, 1e-3)
            following = float(np.clip(size * np.clip(ratio, 0.02, 20), 0, mechanism.most))
            if 0.75 < ratio < 1.33 or abs(following / size - 1) < 0.05:
                break
            size = following
        if best is None:
            raise InputError(f"the plant runs at no strength of {mechanism.kind}")
        return best
