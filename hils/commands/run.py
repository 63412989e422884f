"""`drft hils run`: the paper's experiment on a rig."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from drftjax.commands.options import USUAL_OMEGA_MAX, complete_tuner, refuse_options
from drftjax.common.errors import InputError
from hils.link.timing import USUAL_BAUD, require_baud

# Ports whose line has no baud rate.
WITHOUT_BAUD = ("socket://", "loop://")


OF_THE_TUNER = ("tuner", "zeta_step", "tolerance", "number", "tuning_ticks")


EXAMPLES = """
Examples:

\b
  drft hils run --port /dev/ttyUSB0 --profile data/paper.toml -o run.h5
  drft hils run --port /tmp/rig --profile data/paper.toml -o run.h5 \\
      --no-ui --yes
  drft hils run --port socket://192.168.1.7:4000 --profile data/paper.toml \\
      -o bed.h5 --repeat 10

The profile is a set-up file: what you believe of wheel, sand and rig, and omega(t). Nothing moves
before all is checked and zeroed. Ctrl-C, or drft hils stop from another terminal, ramps the wheel
down; a second Ctrl-C, or drft hils stop --now, is an emergency stop. In the live view, S stops and
E is an emergency stop; there is no view with --no-ui, or where the output is no terminal. A picture
of the run is drawn beside the run log.
"""


def run(
    context: typer.Context,
    port: Annotated[str, typer.Option(help="Serial port, or a URL such as socket://HOST:PORT.")],
    profile: Annotated[Path, typer.Option(help="A set-up file with the profile (TOML or JSON).")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The run log to record (.h5).")],
    baud: Annotated[int, typer.Option(help="Baud rate of the port.")] = USUAL_BAUD,
    tick: Annotated[float, typer.Option(help="Control period [s].")] = 0.01,
    tuner: Annotated[
        str,
        typer.Option(
            help="Tuner: step (eq. 7's fixed step), pi, kalman (docs/theory/hils-tuners.md), "
            "or one that an installed package adds.",
            autocompletion=complete_tuner,
        ),
    ] = "step",
    zeta_step: Annotated[
        float | None,
        typer.Option(help="Of the tuner 'step': change of zeta on one tick.", show_default="0.001"),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="Of the tuners 'step' and 'pi': sinkage error that is left alone [m].",
            show_default="step 0.0001, pi 0.00002",
        ),
    ] = None,
    number: Annotated[
        list[str] | None,
        typer.Option(help="Another of the tuner's numbers, NAME=VALUE; may be repeated."),
    ] = None,
    tuning_ticks: Annotated[
        int, typer.Option(help="Ticks from one step of the tuner to the next.", min=1)
    ] = 1,
    mode: Annotated[
        Literal["hils", "free"],
        typer.Option(help="hils: drive at the simulated speed; free: carriage free, record only."),
    ] = "hils",
    zero: Annotated[
        Literal["held", "power-up"],
        typer.Option(
            help="held: the wheel is held at touch-down and zeroed there; power-up: "
            "touch-down is the rig's own zero."
        ),
    ] = "held",
    zeta: Annotated[
        float | None,
        typer.Option("--zeta0", help="zeta at the start.", show_default="by the sinkage at rest"),
    ] = None,
    repeat: Annotated[int, typer.Option(help="Runs to make, numbered files.", min=1, max=1000)] = 1,
    between: Annotated[
        str | None, typer.Option(help="Shell command that prepares the sand between two runs.")
    ] = None,
    policy: Annotated[
        Literal["skip", "stop"], typer.Option(help="What follows a missed deadline.")
    ] = "skip",
    omega_max: Annotated[
        float, typer.Option(help="Largest angular velocity [rad/s].")
    ] = USUAL_OMEGA_MAX,
    vx_max: Annotated[float, typer.Option(help="Largest carriage speed [m/s].")] = 0.3,
    countdown: Annotated[
        float, typer.Option(help="From rest to the start [s].", min=0.1, max=60.0)
    ] = 3.0,
    title: Annotated[str, typer.Option(help="Of the run log.")] = "",
    stream: Annotated[
        str | None,
        typer.Option(
            help="Send each tick's numbers: udp://HOST:PORT (JSON, for PlotJuggler), or serve them "
            "at foxglove://HOST:PORT."
        ),
    ] = None,
    no_ui: Annotated[bool, typer.Option("--no-ui", help="No live view.")] = False,
    no_plot: Annotated[
        bool, typer.Option("--no-plot", help="No picture and no page beside the run log.")
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Ask nothing: a virtual rig, or one that needs no hands.")
    ] = False,
    fifo: Annotated[
        bool, typer.Option(help="Run before every ordinary process, where that is allowed.")
    ] = True,
) -> None:
    """Run a rig in the loop, or with its carriage free, and record it."""
    if mode == "free":
        refuse_options(context, OF_THE_TUNER, "in --mode free nothing is tuned")
    if repeat == 1:
        refuse_options(context, ("between",), "one run has none after it; give --repeat")
    if not port:
        raise InputError("--port is empty, must be a device or a URL; drft hils ports lists them")
    from hils.procedure.operator_prompts import TerminalPrompts, UnattendedPrompts, signs_of_life

    with signs_of_life("Loading the simulator"):
        from drftjax.common.jax_config import configure_jax

        configure_jax()
        from hils.realtime import answer_at_once

        answer_at_once()
        from drftjax.setups.setup import read_setup
        from drftjax.tuning.registry import TunerSetUp
        from hils.control.limits import CommandLimits
        from hils.control.loop import Overruns
        from hils.control.loop_config import LoopSetUp
        from hils.control.loop_config import profile as profile_of
        from hils.monitor.stream_address import read_stream_address
        from hils.monitor.terminal import has_own_terminal
        from hils.procedure.procedure import Procedure, ZeroAt
        from hils.series import Series, file_names, make_series

        given = {"zeta_step": zeta_step, "tolerance": tolerance}
        named = [f"{name}={value}" for name, value in given.items() if value is not None]
        numbers = _numbers([*named, *(number or [])])
        loop = LoopSetUp(
            setup=read_setup(profile),
            commands=CommandLimits(omega_max, vx_max),
            tuner=TunerSetUp(tuner, numbers),
            tick=tick,
            tuning_ticks=tuning_ticks,
        )
        # What can be refused is refused before anything is opened.
        profile_of(loop, 1)
        loop.tuner.build(tick)
        if not port.lower().startswith(WITHOUT_BAUD):
            require_baud(baud, tick)
        streamed = None if stream is None else read_stream_address(stream)
        procedure = Procedure(
            loop=loop,
            free=mode == "free",
            zero=ZeroAt(zero),
            zeta=zeta,
            overruns=Overruns(policy),
            countdown=countdown,
            title=title,
        )
    view = has_own_terminal() and not no_ui
    series = Series(
        port, baud, file_names(output, repeat), between, fifo, view, not no_plot, streamed
    )
    code = make_series(procedure, series, UnattendedPrompts() if yes else TerminalPrompts())
    if code:
        raise typer.Exit(code)


def _numbers(given: list[str]) -> dict[str, float]:
    numbers = {}
    for each in given:
        name, _, value = each.partition("=")
        name = name.strip().replace("-", "_")
        if name in numbers:
            raise InputError(f"the tuner's number {name!r} is given twice")
        try:
            numbers[name] = float(value)
        except ValueError:
            raise InputError(f"--number is {each!r}, must be NAME=VALUE with a number") from None
    return numbers
