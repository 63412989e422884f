"""What ripple eq. 7 can make, and what the grousers can.

    python -m tests.studies.ripple [-o docs/figures/hils_ripple.png]

Prints the tables of `docs/results/hils-paper.md` on the ripple and draws its figure,
in some minutes.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drftjax.common.jax_config import configure_jax
from hils.experiment.spectrum import order, spectrum
from tests.studies.closed_loop import INTERVAL, LOSS, SPEED, ZETA, Setting, Traces, run

DURATION, SETTLED = 60.0, 15.0
TICKS = (0.001, 0.002, 0.005, 0.01, 0.02)
TOLERANCES = (0.0, 2e-5, 5e-5, 1e-4, 2e-4)
DAMPINGS = [(0.0, 0.0), (10.0, 0.0), (100.0, 0.0), (0.0, 300.0), (0.0, 1e3), (0.0, 3e3), (0.0, 1e4)]
AHEAD = (0.0, 5.0, 10.0, 15.0)
# Wheels that are let go this much too high start with a swing [m].
DROPPED = 2e-3
SPEEDS = (15.0, 20.0, 30.0, 45.0, 60.0)
NOISES = (0.0, 5e-6, 2e-5, 5e-5, 1e-4, 2e-4)
PLATES = (8e-3, 4e-3, 2e-3, 1e-3, 5e-4)
# Ticks and dead bands at which the tuner ripples, each tried with so many readings' noises.
RIPPLING = ((0.002, 0.0), (0.005, 0.0), (0.005, 2e-5), (0.01, 0.0), (0.01, 2e-5), (0.02, 0.0))
# With the paper's dead band: ticks and noises of the readings.
NOISY = ((0.001, 1e-4), (0.002, 5e-5), (0.002, 1e-4), (0.002, 2e-4), (0.005, 1e-4), (0.01, 1e-4))
REPEATS = 6
NOISE_COLUMNS = ((10, 0), (10, 0.1), (2, 0.1))
PLATE_SETTINGS = [Setting(tick=t, tolerance=0.0) for t in (0.002, 0.005, 0.01)]
# A loop whose tuner rings, to see what damping and speed do to it.
RINGING = Setting(tick=0.002, tolerance=0.0)
MM, UM = 1e3, 1e6
PAPER, NEAR = 1.68, 0.05
# Amplitudes of the error under this are no ripple [m].
FAINT = 5e-6


class Found(NamedTuple):
    """The strongest line of z, sim - real, and what else shows at its frequency.

    Attributes:
        frequency: [Hz].
        error, sim, real: Amplitude in z, sim - real; z, sim; z, real [m].
        zeta: Amplitude in zeta [-].
        rmse: Of z, sim - real, all frequencies [m].
    """

    frequency: float
    error: float
    sim: float
    real: float
    zeta: float
    rmse: float

    @property
    def text(self) -> str:
        """Frequency and amplitude of the error."""
        if self.error < FAINT:
            return "-"
        return f"{self.frequency:.2f} Hz, {UM * self.error:.0f} µm"


def found(traces: Traces) -> list[Found]:
    """Of every setting, once it has settled."""
    made = []
    for sim, real, zeta in zip(*traces.steady(SETTLED), strict=True):
        error = spectrum(sim - real, INTERVAL)
        lines = error.lines(1)
        at = lines[0].frequency if lines else 1.0
        others = [spectrum(values, INTERVAL).at(at) for values in (sim, real, zeta)]
        amplitude = lines[0].amplitude if lines else 0.0
        made.append(Found(at, amplitude, *others, float(np.sqrt(np.mean((sim - real) ** 2)))))
    return made


def tried(groups: dict[str, list[Setting]], **options: Any) -> dict[str, list[Found]]:
    """Groups of settings, run all together: they share one compiled program."""
    flat = [setting for group in groups.values() for setting in group]
    # A setting's noise hangs on its place in its own table alone.
    seeds = [place for group in groups.values() for place in range(len(group))]
    left = iter(found(run(flat, DURATION, seeds=seeds, **options)))
    return {name: [next(left) for _ in group] for name, group in groups.items()}


def groups() -> dict[str, list[Setting]]:
    """What is tried, by table."""
    base = Setting()
    return {
        "grid": [Setting(tick=t, tolerance=d) for t in TICKS for d in TOLERANCES],
        "damping": [RINGING._replace(damping_x=x, damping_z=z) for x, z in DAMPINGS],
        "quiet damping": [base._replace(damping_x=x, damping_z=z) for x, z in DAMPINGS],
        "ahead": [
            Setting(tick=tick, angle=float(np.radians(degrees)), dropped=dropped)
            for degrees in AHEAD
            for tick in (0.002, 0.01)
            for dropped in (0.0, DROPPED)
        ],
        "speed": [RINGING._replace(omega=float(np.radians(speed))) for speed in SPEEDS],
        "repeats": [Setting(t, tolerance=d) for t, d in RIPPLING for _ in range(REPEATS)],
        "noise": [
            Setting(tick=t, tolerance=d, noise=noise)
            for noise in NOISES
            for t, d in ((0.01, 0.0), (0.01, 1e-4), (0.002, 1e-4))
        ],
        "noisy": [Setting(tick=t, noise=noise) for t, noise in NOISY for _ in range(REPEATS)],
        "zeta step": [base._replace(zeta_step=step) for step in (2e-3, 5e-3, 1e-2, 2e-2)],
    }


# The loop made linear -----------------------------------------------------------------------------


class Linear(NamedTuple):
    """A bare rim that rolls steadily, made linear in z, vx and vz.

    Attributes:
        gain: Sinkage in the end by zeta [m].
        time: In which it gets there: the slow mode [s].
        next: Time constant of the mode after that [s].
        resistance: Of the sand against the wheel's rising and sinking [N s/m].
    """

    gain: float
    time: float
    next: float
    resistance: float

    def frequency(self, setting: Setting, spread: float) -> float:
        """At which the tuner goes round, while the loop is two integrators in a row [Hz].

        Args:
            setting: The tuner.
            spread: Standard deviation of the error that it sees, noise and all [m].

        zeta integrates what the relay gives and the sinkage integrates zeta, so long as a cycle is
        short beside `time` and long beside `next`. An error that is spread normally makes of the
        relay with its dead band d a gain, slew sqrt(2 / pi) / spread exp(-(d / spread)^2 / 2).
        """
        slew = setting.zeta_step / setting.tick
        relay = slew * np.sqrt(2 / np.pi) / spread
        relay *= np.exp(-((setting.tolerance / spread) ** 2) / 2)
        return float(np.sqrt(relay * self.gain / self.time) / (2 * np.pi))


def linear(zeta: float = ZETA * (1 - LOSS), omega: float = SPEED) -> Linear:
    """The loop's simulation at its steady rolling, bare rim, plates so fine that none is seen."""
    import jax
    import jax.numpy as jnp

    from drftjax.physics.command import Command
    from drftjax.physics.state import State
    from drftjax.physics.terrain import ConstantZeta, Terrain
    from drftjax.physics.wheel import PlainWheel
    from drftjax.simulation.simulator import Simulator

    wheel = PlainWheel(plate_size=2e-4)
    simulator = Simulator(wheel, Terrain(ConstantZeta(zeta))).prepared()
    nought = jnp.zeros(())

    def step(state, number):
        turning = omega * jnp.clip(5e-4 * (number + 1).astype(float), 0.0, 1.0)
        return simulator.step(state, Command(turning, nought, nought), 1e-3)[0], None

    state = jax.jit(lambda start: jax.lax.scan(step, start, jnp.arange(15000))[0])(
        State.at_rest(0.03)
    )

    @jax.jit
    def force(given):
        z, vx, vz, zeta = given
        place, velocity = jnp.stack([nought, z]), jnp.stack([vx, vz])
        return simulator.wrench(place, velocity, state.angle, jnp.asarray(omega), zeta)[:2]

    # Secants: plates pass the edge of the leading part one by one, which no derivative sees.
    middle = np.array([state.position[1], *state.velocity, zeta])
    slopes = [
        (np.asarray(force(middle + width)) - np.asarray(force(middle - width))) / (2 * width.max())
        for width in np.diag([1e-4, 1e-3, 1e-3, 1e-3])
    ]
    by_state, by_zeta = np.array(slopes[:3]).T, slopes[3]
    mass = np.asarray(simulator.rig.mass())
    system = np.vstack([[0.0, 0.0, 1.0], by_state / mass[:, None]])
    lasting = np.linalg.solve(-system, np.r_[0.0, by_zeta / mass])[0]
    slowest, following = np.sort(-np.linalg.eigvals(system).real)[:2]
    return Linear(float(lasting), float(1 / slowest), float(1 / following), -float(by_state[1, 2]))


# The whole loop -----------------------------------------------------------------------------------


# Tick [s], dead band [m], grousers apart [deg], noise of the readings [m].
WHOLE = (
    (0.01, 1e-4, 0.0, 2e-5),
    (0.012, 0.0, 0.0, 2e-5),
    (0.011, 0.0, 0.0, 2e-5),
    (0.01, 0.0, 0.0, 2e-5),
    (0.005, 0.0, 0.0, 2e-5),
    (0.002, 0.0, 0.0, 2e-5),
    (0.002, 1e-4, 0.0, 1e-4),
    (0.002, 1e-4, 0.0, 2e-4),
    (0.01, 1e-4, 15.0, 2e-5),
    (0.002, 1e-4, 15.0, 2e-5),
)


def whole() -> list[tuple[str, ...]]:
    """Some settings in the loop itself: link, clock, guard, counts, and the paper's profile."""
    import msgspec

    from drftjax.common.packages import data_file
    from drftjax.setups.setup import read_setup
    from drftjax.tuning.registry import TunerSetUp
    from hils.control.limits import CommandLimits
    from hils.control.loop_config import LoopSetUp
    from hils.experiment.experiment import Experiment, loosening_rig, run_experiment

    rows = []
    for tick, tolerance, degrees, noise in WHOLE:
        setup = read_setup(data_file("paper.toml"))
        # The simulated wheel starts behind the real one.
        setup.start = msgspec.structs.replace(setup.start, angle=float(np.radians(-degrees)))
        tuner = TunerSetUp("step", {"tolerance": tolerance})
        commands = CommandLimits(2.0, 0.3)
        loop = LoopSetUp(setup=setup, commands=commands, tuner=tuner, tick=tick)
        rig = loosening_rig()
        rig.instruments = msgspec.structs.replace(rig.instruments, z_noise=noise)
        result = run_experiment(Experiment(loop=loop, rig=rig, runs=3))
        rmse = ", ".join(f"{MM * each.rmse:.2f}" for each in result.hils)
        spectra = result.spectra()
        lines = [
            f"{line.frequency:.2f} Hz, {UM * line.amplitude:.0f} µm"
            for name in ("z, sim - real", "z, HILS (real)")
            for line in spectra[name].lines(1)
        ]
        given = (f"{MM * tick:g}", f"{MM * tolerance:g}", f"{degrees:g}", f"{MM * noise:g}")
        rows.append((*given, rmse, *lines))
    return rows


# Tables -------------------------------------------------------------------------------------------


def show(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from hils.experiment.report import markdown_table

    print(f"\n{title}\n\n{markdown_table(head, rows)}", flush=True)


def plate_rows() -> list[list[str]]:
    rows = []
    for plate in PLATES:
        each = [
            found(run(PLATE_SETTINGS, DURATION, grousers, plate=plate))
            for grousers in (True, False)
        ]
        cells = [f"{one.text} / {other.text}" for one, other in zip(*each, strict=True)]
        rows.append([f"{MM * plate:g}", *cells])
    return rows


def grid_rows(each: list[Found]) -> list[list[str]]:
    width = len(TOLERANCES)
    return [
        [f"{MM * tick:g}", *(one.text for one in each[place * width : (place + 1) * width])]
        for place, tick in enumerate(TICKS)
    ]


def repeat_rows(settings: list[Setting], each: list[Found], model: Linear) -> list[list[str]]:
    rows = []
    for place in range(0, len(settings), REPEATS):
        setting, some = settings[place], each[place : place + REPEATS]
        frequencies = np.array([one.frequency for one in some])
        rmse = float(np.mean([one.rmse for one in some]))
        rows.append(
            [
                f"{MM * setting.tick:g}",
                f"{MM * setting.tolerance:g}",
                f"{MM * setting.noise:g}",
                f"{frequencies.min():.2f} - {frequencies.max():.2f}",
                f"{np.median(frequencies):.2f}",
                f"{np.sum(np.abs(frequencies - PAPER) <= NEAR)} of {REPEATS}",
                f"{model.frequency(setting, float(np.hypot(rmse, setting.noise))):.2f}",
                f"{UM * np.mean([one.sim for one in some]):.0f} µm",
                f"{UM * np.mean([one.real for one in some]):.0f} µm",
                f"{MM * rmse:.3f}",
            ]
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", type=Path, default=Path("out/hils_ripple.png"))
    output = parser.parse_args().o
    configure_jax()

    tables = groups()
    full = tried(tables, grousers=True)
    bare = tried(
        {name: tables[name] for name in ("grid", "repeats", "damping", "speed", "zeta step")},
        grousers=False,
    )
    mixed = tried(
        {"tick": [Setting(tick=0.002), Setting(tick=0.01)]}, grousers=True, simulated_grousers=False
    )

    head = ["tick, ms", *(f"dead band {MM * each:g} mm" for each in TOLERANCES)]
    show("strongest line of z, sim - real; grousers", head, grid_rows(full["grid"]))
    show("the same, bare rim", head, grid_rows(bare["grid"]))
    model = linear()
    print(
        f"\nbare rim made linear: {MM * model.gain:.1f} mm by zeta in {model.time:.2f} s, "
        f"the next mode {MM * model.next:.0f} ms, resistance {model.resistance:.0f} N s/m"
    )
    columns = (
        *("tick, ms", "dead band, mm", "noise, mm", "strongest line, Hz", "median"),
        *(f"at {PAPER} Hz", "estimate", "in z, sim", "in z, real", "RMSE, mm"),
    )
    for name, kind, made in (
        ("repeats", "grousers", full),
        ("repeats", "bare rim", bare),
        ("noisy", "grousers, the paper's dead band", full),
    ):
        rows = repeat_rows(tables[name], made[name], model)
        show(f"{REPEATS} runs each, other noise: {kind}", columns, rows)
    show(
        "noise of the readings, grousers",
        ("noise, mm", *(f"tick {tick} ms, dead band {band} mm" for tick, band in NOISE_COLUMNS)),
        [
            [f"{MM * noise:g}", *(one.text for one in full["noise"][3 * place : 3 * place + 3])]
            for place, noise in enumerate(NOISES)
        ],
    )
    show(
        "plates of the simulation, grousers / bare rim",
        ("plate, mm", *(f"tick {MM * s.tick:g} ms, no dead band" for s in PLATE_SETTINGS)),
        plate_rows(),
    )
    show(
        "zeta step, tick 10 ms, dead band 0.1 mm",
        ("zeta step", "grousers", "bare rim"),
        [
            (f"{setting.zeta_step:g}", one.text, other.text)
            for setting, one, other in zip(
                tables["zeta step"], full["zeta step"], bare["zeta step"], strict=True
            )
        ],
    )
    show(
        "damping of the simulated rig; ringing: tick 2 ms, no dead band; quiet: 10 ms, 0.1 mm",
        ("c_x", "c_z", "grousers, ringing", "bare rim, ringing", "grousers, quiet", "RMSE, mm"),
        [
            (f"{x:g}", f"{z:g}", one.text, other.text, quiet.text, f"{MM * quiet.rmse:.3f}")
            for (x, z), one, other, quiet in zip(
                DAMPINGS, full["damping"], bare["damping"], full["quiet damping"], strict=True
            )
        ],
    )
    show(
        "real grousers ahead of the simulated ones, dead band 0.1 mm",
        (
            "apart, deg",
            "tick, ms",
            "dropped, mm",
            "line",
            "in z, sim",
            "in z, real",
            "in zeta",
            "RMSE, mm",
        ),
        [
            (
                f"{np.degrees(setting.angle):g}",
                f"{MM * setting.tick:g}",
                f"{MM * setting.dropped:g}",
                one.text,
                f"{UM * one.sim:.0f} µm",
                f"{UM * one.real:.0f} µm",
                f"{one.zeta:.4f}",
                f"{MM * one.rmse:.3f}",
            )
            for setting, one in zip(tables["ahead"], full["ahead"], strict=True)
        ],
    )
    show(
        "real wheel with grousers, simulated without; dead band 0.1 mm",
        ("tick, ms", "line", "in zeta", "RMSE, mm"),
        [
            (tick, one.text, f"{one.zeta:.4f}", f"{MM * one.rmse:.3f}")
            for tick, one in zip(("2", "10"), mixed["tick"], strict=True)
        ],
    )
    show(
        "wheel speed, tick 2 ms, no dead band",
        ("deg/s", "grousers pass, Hz", "grousers", "order", "in z, sim", "in z, real", "bare rim"),
        [
            (
                f"{speed:g}",
                f"{speed / 30:.2f}",
                one.text,
                f"{order(one.frequency, np.radians(speed)):.1f}",
                f"{UM * one.sim:.0f} µm",
                f"{UM * one.real:.0f} µm",
                other.text,
            )
            for speed, one, other in zip(SPEEDS, full["speed"], bare["speed"], strict=True)
        ],
    )
    columns = ("tick, ms", "dead band, mm", "apart, deg", "noise, mm", "RMSE of z, mm")
    show(
        "the whole loop on the paper's profile, three runs",
        (*columns, "sim - real", "HILS (real)"),
        whole(),
    )
    draw(output, full["speed"], bare["speed"])
    print(f"\nwritten: {output}")


def draw(output: Path, full: list[Found], bare: list[Found]) -> None:
    """Spectra of four loops, and the tuner's own frequency by the wheel's speed."""
    from matplotlib.figure import Figure

    from drftjax.common.figures import save_figure

    kinds = {
        "tick 10 ms, 0.1 mm": Setting(),
        "tick 10 ms, 0.1 mm, grousers 15 deg apart": Setting(angle=float(np.radians(15.0))),
        "tick 5 ms, no dead band": Setting(tick=0.005, tolerance=0.0),
        "tick 2 ms, no dead band": RINGING,
    }
    traces = run(list(kinds.values()), DURATION).steady(SETTLED)
    figure = Figure(figsize=(9.5, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, values in zip(kinds, traces.z_sim - traces.z_real, strict=True):
        made = spectrum(values, INTERVAL)
        shown = (made.frequency > 0.1) & (made.frequency <= 4.0)
        left.plot(made.frequency[shown], UM * made.amplitude[shown], lw=0.9, label=name)
    left.axvline(PAPER, color="k", lw=0.8, ls="--", label=f"{PAPER} Hz")
    left.axvline(1.0, color="0.5", lw=0.8, ls=":", label="grousers")
    left.set_yscale("log")
    left.set_ylim(0.1, 1000)
    left.set_xlabel("frequency [Hz]")
    left.set_ylabel("amplitude of z, sim - real [µm]")
    left.legend(fontsize=7)
    right.plot(SPEEDS, [one.frequency for one in full], "o", label="with grousers")
    right.plot(SPEEDS, [one.frequency for one in bare], "s", mfc="none", label="bare rim")
    right.plot(SPEEDS, np.array(SPEEDS) / 30, color="0.5", ls=":", label="12 a turn")
    right.plot(SPEEDS, np.array(SPEEDS) / 15, color="0.5", ls="-.", label="24 a turn")
    right.axhline(PAPER, color="k", lw=0.8, ls="--", label=f"{PAPER} Hz")
    right.set_xlabel("wheel speed [deg/s]")
    right.set_ylabel("strongest line of z, sim - real [Hz]")
    right.set_title("tick 2 ms, no dead band", fontsize=9)
    right.legend(fontsize=7)
    save_figure(figure, output)


if __name__ == "__main__":
    main()
