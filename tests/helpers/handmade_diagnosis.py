"""A diagnosis made by hand: what a report shows, without the minutes that finding it takes."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from diagnose.gap.budget import BudgetShare, ChannelBudget
from diagnose.gap.gap import Gap
from diagnose.gap.selected_effects import SelectedEffects
from diagnose.gap.zeta_matching import MatchedRun
from diagnose.linear.bed import PreparedBed
from diagnose.localization.shares import GapShare
from diagnose.result import Diagnosis, ParameterEstimate
from drftjax.setups.setup import read_setup

CHANNELS = ("x", "z")
FLOORS = {"x": 2e-4, "z": 4e-5}
BEFORE, AFTER = {"x": 9e-3, "z": 1.1e-3}, {"x": 4e-4, "z": 6e-5}


def handmade_diagnosis(names: list[str], samples: int = 1200, found: bool = True) -> Diagnosis:
    """Diagnosis of runs with these names, whose friction and slope are told, or nothing.

    Args:
        names: Of the runs.
        samples: Of each run.
        found: False for the verdict none.
    """
    random = np.random.default_rng(3)
    time = np.linspace(0.0, 24.0, samples)
    recorded, before, after = [], [], []
    for number in range(len(names)):
        travel = 0.012 * (1 + 0.2 * number) * np.maximum(time - 1, 0)
        z = -0.014 - 0.003 * np.tanh(time / 4) - 4e-4 * np.sin((2 + 0.3 * number) * time)
        recorded.append(np.array([travel, z]))
        noise = random.standard_normal((2, samples)) * [[1e-4], [3e-5]]
        shape = np.array([0.015 * time / 24, 1.8e-3 * (time / 24 - 0.5)])
        before.append(shape + noise)
        after.append(0.03 * shape + noise)
    setup = read_setup("data/paper.toml")
    runs = [SimpleNamespace(name=name, setup=setup) for name in names]
    dataset: Any = SimpleNamespace(
        runs=runs,
        channels=CHANNELS,
        time=lambda run: time,
        logged_time=lambda run: time,
        recording=lambda run: recorded[run],
        sample_interval=lambda run: float(time[1]),
    )
    gap = {c: Gap(BEFORE[c], AFTER[c], FLOORS[c], 0.96, (0.93, 0.98)) for c in CHANNELS}
    effects = ("horizontal_coulomb", "surface_slope")
    budget = {}
    for channel in CHANNELS:
        excess = BEFORE[channel] - FLOORS[channel]
        parts = {
            name: BudgetShare(share, (share - 0.04, share + 0.03), share * excess)
            for name, share in zip(effects, (0.7, 0.24), strict=True)
        }
        budget[channel] = ChannelBudget(
            BEFORE[channel], AFTER[channel], FLOORS[channel], parts, 0.06
        )
    regressors = SimpleNamespace(
        dataset=dataset, settings=SimpleNamespace(bed=PreparedBed()), variants=[]
    )
    matches = [MatchedRun(each, 0.0, True) for each in after]
    chosen: Any = SimpleNamespace(names=effects)
    screening: Any = SimpleNamespace(regressors=regressors)
    added: Any = tuple(SimpleNamespace() for _ in effects) if found else ()
    selected = SelectedEffects(added, np.zeros(len(names)), matches, gap)
    return Diagnosis(
        verdict=effects if found else ("none",),
        weights={effects[0]: 0.97, effects[1]: 0.95, "none": 0.01} if found else {"none": 0.9},
        groups=[[effects[0], "drawbar"]] if found else [],
        selected=selected,
        parameters={
            effects[0]: {"force": ParameterEstimate(4.0, 0.1, "N")},
            effects[1]: {"slope": ParameterEstimate(0.01, 0.001, "-")},
        }
        if found
        else {},
        notes=["the runs' lambda was taken as 1.1"],
        next_run={},
        screening=screening,
        chosen=chosen,
        residual_before=before,
        floors=FLOORS,
        localization=[
            GapShare("phase", "steady", 0.8, (0.7, 0.9), 0.7),
            GapShare("phase", "start", 0.2, (0.1, 0.3), 0.3),
            GapShare("channel", "x", 0.9, (0.8, 1.0)),
            GapShare("channel", "z", 0.1, (0.0, 0.2)),
        ],
        budget=budget if found else {},
    )
