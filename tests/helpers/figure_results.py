"""Every figure of the project, from results that are made by hand: nothing is simulated."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from diagnose.change import figures as change_figures
from diagnose.evaluation.figure import evaluation_figure
from diagnose.evaluation.result import Evaluation
from diagnose.gap.zeta_matching import MatchedRun
from diagnose.localization.shares import GapShare
from diagnose.report import figures as report_figures
from drftjax.effects.catalogue import effect_class
from drftjax.runlog.figure import plot_run
from drftjax.simulation import effect_gallery
from drftjax.sweeps.figures import slip_figure, sweep_figure
from drftjax.sweeps.parameter_sweep import ParameterSweep
from drftjax.sweeps.steady_state import SteadyState
from hils.experiment.figures import ripple_figure, runs_figure, trajectory_figure
from hils.run_figure import plot_hils
from identify.crosscheck.figure import plot_crosscheck
from identify.design.figures import plot_design, plot_screening
from identify.results.figure import plot_fit
from identify.results.values import RunFit
from tests.helpers.run_logs import example_run

TIME = np.linspace(0.0, 20.0, 401)
RAMP = np.clip(TIME / 20, 0, 1)
HEIGHT = -0.018 - 0.006 * RAMP - 2e-4 * np.sin(4 * TIME)  # z of a wheel that sinks [m]
TRAVEL = 0.06 * TIME
FLOORS = {"x": 1e-3, "z": 2e-5}
CHANNELS = ("x", "z")
RECORDED = np.stack([TRAVEL, HEIGHT])
BEFORE = np.stack([1.03 * TRAVEL, HEIGHT + 1e-3 * RAMP])
AFTER = np.stack([1.002 * TRAVEL, HEIGHT + 5e-5 * np.sin(TIME)])


def loose(**values: Any) -> Any:
    """An object with these attributes, in the place of a result."""
    return SimpleNamespace(**values)


def all_figures(monkeypatch: pytest.MonkeyPatch) -> dict[str, Figure]:
    """Every figure by the name of its function."""
    run = example_run()
    dataset = loose(
        channels=CHANNELS,
        runs=[loose(name="slow_a"), loose(name="fast")],
        logged_time=lambda run: TIME,
        recording=lambda run: RECORDED,
    )
    return {
        "plot_run": plot_run(run),
        "plot_hils": plot_hils(run),
        **sweeps(),
        **effects(monkeypatch),
        **experiments(),
        **fits(),
        **diagnoses(monkeypatch, dataset),
    }


def sweeps() -> dict[str, Figure]:
    sinkage = -HEIGHT * np.array([[1.0], [1.2], [1.5]])
    swept = ParameterSweep(
        loose(title="a sweep"),
        {"zeta": np.array([0.6, 0.7, 0.8])},
        TIME,
        {"sinkage": sinkage, "x": TRAVEL * np.array([[1.0], [0.9], [0.8]])},
        1e-3,
    )
    slip = np.linspace(-0.2, 0.8, 6)
    names = [each.name for each in dataclasses.fields(SteadyState)]
    values = dict.fromkeys(names[:-3], 10 * slip) | {"slip": slip, "sinkage": 0.02 + 0.01 * slip}
    steady = SteadyState(**values, is_steady=slip < 0.5, omega=0.5, title="a slip curve")
    return {"sweep_figure": sweep_figure(swept), "slip_figure": slip_figure(steady)}


def effects(monkeypatch: pytest.MonkeyPatch) -> dict[str, Figure]:
    shown = [effect_class(name) for name in ("loosening", "speed_gain", "sinkage_offset")]

    def simulated(effects: list) -> Any:
        count = 1 + len(effects)
        scale = np.arange(count)[:, None]
        return loose(
            time=np.tile(TIME, (count, 1)),
            z=HEIGHT - 1e-3 * RAMP * scale,
            x=TRAVEL + 2e-3 * RAMP * scale,
        )

    monkeypatch.setattr(effect_gallery, "simulate_effects", simulated)
    return {
        "draw_effect": effect_gallery.draw_effect(shown[0]),
        "draw_effect_of_most_numbers": effect_gallery.draw_effect(effect_class("terrain_waves")),
        "draw_gallery": effect_gallery.draw_gallery(shown),
    }


def experiments() -> dict[str, Figure]:
    def path(z: np.ndarray) -> Any:
        return loose(x=TRAVEL, z=z)

    hils = [
        loose(measured=path(HEIGHT), simulated=path(AFTER[1]), error=AFTER[1] - HEIGHT, zeta=RAMP)
    ]
    paths = {"HILS (sim)": AFTER[1], "HILS (real)": HEIGHT, "DRFT": BEFORE[1], "free": HEIGHT}
    frequency = np.linspace(0.1, 6, 60)
    amplitudes = {"z, HILS (sim)": 1e-5, "z, HILS (real)": 2e-5, "z, sim - real": 5e-6, "zeta": 0.1}
    tuner = loose(build=lambda tick: loose(tolerance=1e-4))
    result: Any = loose(
        time=TIME,
        hils=hils,
        free=[loose(measured=path(HEIGHT)), loose(measured=path(HEIGHT - 2e-4))],
        experiment=loose(
            loop=loose(tuner=tuner, tick=0.01), rig=loose(wheel=loose(grouser_count=12))
        ),
        means=lambda: {name: path(z) for name, z in paths.items()},
        distances=lambda: {"DRFT": loose(plane=1e-3)},
        steady_stretch=lambda: (slice(None), 0.5),
        spectra=lambda: {
            name: loose(frequency=frequency, amplitude=size / frequency)
            for name, size in amplitudes.items()
        },
    )
    return {
        "runs_figure": runs_figure(result),
        "trajectory_figure": trajectory_figure(result),
        "ripple_figure": ripple_figure(result),
    }


def fits() -> dict[str, Figure]:
    every = np.ones(TIME.size, bool)
    setup: Any = None
    fitted = [
        RunFit(name, setup, {}, TIME, every, CHANNELS, RECORDED, BEFORE, AFTER, "converged")
        for name in ("slow_a", "fast")
    ]
    band = {"fast": {"z": (HEIGHT - 1e-4, HEIGHT + 1e-4)}}
    knots = np.linspace(0, 20, 11)
    zeta = 0.8 - 0.1 * RAMP
    offline = loose(
        time=knots,
        value=np.interp(knots, TIME, zeta),
        error=np.full(11, 0.01),
        identified=np.ones(11, bool),
        at=lambda time: np.interp(time, TIME, zeta),
    )
    checked = loose(
        name="slow_a",
        offline=offline,
        time=TIME,
        zeta=zeta + 0.01 * np.sin(TIME),
        error=2e-4 * np.sin(TIME),
        tuner=loose(lag=0.4, difference=0.01),
        online_time=TIME,
        online_zeta=zeta,
        truth=zeta,
    )
    setting = loose(tick=0.01, zeta_step=1e-3, tolerance=1e-4)

    def option(error: float, peak: float) -> Any:
        command = loose(time=np.array([0.0, 2, 8, 10]), omega=peak * np.array([0, 1, 1, 0]))
        setup = loose(command=loose(build=lambda: command))
        return loose(setup=setup, information=loose(error=error, value=1.0))

    designed: Any = loose(
        given=option(0.5, 0.5), best=option(0.1, 2.0), parameter="lambda", unit="-", wanted=0.1,
        peaks=np.radians([30.0, 100.0, 300.0]), scan=[option(1 / each, each) for each in (1, 3, 9)],
        model_error=5e-5, shift=lambda each: 0.3 * each.information.error,
    )  # fmt: skip
    numbers = [
        loose(quantity=loose(label=name, unit="-"), low=0.0, high=high)
        for name, high in (("zeta", 1.0), ("lambda", 2.0), ("loosening.loss", 0.1))
    ]
    sizes = np.array([[30.0, 300.0], [2.0, 0.1], [0.02, 0.5]])
    screened: Any = loose(
        ranges=numbers, channels=CHANNELS, noise=FLOORS, order=[0, 1, 2], title="a rig",
        effects=loose(mean_size=sizes, interval=0.2 * sizes, spread=0.5 * sizes),
    )  # fmt: skip
    check: Any = loose(runs=[checked], setting=setting)
    return {
        "plot_fit": plot_fit(fitted, CHANNELS, [], band, FLOORS),
        "plot_crosscheck": plot_crosscheck(check),
        "plot_design": plot_design(designed),
        "plot_screening": plot_screening(screened),
    }


def diagnoses(monkeypatch: pytest.MonkeyPatch, dataset: Any) -> dict[str, Figure]:
    residuals = [BEFORE - RECORDED] * 2, [AFTER - RECORDED] * 2
    gap = {"x": loose(before=0.02, after=1.2e-3, floor=1e-3)} | {
        "z": loose(before=6e-4, after=4e-5, floor=2e-5)
    }
    budget = {
        channel: loose(
            before=each.before,
            floor=each.floor,
            remainder=0.1,
            effects={
                name: loose(size=share * (each.before - each.floor))
                for name, share in (("speed_gain", 0.6), ("loosening", 0.3))
            },
        )
        for channel, each in gap.items()
    }
    shares = [
        GapShare("phase", "speeding up", 0.7, (0.5, 0.8)),
        GapShare("profile", "the trend", 0.3, (0.2, 0.6)),
        GapShare("channel", "z", 0.6, (0.5, 0.7)),
    ]
    found: Any = loose(
        dataset=dataset, gap=gap, budget=budget, localization=shares, floors=FLOORS, verdict=("a",),
        selected=loose(effects=("an effect",), after=residuals[1]), correction=None,
        residual_before=residuals[0], weights={"a": 0.9, "b": 0.1}, group_of=lambda name: [name],
    )  # fmt: skip
    disturbance = loose(name="zeta", unit="-", signal=[RAMP, RAMP], error=[0.01 + 0 * RAMP] * 2)
    dependence = [("sinkage", 0.9), ("travel", 0.4), ("time", 0.2)]
    unknown: Any = loose(disturbance=disturbance, dependence=dependence)
    monkeypatch.setattr(report_figures, "signal_against", lambda *_: [(-HEIGHT, RAMP)] * 2)
    monkeypatch.setattr(
        change_figures, "mean_of", lambda differences, clock, runs, values: values[runs[0]]
    )
    clock = loose(time=TIME, condition=loose(now=[1], before=[0]))
    problem = loose(
        differences=loose(dataset=dataset, clocks=[clock]),
        residual_without=lambda side: [0 * RECORDED, BEFORE - RECORDED],
        residual_by_law=lambda here: here.residual,
    )
    changed: Any = loose(problem=problem, chosen=loose(residual=[0 * RECORDED, AFTER - RECORDED]))
    before, after = ([MatchedRun(each, 0.0, True) for each in those] for those in residuals)
    gain: Any = loose(about=loose(name="speed_gain"))
    evaluated = Evaluation(dataset, (gain,), before, after, {}, FLOORS, "")
    return {
        "at_a_glance": report_figures.at_a_glance(found),
        "weights": report_figures.weights(found),
        "residuals": report_figures.residuals(found),
        "unknown_signal": report_figures.unknown_signal(found, unknown),
        "difference_figure": change_figures.difference_figure(changed),
        "evaluation_figure": evaluation_figure(evaluated),
    }
