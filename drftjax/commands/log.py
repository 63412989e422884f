"""`drft log`: check, show, draw, repair, import and export run logs."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from drftjax.commands.options import CommandGroup
from drftjax.commands.printing import say, say_next
from drftjax.common.errors import InputError, missing_path

app = typer.Typer(
    name="log",
    cls=CommandGroup,
    help="Check, show, draw, repair, import and export run logs.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


Files = Annotated[
    list[Path],
    typer.Argument(metavar="FILE", help="Run logs, or folders of them.", show_default=False),
]


TimeLimit = Annotated[float, typer.Option(help="For reading one file [s].", min=0.1)]


@app.command()
def check(files: Files, time_limit: TimeLimit = 20.0) -> None:
    """Say everything that is wrong with run logs; exit code 2 where there is anything."""
    from drftjax.runlog.check import check_files
    from drftjax.runlog.content import Level
    from drftjax.runlog.files import run_files

    files = run_files(files)
    broken = False
    for path, violations in zip(files, check_files(files, time_limit), strict=True):
        notes = [each for each in violations if each.level is Level.NOTE]
        for each in violations:
            say(f"note: {each}" if each in notes else str(each))
        if len(notes) == len(violations):
            say(f"{path}: ok")
        else:
            broken = True
    if broken:
        raise typer.Exit(2)


@app.command()
def show(files: Files) -> None:
    """Print a run's set-up and the rows, rates, ranges and last values of its channels."""
    from rich.console import Console

    from drftjax.runlog.check import read_runs_guarded
    from drftjax.runlog.files import run_files
    from drftjax.runlog.summary import show as summary

    files = run_files(files)
    console = Console(highlight=False)
    console.soft_wrap = not console.is_terminal
    for path, run in zip(files, read_runs_guarded(files), strict=True):
        console.print(summary(str(path), run), markup=False)


@app.command()
def plot(
    file: Annotated[Path, typer.Argument(metavar="FILE", show_default=False)],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Figure to write: .png, .svg or .pdf.")
    ],
) -> None:
    """Draw a run."""
    from drftjax.common.figures import check_figure_name, save_figure
    from drftjax.common.output_files import require_places
    from drftjax.runlog.check import read_run_guarded

    check_figure_name(output)
    require_places([output], [file])
    run = read_run_guarded(file)

    from drftjax.runlog.figure import plot_run

    try:
        save_figure(plot_run(run), output)
    except InputError as problem:
        raise InputError(f"{file}: {problem}") from None
    say(f"wrote {output}")


@app.command()
def repair(
    part: Annotated[Path, typer.Argument(metavar="NAME.h5.part", show_default=False)],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="The file to write.", show_default="NAME.h5"),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that exists.")] = False,
) -> None:
    """Make an ordinary run log of a recording that was cut off; the recording stays."""
    from drftjax.runlog.repair import repair as mend

    path, run = mend(part, output, force)
    rows = f"{run.command.time.size} commands, {run.measured.time.size} readings"
    ticks = "" if run.online is None else f", {run.online.time.size} ticks"
    say(f"wrote {path}: {rows}{ticks}, to {run.measured.time[-1]:g} s; {part} is left")
    say_next("log", "show", path)


@app.command()
def export(
    file: Annotated[Path, typer.Argument(metavar="RUN", show_default=False)],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="File to write: .csv, .tsv, .parquet, .mat, .nc or .mcap."
        ),
    ],
    derived: Annotated[
        bool,
        typer.Option(
            "--derived", help="Add slip, sinkage, wheel angle, drawbar coefficient and power."
        ),
    ] = False,
    groups: Annotated[
        bool, typer.Option("--groups", help="Write a table for each group, at its own times.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace files that exist.")] = False,
) -> None:
    """Write a run for a spreadsheet, MATLAB, xarray or a viewer of logs."""
    from drftjax.common.output_files import put_new_file, replace_file
    from drftjax.runlog.check import read_run_guarded
    from drftjax.runlog.export.writers import exported_files

    run = read_run_guarded(file)
    try:
        files = exported_files(run, output, groups=groups, derived=derived)
    except InputError as problem:
        named = str(problem).startswith(str(output))
        raise InputError(str(problem) if named else f"{file}: {problem}") from None
    for path in files:
        if path.exists() and not force:
            raise InputError(f"{path} is already there; give --force to replace")
        if path.exists() and path.samefile(file):
            raise InputError(f"{path} is read here and would be replaced; give another name")
    for path, data in files.items():
        (replace_file if force else put_new_file)(path, data)
        say(f"wrote {path}")


class ImportCommand(TyperCommand):
    """`drft log import`: its help ends with the suffixes that are read."""

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the suffixes of all importers, those of other packages included."""
        from drftjax.runlog.importers.registry import suffixes

        formatter.write_paragraph()
        formatter.write_text(f"Files that are read: {', '.join(suffixes())}; others as .csv.")


@app.command(name="import", cls=ImportCommand)
def import_(
    table: Annotated[Path, typer.Argument(metavar="TABLE", show_default=False)],
    *,
    mapping: Annotated[
        str | None,
        typer.Option(
            help="A TOML file, or the name of a mapping that ships with drft; a table needs one."
        ),
    ] = None,
    guess: Annotated[
        bool,
        typer.Option(
            "--guess", help="Propose a mapping instead, to the screen or to the .toml of -o."
        ),
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="A .h5 or .hdf5 file for one run, or a folder; needed but with --guess.",
            show_default=False,
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that exist.")] = False,
) -> None:
    """Make run logs from a table, by a mapping that says what its columns mean."""
    if not table.exists():
        raise InputError(f"{table}: {missing_path(table)}")
    if guess:
        if mapping is not None:
            raise InputError("--guess proposes a mapping; leave out --mapping")
        _propose(table, output, force)
        return
    if output is None:
        raise InputError("give -o, a .h5 or .hdf5 file for one run, or a folder")
    from drftjax.runlog.hdf5.api import write_run
    from drftjax.runlog.importers.registry import importer_for
    from drftjax.runlog.plausibility import plausibility_warnings

    imported = list(importer_for(table)(table, None if mapping is None else _mapping(mapping)))
    targets = _targets(output, [each.name for each in imported])
    taken = [path for path in targets if path.exists()]
    if taken and not force:
        more = f" and {len(taken) - 1} more are" if len(taken) > 1 else " is"
        raise InputError(f"{taken[0]}{more} already there; give --force to replace")
    for path, each in zip(targets, imported, strict=True):
        write_run(path, each.run)
        say(f"wrote {path}: {each.run.title}")
        for doubt in (*each.losses, *plausibility_warnings(each.run)):
            say(f"note: {path}: {doubt}", error=True)
    if targets:
        say_next("log", "show", output)


def _propose(table: Path, output: Path | None, force: bool) -> None:
    """Print or write the mapping proposed for a table, and say what is unsure."""
    from drftjax.common.output_files import put_new_file, replace_file
    from drftjax.runlog.importers.guess.proposal import propose_mapping

    if output is not None and output.suffix.lower() != ".toml":
        raise InputError(f"{output}: the name of a mapping must end in .toml")
    if output is not None and output.exists() and not force:
        raise InputError(f"{output} is already there; give --force to replace")
    proposal = propose_mapping(table)
    for doubt in proposal.doubts:
        say(f"unsure: {doubt}", error=True)
    if output is None:
        typer.echo(proposal.text, nl=False)
        return
    put = replace_file if force else put_new_file
    put(output, proposal.text.encode())
    say(f"wrote {output}; look at it, then: drft log import {table} --mapping {output} -o runs")


def _mapping(given: str) -> Path:
    """Path of a mapping, given by its path or by the name of one that ships with the project."""
    from drftjax.common.packages import data_file, data_names
    from drftjax.runlog.validation import nearest

    if Path(given).is_file():
        return Path(given)
    known = data_names("import", ".toml")
    name = given.removesuffix(".toml")
    if name not in known:
        if "/" in given or given != name:
            raise InputError(f"{given}: {missing_path(Path(given), 'file')}")
        hint = nearest(name, tuple(known))
        raise InputError(f"there is no mapping {given!r}, neither a file nor by name; {hint}")
    return data_file(f"import/{name}.toml")


def _targets(output: Path, names: list[str]) -> list[Path]:
    """Output file of each run: the path itself for one run, else safe names in a folder."""
    from drftjax.common.output_files import make_folder
    from drftjax.runlog.files import HDF5_ENDINGS
    from drftjax.runlog.importers.file_names import safe_names

    if output.suffix in HDF5_ENDINGS and not output.is_dir():
        if len(names) != 1:
            raise InputError(f"{output} is one file, but the table holds {len(names)} runs")
        return [output]
    make_folder(output)
    return [output / f"{name}.h5" for name in safe_names(names)]
