"""Result of a fit: values with errors, residuals by run and channel, and models as files."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import msgspec
import numpy as np
from rich.markup import escape

from drftjax import __version__
from drftjax.common.errors import InputError
from drftjax.common.output_files import files_of, make_folder, replace_file
from drftjax.common.packages import optional_package
from drftjax.common.rich_text import WholeWordTable, summary_html, summary_text
from drftjax.common.structured_files import as_json
from drftjax.common.text import replace_unprintable
from drftjax.recorded.observation import SHOWN
from drftjax.results.provenance import Provenance
from drftjax.runlog.hdf5.api import write_result
from drftjax.runlog.schema import UNITS
from drftjax.setups.command_knots import decimate_command
from drftjax.setups.fitted_model import FIT_SCHEMA, model_group
from drftjax.setups.setup import SetUp, as_in_file
from identify.results.interval_table import interval_table
from identify.results.misfit import POOR_FIT, short
from identify.results.posterior_file import posterior_document, write_posterior
from identify.results.values import RunFit, Value
from identify.solver.multistart import DRAWS_SEED

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

    from identify.solver.multistart import MultistartSummary
    from identify.uncertainty.bootstrap import Bootstrap
    from identify.uncertainty.estimate import Estimate
    from identify.uncertainty.posterior import ParameterPosterior
    from identify.uncertainty.profile_likelihood import ProfileLikelihood
    from identify.zeta_path.path import ZetaPath


@dataclass(frozen=True, eq=False, repr=False)
class FitResult:
    """A fit of many runs.

    Attributes:
        shared: Values shared by all runs, by name.
        runs: Each run's own values, residuals and fitted set-up.
        status: End of the fit: "converged", "poor fit" (the solver converged, and the model does
            not meet the runs), "stalled" or "out of steps".
        steps: Steps of the last solve.
        failures: Runs that were left out, and why.
        findings: Sentences on the values.
        labels: A name for each value: shared ones, then each run's own.
        covariance: Of the values, in their units squared, ordered as `labels`, shape (values,
            values).
        starts: Outcome of several starting points, where there were any.
        profiles: Profile likelihoods that were asked for.
        bootstraps: Bootstraps that were asked for.
        posterior: Draws of the posterior, where it was asked for.
        estimate: Solution and covariance, from which `profile`, `bootstrap` and `sample_posterior`
            start.
        floors: Noise floor by channel [m, N, N m], in which residuals are counted.
        provenance: Its inputs, its command line, and what it was made with.
    """

    shared: Mapping[str, Value]
    runs: list[RunFit]
    status: str
    steps: int
    failures: Mapping[str, str]
    findings: list[str] = field(default_factory=list)
    labels: tuple[str, ...] = ()
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    starts: "MultistartSummary | None" = None
    profiles: tuple["ProfileLikelihood", ...] = ()
    bootstraps: tuple["Bootstrap", ...] = ()
    posterior: "ParameterPosterior | None" = None
    estimate: "Estimate | None" = field(default=None, repr=False)
    floors: Mapping[str, float] = field(default_factory=dict)
    provenance: Provenance | None = None

    def with_failures(self, more: Mapping[str, str]) -> "FitResult":
        """Return the result with further runs named as left out."""
        return replace(self, failures={**more, **self.failures})

    @property
    def values(self) -> dict[str, Value]:
        """Every fitted value by its label: "lambda", "zeta of slow_a"."""
        every = [*self.shared.values(), *(v for run in self.runs for v in run.values.values())]
        return dict(zip(self.labels, every, strict=True)) if self.labels else {}

    @property
    def residuals(self) -> dict[str, dict[str, np.ndarray]]:
        """Simulated minus recorded by run and channel [m, N, N m]."""
        return {run.name: run.residuals for run in self.runs}

    @property
    def predictions(self) -> dict[str, dict[str, np.ndarray]]:
        """Simulated channels by run and channel [m, N, N m]."""
        return {run.name: run.predictions for run in self.runs}

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that any run compares."""
        return tuple(c for c in SHOWN if any(c in run.channels for run in self.runs))

    def rmse(self, fitted: bool = True) -> dict[str, float]:
        """Return the RMS over all samples of all runs, by channel [m, N, N m]."""
        pooled = {}
        for channel in self.channels:
            runs = [run for run in self.runs if channel in run.channels]
            runs = [run for run in runs if run.status != "diverged"] or runs
            power = sum(run.rmse(fitted)[channel] ** 2 * run.counts.sum() for run in runs)
            pooled[channel] = float(np.sqrt(power / sum(run.counts.sum() for run in runs)))
        return pooled

    def table(self) -> WholeWordTable:
        """Return a table of own values, and of RMSE before and after, by run and channel.

        Where noise floors are known, what is left is given in them, too.
        """
        channels = self.channels
        title = "simulated minus recorded, RMSE before → after the fit"
        table = WholeWordTable(title=title + " (after, in noise floors)" * bool(self.floors))
        # Names fold in a narrow terminal: cut off, zeta.stand and zeta.steady would look alike.
        table.add_column("run")
        table.add_column("status")
        own = list(self.runs[0].values)
        for name in own:
            label = self.runs[0].values[name].label
            table.add_column(label, justify="right")
        for channel in channels:
            heading = escape(f"{channel} [{SHOWN[channel][0]}]")
            table.add_column(heading, justify="right")

        def cells(before: dict[str, float], after: dict[str, float]) -> list[str]:
            return [self._cell(c, before[c], after[c]) if c in before else "-" for c in channels]

        for run in self.runs:
            values = [run.values[n].cell() for n in own]
            compared = cells(run.rmse(False), run.rmse())
            table.add_row(escape(replace_unprintable(run.name)), run.status, *values, *compared)
        table.add_section()
        table.add_row("all runs", "", *[""] * len(own), *cells(self.rmse(False), self.rmse()))
        return table

    def _cell(self, channel: str, before: float, after: float) -> str:
        """Return a channel's RMSE before and after, and the latter in noise floors."""
        scale = SHOWN[channel][1]
        text = f"{before * scale:.3f} → {after * scale:.3f}"
        return f"{text} ({short(after / self.floors[channel])})" if self.floors else text

    def document(self) -> dict:
        """Return the result as plain values, in the layout of the JSON file."""
        return {
            "schema": FIT_SCHEMA,
            "schema_version": 1,
            "software": f"drftjax {__version__}",
            "provenance": None if self.provenance is None else self.provenance.document(),
            "status": self.status,
            "steps": self.steps,
            "shared": msgspec.to_builtins(self.shared),
            "covariance": {"of": list(self.labels), "values": self.covariance.tolist()},
            "starts": msgspec.to_builtins(self.starts),
            "profiles": [
                {
                    "label": each.label,
                    "unit": each.unit,
                    "level": each.level,
                    "low": each.low,
                    "high": each.high,
                    "value": each.value.tolist(),
                    "rise": each.rise.tolist(),
                }
                for each in self.profiles
            ],
            "bootstraps": [
                {
                    "over": each.over,
                    "refit": each.refit,
                    "draws": len(each.draws),
                    "level": each.level,
                    "intervals": {
                        name: {"low": low, "high": high, "error": error}
                        for name, low, high, error in zip(
                            each.labels,
                            each.low.tolist(),
                            each.high.tolist(),
                            each.error.tolist(),
                            strict=True,
                        )
                    },
                }
                for each in self.bootstraps
            ],
            "posterior": posterior_document(self.posterior) if self.posterior else None,
            "rmse_before": self.rmse(False),
            "rmse_after": self.rmse(),
            "noise_floors": dict(self.floors),
            "failures": dict(self.failures),
            "findings": self.findings,
            "runs": [
                {
                    "name": run.name,
                    "status": run.status,
                    "values": msgspec.to_builtins(run.values),
                    "zeta_path": _path(run.path),
                    "rmse_before": run.rmse(False),
                    "rmse_after": run.rmse(),
                    "setup": msgspec.to_builtins(_with_short_command(run.setup)),
                }
                for run in self.runs
            ],
        }

    def plot(self) -> "Figure":
        """Return a figure of recorded and simulated channels of each run."""
        from identify.results.figure import plot_fit

        values = list(self.shared.values())
        return plot_fit(self.runs, self.channels, values, self.bands, self.floors)

    def profile(self, name: str, **options: Any) -> "FitResult":
        """Return the result with a value's profile; options as of `profile_likelihoods`."""
        from identify.uncertainty.profile_likelihood import profile_likelihoods

        with jax.enable_x64(True):
            found = profile_likelihoods(self._solved(), name, **options)
        return replace(self, profiles=(*self.profiles, *found))

    def bootstrap(self, count: int, **options: Any) -> "FitResult":
        """Return the result with intervals and bands of `count` draws; see `bootstrap`."""
        from identify.uncertainty.bootstrap import bootstrap

        with jax.enable_x64(True):
            found = bootstrap(self._solved(), count, **options)
        drawn = replace(self, bootstraps=tuple(found))
        return drawn._with_seed(options.get("seed", DRAWS_SEED))

    def sample_posterior(self, *arguments: Any, **options: Any) -> "FitResult":
        """Return the result with its posterior; arguments as of `sample_posterior`."""
        from identify.uncertainty.posterior import sample_posterior

        with jax.enable_x64(True):
            found = sample_posterior(self._solved(), *arguments, **options)
        return replace(self, posterior=found)._with_seed(found.settings.seed)

    def _with_seed(self, seed: int) -> "FitResult":
        """Return the result with the seed of its draws in its provenance, where it has one."""
        if self.provenance is None:
            return self
        return replace(self, provenance=msgspec.structs.replace(self.provenance, seed=seed))

    def interval_tables(self) -> list[WholeWordTable]:
        """Return a table of errors and intervals, where any method beside the fit was asked for."""
        if not (self.profiles or self.bootstraps or self.posterior):
            return []
        return [interval_table(self.values, self.profiles, self.bootstraps, self.posterior)]

    def _solved(self) -> "Estimate":
        if self.estimate is None:
            raise InputError("this result holds no solved fit to go on from")
        return self.estimate

    @property
    def bands(self) -> Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray]]]:
        """Predictive bands of readings, by run and channel [m, N, N m]; needs a bootstrap."""
        return self.bootstraps[0].bands if self.bootstraps else {}

    def sentences(self) -> list[str]:
        """Sentences under the table: shared values, findings, and runs that were skipped."""
        lines = [str(value) for value in self.shared.values()]
        lines += [str(self.starts)] if self.starts else []
        lines += [str(profile) for profile in self.profiles]
        lines += [sentence for each in self.bootstraps for sentence in each.sentences()]
        lines += self.posterior.sentences() if self.posterior else []
        lines += self.findings
        lines += [f"left out: {name}: {why}" for name, why in self.failures.items()]
        if self.status not in ("converged", POOR_FIT):
            lines.append(f"the solver is {self.status} after {self.steps} steps")
        return lines

    def summary(self, width: int = 110) -> str:
        """Return table and findings as text, `width` columns wide."""
        return summary_text([self.table(), *self.interval_tables(), *self.sentences()], width)

    def to_dataframe(self) -> "pandas.DataFrame":
        """Value, standard error and unit of every fitted number, a row each.

        Raises:
            InputError: pandas is not installed.
        """
        pandas = optional_package("pandas", "to_dataframe")
        rows = [(v.value, v.error, v.unit, v.at_bound) for v in self.values.values()]
        index = pandas.Index([*self.values], name="parameter")
        return pandas.DataFrame(rows, index, ["value", "error", "unit", "at_bound"])

    def to_xarray(self) -> "xarray.Dataset":
        """Value, standard error and covariance of the fitted numbers, along `parameter`.

        Raises:
            InputError: xarray is not installed.
        """
        xarray = optional_package("xarray", "to_xarray")
        values = [*self.values.values()]
        return xarray.Dataset(
            {
                "value": ("parameter", [each.value for each in values]),
                "error": ("parameter", [each.error for each in values]),
                "covariance": (("parameter", "other_parameter"), self.covariance),
            },
            {
                "parameter": [*self.labels],
                "other_parameter": [*self.labels],
                "unit": ("parameter", [each.unit for each in values]),
            },
            {"status": self.status},
        )

    def __repr__(self) -> str:
        known = {id(value) for value in self.shared.values()}
        # A shared value says its own name; that of a run needs the run's.
        told = (
            f"{value}" if id(value) in known else f"{label} = {value.cell()}"
            for label, value in self.values.items()
        )
        count = f"{len(self.runs)} run{'s' * (len(self.runs) > 1)}"
        return f"<FitResult of {count}, {self.status}: {', '.join(told)}>"

    def _repr_html_(self) -> str:
        return summary_html([self.table(), *self.interval_tables(), *self.sentences()])

    def write(self, stem: Path) -> list[Path]:
        """Write `stem`.json and `stem`.h5, from which `drft simulate --from` reads models back.

        The HDF5 file also holds every run's recorded and simulated channels. A posterior is
        written to `stem`.nc, for ArviZ.

        Raises:
            InputError: where they cannot be written.
        """
        text, binary, *_ = result_files(stem)
        make_folder(stem.parent)
        replace_file(text, as_json(self.document()))
        groups = {run.name: _group(run, self.bands.get(run.name, {})) for run in self.runs}
        numbers = {
            f"{n}_{k}": getattr(v, k) for n, v in self.shared.items() for k in ("value", "error")
        }
        write_result(binary, FIT_SCHEMA, {"status": self.status, **numbers}, groups)
        if self.posterior is None:
            return [text, binary]
        chains = posterior_path(stem)
        write_posterior(self.posterior, chains)
        return [text, binary, chains]


def result_files(stem: Path) -> tuple[Path, Path, Path, Path]:
    """`stem`.json, .h5, .png and .html: a fit's values, its channels, its figure and its page."""
    text, binary, picture, page = files_of(stem, (".json", ".h5", ".png", ".html"))
    return text, binary, picture, page


def posterior_path(stem: Path) -> Path:
    """Return `stem`.nc, the draws of a fit's posterior."""
    return files_of(stem, (".nc",))[0]


def write_with_report(result: FitResult, stem: Path) -> list[Path]:
    """Write the files of `FitResult.write`, and `stem`.png and `stem`.html; return their names.

    Raises:
        InputError: where they cannot be written.
    """
    from drftjax.common.figures import save_figure
    from identify.results.report import page

    written = result.write(stem)
    _, _, picture, report = result_files(stem)
    save_figure(result.plot(), picture)
    replace_file(report, page(result, stem.name).encode())
    return [*written, picture, report]


def _path(path: "ZetaPath | None") -> dict | None:
    if path is None:
        return None
    columns = {name: getattr(path, name).tolist() for name in ("time", "value", "error")}
    return columns | {"told": path.identified.tolist(), "weight": path.weight}


def _with_short_command(setup: SetUp) -> SetUp:
    return msgspec.structs.replace(as_in_file(setup), command=decimate_command(setup.command))


def _group(run: RunFit, bands: Mapping[str, tuple[np.ndarray, np.ndarray]]):
    datasets = {"time": (run.time, "s"), "counts": (run.counts, "1")}
    for index, channel in enumerate(run.channels):
        for kind in ("recorded", "before", "after"):
            datasets[f"{channel}_{kind}"] = (getattr(run, kind)[index], UNITS["measured"][channel])
        for kind, values in zip(("low", "high"), bands.get(channel, ()), strict=False):
            datasets[f"{channel}_{kind}"] = (values, UNITS["measured"][channel])
    if run.path is not None:
        datasets["zeta_time"] = (run.path.time, "s")
        datasets["zeta"] = (run.path.value, "1")
        datasets["zeta_error"] = (run.path.error, "1")
    numbers = {f"{n}_{k}": getattr(v, k) for n, v in run.values.items() for k in ("value", "error")}
    return model_group(run.setup, datasets, numbers)
