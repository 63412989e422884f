"""`drft fit`: recorded runs in, fitted numbers with errors out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drftjax.commands.options import (
    PlotFile,
    complete_channel,
    draw_picture,
    remove_empty_folders,
    require_picture,
)
from drftjax.commands.printing import say_on
from drftjax.common.errors import InputError
from drftjax.common.output_files import stem_of

if TYPE_CHECKING:
    from identify.parameters.parameter import Parameter

app = typer.Typer(add_completion=False, rich_markup_mode=None)


EXAMPLES = """
Examples:

\b
  drft fit data/runs/*.h5 -o out/fit           zeta for each, lambda for all
  drft fit runs/*.h5 --share zeta -o out/fit   one zeta for all runs
  drft fit runs/*.h5 --own zeta --share rig.drawbar_load -o out/fit
  drft fit runs/*.h5 --share drawbar.force     a number of an effect
  drft fit runs/*.h5 --model out/model.toml    with the effects of a diagnosis
  drft fit runs/*.h5 --compare z               by the sinkage alone
  drft fit runs/*.h5 --zeta phases             zeta of standing, going, ...
  drft fit runs/*.h5 --zeta path               zeta(t), as smooth as data ask
  drft fit runs/*.h5 --zeta path --share lambda   and lambda of all beside it
  drft fit runs/*.h5 --share lambda --cluster local -o out/fit
  drft fit runs/*.h5 --starts 8 --profile lambda --bootstrap 500 -o out/fit
  drft fit runs/*.h5 --posterior -o out/fit    Markov chains, out/fit.nc
  drft fit runs/*.h5 --parameters fit.toml     what a file names:

\b
      [[parameter]]
      name = "zeta"         # one for each run; shared = true for all
      bounds = [0.3, 2.0]
      prior = [0.78, 0.1]   # mean and standard error believed before the runs

The result is out/fit.json, out/fit.h5, out/fit.png and out/fit.html (one page, to open in a
browser), and the draws of --posterior out/fit.nc;
`drft simulate --from out/fit.json --run NAME` simulates a fitted run again.
"""


@app.command(epilog=EXAMPLES)
@remove_empty_folders
def fit(
    runs: Annotated[
        list[Path], typer.Argument(help="Run logs, or folders of them.", show_default=False)
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Stem of the result files.")
    ] = None,
    picture: PlotFile = None,
    own: Annotated[
        list[str] | None, typer.Option(help="A parameter fitted for each run. [default: zeta]")
    ] = None,
    share: Annotated[
        list[str] | None,
        typer.Option(help="A parameter shared by all runs. [default: lambda, if none is named]"),
    ] = None,
    parameters: Annotated[
        Path | None, typer.Option(help="A TOML file of parameters, over --own and --share.")
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option(
            help="A set-up file: wheel, sand, rig and effects in place of what the run logs "
            "believe, such as a diagnosis's model.toml."
        ),
    ] = None,
    autoregressive: Annotated[
        bool,
        typer.Option("--autoregressive", help="Whiten residuals that follow one another."),
    ] = False,
    zeta: Annotated[
        str,
        typer.Option(
            help="'constant', 'phases' (one for each phase of the command) or 'path' (zeta(t)).",
            autocompletion=lambda incomplete: [
                each for each in ("constant", "phases", "path") if each.startswith(incomplete)
            ],
        ),
    ] = "constant",
    knots: Annotated[
        float | None, typer.Option(help="Knot spacing of --zeta path [s]. [default: 1.0]")
    ] = None,
    start_zeta: Annotated[
        float | None, typer.Option(help="Scaling factor to start from, over the run logs'.")
    ] = None,
    starts: Annotated[int, typer.Option(help="Starting points to try; the best end is kept.")] = 1,
    profile: Annotated[
        list[str] | None,
        typer.Option(help="A fitted parameter whose profile likelihood is wanted."),
    ] = None,
    bootstrap: Annotated[
        int | None, typer.Option(help="Draws of a bootstrap: intervals and bands of readings.")
    ] = None,
    posterior: Annotated[
        bool,
        typer.Option("--posterior", help="Markov chains over the values; needs [posterior]."),
    ] = False,
    step: Annotated[
        float | None,
        typer.Option(help="Integrator step [s]. [default: chosen for each run]"),
    ] = None,
    keep_rest: Annotated[
        bool, typer.Option("--keep-rest", help="Compare samples after the last stop too.")
    ] = False,
    compare: Annotated[
        list[str] | None,
        typer.Option(
            help="A channel that is compared: x, z, fx, fz or torque. [default: all that the "
            "simulation predicts]",
            autocompletion=complete_channel,
        ),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            help="Fit on a Dask cluster, 'local', 'local:N' or 'tcp://scheduler:port', and go on "
            "where a killed call ended: every run alone, unless --share names a parameter."
        ),
    ] = None,
) -> None:
    """Fit zeta, lambda or other numbers to recorded runs, by simulating them."""
    import math
    import os
    from dataclasses import replace
    from functools import partial

    from rich.console import Console

    from drftjax.common.jax_config import configure_jax

    configure_jax(devices=os.cpu_count())
    from drftjax.commands.progress import progress_line
    from drftjax.common.output_files import require_places
    from drftjax.recorded.gather import gather
    from drftjax.recorded.observation import require_channels
    from drftjax.recorded.prepared_run import names_of, prepare_run
    from drftjax.results.provenance import command_provenance
    from drftjax.runlog.check import require_no_recording
    from drftjax.runlog.files import drop_repeated_files, run_files
    from drftjax.runlog.record import CHANNELS
    from drftjax.setups.setup import read_setup
    from identify.design.required_speed import add_required_speeds
    from identify.fit_constant import fit as fit_runs
    from identify.fit_path import fit_paths
    from identify.parameters.phase_zeta import zeta_phases
    from identify.results.result import posterior_path, result_files, write_with_report
    from identify.solver.multistart import DRAWS_SEED
    from identify.uncertainty.noise_model import Autoregressive, White, noise_model
    from identify.uncertainty.posterior import require_extra
    from identify.uncertainty.profile_likelihood import require_fitted
    from identify.zeta_path.smoother import KNOT_SPACING

    _require_start(start_zeta)
    require_channels(CHANNELS if compare is None else compare)
    channels = tuple(each for each in CHANNELS if compare is None or each in compare)
    _require_together(zeta, knots, starts, profile, bootstrap, posterior, autoregressive)
    if zeta == "path" and "z" not in channels:
        raise InputError("--zeta path follows the sinkage, so --compare must name z")
    if posterior and cluster is None:
        require_extra()
    path = zeta == "path"
    fitted = _fitted_parameters(own, share, parameters, path=path, apart=cluster is not None)
    for name in profile or []:
        require_fitted(name, fitted, zeta == "phases")
    require_picture(picture, runs)
    stem = None if output is None else _stem(output)
    if stem is not None:
        text, binary, drawn, page = result_files(stem)
        chains = [posterior_path(stem)] if posterior else []
        require_places([text, binary, drawn, page, *chains], runs)
        for each in (binary, *chains):
            require_no_recording(each)
    noise = Autoregressive.name if autoregressive else White.name
    if cluster is not None:
        from identify.cluster.fit_options import FitOptions, parameter_specs
        from identify.commands.fit_cluster import fit_on_cluster

        if zeta != "constant" or starts != 1 or profile or bootstrap or posterior or model:
            raise InputError(
                "--cluster fits constant numbers to runs as their logs have them; leave --zeta, "
                "--starts, --profile, --bootstrap, --posterior and --model out"
            )
        how = FitOptions(parameter_specs(fitted), noise, start_zeta, step, keep_rest, channels)
        kept, left_out = drop_repeated_files(run_files(runs))
        named = dict(zip(names_of(kept), kept, strict=True))
        fit_on_cluster(cluster, named, how, stem, left_out, [*runs, parameters], picture)
        return
    seed = DRAWS_SEED if starts > 1 or bootstrap is not None or posterior else None
    made = command_provenance("fit", [*runs, parameters, model], seed)

    console = Console()
    say = partial(say_on, console)

    with progress_line(console, "reading runs") as show:
        ready = partial(
            prepare_run,
            model=None if model is None else read_setup(model),
            fitted=[each.quantity.name for each in fitted],
            zeta=start_zeta,
            step=step,
            keep_rest=keep_rest,
            compare=channels,
        )
        tell = partial(say, style="yellow")
        gathered = gather(runs, ready, sinkage=path, tell=tell)
        prepared = gathered.runs
        show(f"compiling for {len(prepared)} runs")

        def report(stage: str, number: int, loss: float) -> None:
            squares = "" if math.isnan(loss) else f", sum of squares {loss:.6g}"
            show(f"{stage}: step {number}{squares}")

        if path:
            spacing = KNOT_SPACING if knots is None else knots
            result = fit_paths(prepared, spacing, fitted, report)
        else:
            if zeta == "phases":
                fitted = zeta_phases(prepared, fitted)
            result = add_required_speeds(
                fit_runs(prepared, fitted, report, noise_model(noise), starts=starts)
            )
        for name in profile or []:
            show(f"profile of {name}")
            result = result.profile(name)
        if bootstrap is not None:
            show(f"bootstrap of {bootstrap} draws")
            result = result.bootstrap(bootstrap)
        if posterior:

            def tell_chains(stage: str, done: int, of_all: int) -> None:
                show(f"posterior: {stage}", done, of_all)

            show("posterior: compiling")
            result = result.sample_posterior(progress=tell_chains)

    console.print(result.table())
    for each in (*(profile.table() for profile in result.profiles), *result.interval_tables()):
        console.print(each)
    for sentence in result.sentences():
        say(sentence, "yellow" if sentence.startswith(("left out", "the solver is")) else None)
    result = replace(result.with_failures(gathered.skipped), provenance=made)
    if stem is not None:
        say(f"written: {', '.join(map(str, write_with_report(result, stem)))}")
    if picture is not None:
        draw_picture(result.plot(), picture)


def _require_start(start_zeta: float | None) -> None:
    """Raise InputError for an impossible start of zeta."""
    from drftjax.physics.terrain import LARGEST_ZETA

    if start_zeta is not None and not 0 < start_zeta <= LARGEST_ZETA:
        raise InputError(
            f"--start-zeta is {start_zeta:g}, must be over 0 and at most {LARGEST_ZETA:g}"
        )


def _require_together(
    zeta: str,
    knots: float | None,
    starts: int,
    profile: list[str] | None,
    bootstrap: int | None,
    posterior: bool,
    autoregressive: bool,
) -> None:
    """Check the kind of zeta, and that the other options go with it.

    Raises:
        InputError: names the option, and what must hold.
    """
    from identify.api import ZETAS
    from identify.solver.multistart import require_starts
    from identify.uncertainty.bootstrap import require_draws

    if zeta not in ZETAS:
        raise InputError(f"--zeta is {zeta!r}, must be one of {', '.join(ZETAS)}")
    if zeta == "path" and (starts != 1 or profile or bootstrap or posterior):
        raise InputError(
            "--zeta path goes from one start to one answer; leave --starts, --profile, "
            "--bootstrap and --posterior out"
        )
    if zeta != "path" and knots is not None:
        raise InputError("--knots is the spacing of the knots of --zeta path; leave it out")
    if zeta == "path" and autoregressive:
        raise InputError("--zeta path finds each channel's correlation; leave --autoregressive out")
    require_starts(starts)
    if bootstrap is not None:
        require_draws(bootstrap)


def _fitted_parameters(
    own: list[str] | None,
    share: list[str] | None,
    parameters: Path | None,
    *,
    path: bool,
    apart: bool,
) -> "list[Parameter]":
    """Parameters that the options name.

    Args:
        own, share, parameters: As for the command.
        path: True for a fit of zeta(t), with which nothing else is fitted by default.
        apart: True where nothing is shared by default.

    Raises:
        InputError: for options that contradict one another, or a parameter that cannot be.
    """
    from identify.fit_path_jointly import require_joint_parameters
    from identify.parameters.parameter import parameter, require_once
    from identify.parameters.parameter_file import read_parameters

    shared_names = share if share is not None else ([] if own or apart or path else ["lambda"])
    own_names = own if own is not None else ([] if "zeta" in shared_names or path else ["zeta"])
    if parameters is not None and (own or share):
        raise InputError("--parameters lists every parameter; leave --own and --share out")
    fitted = [parameter(n, shared=True) for n in shared_names]
    fitted += [parameter(n, shared=False) for n in own_names]
    fitted = fitted if parameters is None else read_parameters(parameters)
    require_once(fitted)
    if path:
        require_joint_parameters(fitted)
    return fitted


def _stem(output: Path) -> Path:
    return stem_of(output, (".json", ".h5", ".png", ".nc", ".html"))
