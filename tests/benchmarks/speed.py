"""Measure the simulator beside the yardstick: `python -m tests.benchmarks.speed`.

Ours and the yardstick take turns, so that whatever else the machine does meets both. Times are
wall-clock times of a whole call, compilation left out; the least of the repeats is the figure.
"""

import argparse
import json
import os
import platform
import re
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from rich.console import Console
from rich.table import Table

from drftjax.common.jax_config import with_options
from tests.benchmarks import cases
from tests.benchmarks.cases import Case
from tests.benchmarks.yardstick import Unavailable, Yardstick

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"

PLAIN_XLA = "float64, XLA as it comes"
WORKERS = {
    "float64": ("float64", with_options("")),
    "float32": ("float32", with_options("")),
    PLAIN_XLA: ("float64", ""),
}


class Worker:
    """A process that computes in one precision, with one set of flags."""

    def __init__(self, precision: str, flags: str, cores: int):
        environment = os.environ | {
            "JAX_PLATFORMS": "cpu",
            "JAX_ENABLE_X64": str(int(precision == "float64")),
            "JAX_NUM_CPU_DEVICES": str(cores),
            "XLA_FLAGS": flags,
        }
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.benchmarks.worker"],
            cwd=ROOT, env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip

    def ask(self, kind: str, case: Case, detail: bool = False) -> dict[str, Any]:
        assert self._process.stdin
        assert self._process.stdout
        request = {"kind": kind, "case": case.words(), "detail": detail}
        print(json.dumps(request), file=self._process.stdin, flush=True)
        reply = self._process.stdout.readline()
        if not reply:
            raise RuntimeError("the worker ended; its message is above")
        return json.loads(reply)

    def close(self) -> None:
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait()


def machine() -> dict[str, Any]:
    try:
        found = re.search(r"model name\s*:\s*(.+)", Path("/proc/cpuinfo").read_text())
    except OSError:
        found = None
    model = found[1] if found else platform.machine()
    return {
        "cpu": model,
        "cores": len(os.sched_getaffinity(0)),
        "python": platform.python_version(),
    }


class Truth:
    """What z and the final x should be: of the single run by the reference, of the many by ours."""

    def __init__(self, worker: Worker):
        with h5py.File(SHARED / "reference_rigs" / "paper.h5") as file:
            self._time, self._z, self._x = (
                np.asarray(file[f"measured/{name}"]) for name in ("time", "z", "x")
            )
        fine = worker.ask("plain", cases.FINE, detail=True)
        self._fine, self._fine_x = np.asarray(fine["z"]), np.asarray(fine["x"])
        self._fine_time = cases.FINE.row * np.arange(1, self._fine.shape[1] + 1)

    def of_one(self, time: np.ndarray, z: np.ndarray) -> list[float]:
        """Largest error of the single run while its wheel turns [mm]."""
        turns = (time >= cases.TURNS) & (time <= cases.STOPS)
        return [1e3 * float(np.abs(z - np.interp(time, self._time, self._z))[turns].max())]

    def of_many(self, time: np.ndarray, z: np.ndarray) -> list[float]:
        """Largest error from `DRIVEN` to the stop [mm]: of the median run checked, and worst."""
        true = np.stack([np.interp(time, self._fine_time, fine) for fine in self._fine])
        driven = (time >= cases.DRIVEN - 1e-9) & (time <= cases.STOPS)
        worst = 1e3 * np.abs(z - true)[:, driven].max(axis=1)
        return [float(np.median(worst)), float(worst.max())]

    def of(self, case: Case, z: list) -> list[float]:
        heights = np.asarray(z)
        time = case.row * np.arange(1, heights.shape[-1] + 1)
        return (self.of_one if case.runs == 1 else self.of_many)(time, heights)

    def of_place(self, case: Case, x: list) -> float:
        """Error of the final x [mm], of an ensemble the worst of the runs checked."""
        true = self._x[-1] if case.runs == 1 else self._fine_x
        return 1e3 * float(np.abs(np.asarray(x) - true).max())

    def of_yardstick(self, yardstick: Yardstick, runs: int, dt: float) -> list[float]:
        if runs == 1:
            time = np.arange(1, 241) * 0.1
            return self.of_one(time, yardstick.heights(cases.PAPER_ZETA, dt, time))
        time = np.arange(cases.DRIVEN, cases.STOPS + 1e-9, 0.5).round(1)
        zetas = cases.zetas_of(runs)[cases.checked(runs)]
        return self.of_many(time, np.stack([yardstick.heights(z, dt, time) for z in zetas]))


# The yardstick in the precision of each of ours.
BESIDE = {"float64": "double", "float32": "float", PLAIN_XLA: "double"}


def speeds(
    workers: dict[str, Worker],
    yardsticks: dict[str, Yardstick],
    truth: Truth,
    repeats: int,
    measured: Sequence[Case],
) -> list[dict[str, Any]]:
    """A row for each case and precision, and for the yardstick; all measured in turns."""
    rows, timers = [], []
    for case in measured:
        runs, dt = case.runs, cases.YARDSTICK_DT
        for real, yardstick in yardsticks.items():
            rows.append({
                "what": f"yardstick, {real}", "real": real, "runs": runs, "dt": dt, "plates": 240,
                "error_mm": truth.of_yardstick(yardstick, runs, dt), "place_mm": None,
            })  # fmt: skip
            timers.append(lambda y=yardstick, n=runs, dt=dt: y.seconds(n, dt, cases.DURATION))
        for name, worker in workers.items():
            if runs > 1 and name == PLAIN_XLA:
                continue
            detail = worker.ask("plain", case, detail=True)
            rows.append({
                "what": f"drftjax, {name}", "real": BESIDE[name], "runs": runs, "dt": case.dt,
                "plates": detail["plates"], "error_mm": truth.of(case, detail["z"]),
                "place_mm": truth.of_place(case, detail["x"]),
            })  # fmt: skip
            timers.append(lambda w=worker, c=case: w.ask("plain", c)["seconds"])
    times = [[timer() for timer in timers] for _ in range(repeats)]
    for row, taken in zip(rows, zip(*times, strict=True), strict=True):
        row["seconds"], row["median"] = min(taken), statistics.median(taken)
        row["us_per_run_step"] = 1e6 * min(taken) / row["runs"] / round(cases.DURATION / row["dt"])
    for row in rows:
        (beside,) = (
            r["seconds"] for r in rows
            if r["runs"] == row["runs"] and r["what"] == f"yardstick, {row['real']}"
        )  # fmt: skip
        row["ratio"] = row["seconds"] / beside
    return rows


def gradients(workers: dict[str, Worker], repeats: int) -> list[dict[str, Any]]:
    """Cost of derivatives of the single run, over the run's own."""
    rows = []
    for name, worker in workers.items():
        kinds = ("plain", "eight", "reverse")
        detail = {kind: worker.ask(kind, cases.SINGLE, detail=True) for kind in kinds}
        times = [
            [worker.ask(kind, cases.SINGLE)["seconds"] for kind in kinds] for _ in range(repeats)
        ]
        least = dict(zip(kinds, np.min(times, axis=0).tolist(), strict=True))
        rows += [
            {
                "what": f"drftjax, {name}", "kind": kind, "seconds": least[kind],
                "ratio": least[kind] / least["plain"], "memory": detail[kind]["memory"],
                "finite": detail[kind]["finite"],
            }
            for kind in kinds
        ]  # fmt: skip
    return rows


def study(worker: Worker, yardstick: Yardstick, truth: Truth) -> list[dict[str, Any]]:
    """Error of z against step, for the single run and for the many."""
    rows, checked = [], cases.CHECKED
    for dt in cases.STUDY_STEPS:
        both = [truth.of_yardstick(yardstick, runs, dt) for runs in (1, cases.CHECKED)]
        rows.append({"what": "yardstick", "plate_size": None, "dt": dt, "errors_mm": both})
    for size in cases.STUDY_PLATES:
        for dt in cases.STUDY_STEPS:
            row = 0.02 if dt in (1e-3, 2e-3, 4e-3, 5e-3, 1e-2) else 0.1
            pair = [Case(1, dt, size, row), Case(checked, dt, size)]
            errors = [truth.of(case, worker.ask("plain", case, True)["z"]) for case in pair]
            rows.append({"what": "drftjax", "plate_size": size, "dt": dt, "errors_mm": errors})
    return rows


def errors(figures: list[float]) -> str:
    """One figure, or those of the median and the worst run."""
    return " - ".join(f"{figure:.3f}" if figure < 1 else f"{figure:.1f}" for figure in figures)


def speed_table(rows: list[dict[str, Any]], cores: int) -> Table:
    table = Table(title=f"The 24 s profile on {cores} cores (a single run uses one)")
    for heading in ("runs", "program", "step", "plates", "error of z", "of the final x",
                    "least", "median", "a run-step", "over the yardstick"):  # fmt: skip
        table.add_column(heading, justify="left" if heading == "program" else "right")
    runs = 1
    for row in rows:
        if row["runs"] != runs:
            runs = row["runs"]
            table.add_section()
        table.add_row(
            str(row["runs"]), row["what"], f"{1e3 * row['dt']:g} ms",
            str(row["plates"]), errors(row["error_mm"]) + " mm",
            "not told" if row["place_mm"] is None else f"{row['place_mm']:.2f} mm",
            f"{1e3 * row['seconds']:.1f} ms",
            f"{1e3 * row['median']:.1f} ms", f"{row['us_per_run_step']:.3f} us",
            f"{row['ratio']:.2f}",
        )  # fmt: skip
    return table


GRADIENT_NAMES = {
    "plain": "the run itself",
    "eight": "the run and its derivatives by eight numbers",
    "reverse": "reverse, a loss by zeta and lambda",
}


def gradient_table(rows: list[dict[str, Any]]) -> Table:
    table = Table(title=f"Derivatives of the single run, {1e3 * cases.SINGLE.dt:g} ms steps")
    for heading in ("program", "derivative", "least", "over the run", "working memory"):
        table.add_column(
            heading, justify="left" if heading in ("program", "derivative") else "right"
        )
    for row in rows:
        name = GRADIENT_NAMES[row["kind"]] + ("" if row["finite"] else ": NOT FINITE")
        table.add_row(
            row["what"], name, f"{1e3 * row['seconds']:.1f} ms", f"{row['ratio']:.2f}",
            f"{row['memory'] / 2**20:.2f} MiB" if row["memory"] is not None else "not said",
        )  # fmt: skip
    return table


def study_table(rows: list[dict[str, Any]]) -> Table:
    table = Table(
        title="Largest error of z in mm against the step: single run | median - worst of many"
    )
    table.add_column("program")
    for dt in cases.STUDY_STEPS:
        table.add_column(f"{1e3 * dt:g} ms", justify="right")
    lines: dict[str, list[str]] = {}
    for row in rows:
        size = row["plate_size"]
        name = row["what"] + (f", {1e3 * size:g} mm plates" if size else ", 240 plates")
        lines.setdefault(name, []).append(" | ".join(errors(each) for each in row["errors_mm"]))
    for name, cells in lines.items():
        table.add_row(name, *cells)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the simulator beside the C++ yardstick.")
    parser.add_argument("-o", "--output", type=Path, help="write every figure to this JSON file")
    parser.add_argument("--repeats", type=int, default=9, help="how often everything is timed")
    parser.add_argument(
        "--study", action="store_true", help="also study steps and plates (minutes)"
    )
    parser.add_argument("--many", action="store_true", help="also 4,096 runs, once (minutes)")
    options = parser.parse_args()
    console = Console(width=None if sys.stdout.isatty() else 150)
    here = machine()
    with tempfile.TemporaryDirectory() as folder:
        try:
            if not SHARED.is_dir():
                raise Unavailable("there is no folder ../shared with the yardstick and references")
            source = SHARED / "yardstick" / "drft.cpp"
            reals = ("float", "double")
            yardsticks = {real: Yardstick(source, Path(folder), real) for real in reals}
        except Unavailable as reason:
            console.print(f"skipped: {reason}")
            return
        workers = {name: Worker(*how, here["cores"]) for name, how in WORKERS.items()}
        try:
            truth = Truth(workers["float64"])
            result: dict[str, Any] = {"machine": here, "repeats": options.repeats}
            console.print(f"{here['cpu']}, {here['cores']} cores, least of {options.repeats}")
            ensemble, many = cases.ENSEMBLES
            rows = speeds(workers, yardsticks, truth, options.repeats, (cases.SINGLE, ensemble))
            if options.many:
                rows += speeds(workers, yardsticks, truth, 1, (many,))
            result["speed"] = rows
            console.print(speed_table(result["speed"], here["cores"]))
            result["gradients"] = gradients(workers, options.repeats)
            console.print(gradient_table(result["gradients"]))
            if options.study:
                result["study"] = study(workers["float64"], yardsticks["float"], truth)
                console.print(study_table(result["study"]))
        finally:
            for worker in workers.values():
                worker.close()
    if options.output:
        options.output.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
