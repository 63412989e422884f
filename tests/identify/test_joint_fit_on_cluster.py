"""Fits of shared parameters on a Dask cluster: as in one process, and nothing lost by any kill."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drftjax.cluster.connection import LocalWorkers, connect
from drftjax.cluster.pieces import LogFile
from drftjax.cluster.store import FinishedWork, WorkStore
from drftjax.common.errors import InputError
from drftjax.recorded.prepared_run import prepare_run
from drftjax.runlog.hdf5.api import read_run, write_run
from identify.cluster import evaluator
from identify.cluster.fit_options import FIT_STORE, FitOptions, ParameterSpec
from identify.cluster.joint_fit import fit_together_on
from identify.fit_constant import fit
from identify.parameters.parameter import parameter
from identify.results.result import FitResult
from identify.solver.problem import IN_PROCESS
from identify.uncertainty.noise_model import Autoregressive
from tests.helpers.synthetic_runs import FAST_STEP, recorded, setup_of

# Programs compiled for other numbers of devices may round otherwise, and so do a QR of a run's rows
# and one of the rows of all.
SAME = 1e-9
# A fast wheel tells lambda; one run is shorter than the others, so that it is padded.
PROFILES = (
    ([0.0, 0.1, 0.4, 0.7], [0.0, 0.0, 4.0, 4.0]),
    ([0.0, 0.1, 0.5, 0.6], [0.0, 0.0, 5.0, 5.0]),
)
ZETAS = (0.70, 0.73, 0.76, 0.79, 0.82)
PRIOR = (2.0, 3.0)
LAMBDA = ParameterSpec("terrain.inertial_coefficient", (-20.0, 50.0), PRIOR, None, shared=True)
ZETA = ParameterSpec("terrain.zeta", None, None, None)
SETTINGS = FitOptions((LAMBDA, ZETA), noise="autoregressive", step=FAST_STEP)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    for number, zeta in enumerate(ZETAS):
        run = recorded(setup_of(PROFILES[number % 2], zeta), number)
        write_run(folder / f"run{number}.h5", run)
    return folder


@pytest.fixture(scope="module")
def logs(folder) -> dict[str, LogFile]:
    return {path.stem: LogFile.at(path) for path in sorted(folder.glob("*.h5"))}


@pytest.fixture(scope="module")
def alone(logs) -> FitResult:
    """The runs fitted by this process, with nothing of what makes tasks of them."""
    runs = [prepare_run(name, read_run(log.path), step=FAST_STEP) for name, log in logs.items()]
    shared = parameter("lambda", shared=True, prior=PRIOR)
    return fit(runs, [shared, parameter("zeta", shared=False)], noise=Autoregressive())


@pytest.fixture(scope="module")
def client():
    with connect(LocalWorkers(2)) as client:
        yield client


def store_at(path: Path) -> WorkStore:
    return WorkStore(path, FIT_STORE, SETTINGS.plain_values())


def check_same(ours: FitResult, theirs: FitResult) -> None:
    assert ours.labels == theirs.labels
    for label, value in theirs.values.items():
        assert ours.values[label].value == pytest.approx(value.value, rel=SAME, abs=0)
        assert ours.values[label].error == pytest.approx(value.error, rel=SAME, abs=0)
    scale = np.abs(theirs.covariance).max()
    np.testing.assert_allclose(ours.covariance, theirs.covariance, rtol=0, atol=SAME * scale)
    assert (ours.status, ours.steps, ours.findings) == (
        theirs.status,
        theirs.steps,
        theirs.findings,
    )
    for one, other in zip(ours.runs, theirs.runs, strict=True):
        assert (one.name, one.status) == (other.name, other.status)
        for what in ("before", "after"):
            np.testing.assert_allclose(getattr(one, what), getattr(other, what), atol=SAME)


@pytest.fixture(scope="module")
def together(client, logs, tmp_path_factory) -> tuple[FitResult, Path]:
    """The runs fitted by the cluster, and the store of that fit."""
    path = tmp_path_factory.mktemp("together") / "fit.store"
    with store_at(path) as store:
        return fit_together_on(client, logs, SETTINGS, store), path


def test_shared_and_own_numbers_are_those_of_one_process(together, alone):
    found, _ = together
    check_same(found, alone)
    # The runs' own zeta are a random effect: they scatter as the sands do.
    assert any("zeta is 0.7" in each and "from run to run" in each for each in found.findings)
    # The fit can be asked for more without the cluster.
    assert found.estimate is not None
    assert found.estimate.problem.evaluator is IN_PROCESS


def test_a_killed_worker_changes_nothing(client, logs, alone, tmp_path):
    killed = []

    def progress(stage: str, step: int, loss: float) -> None:
        if not killed:  # what it held of the runs and of this step is lost with it
            killed.extend(client.run(os.getpid).values())
            os.kill(killed[0], signal.SIGKILL)

    with store_at(tmp_path / "fit.store") as store:
        found = fit_together_on(client, logs, SETTINGS, store, progress=progress)
    assert killed
    check_same(found, alone)


def test_steps_in_the_store_are_not_made_again(client, logs, alone, together, monkeypatch):
    _, path = together
    kept = path.read_bytes()

    def refuse(_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(evaluator, "condensed_rows", refuse)
    with store_at(path) as store:
        check_same(fit_together_on(client, logs, SETTINGS, store), alone)
    assert path.read_bytes() == kept
    # Numbers for people: the shared parameter at each step.
    values = [json.loads(line)["values"] for line in kept.splitlines()[1:]]
    assert all(list(each) == ["terrain.inertial_coefficient"] for each in values)


def test_a_killed_call_goes_on_where_it_ended_and_names_bad_files(drft, folder, alone, tmp_path):
    stem, store, bad = tmp_path / "fit", tmp_path / "fit.store", tmp_path / "bad.h5"
    bad.write_bytes(b"no run log")
    toml = tmp_path / "fit.toml"
    toml.write_text(
        f'[[parameter]]\nname = "lambda"\nshared = true\nprior = {list(PRIOR)}\n'
        '[[parameter]]\nname = "zeta"\n'
    )
    arguments = [
        *("fit", bad, *sorted(folder.glob("*.h5")), "--cluster", "local:1", "-o", stem),
        *("--step", FAST_STEP, "--autoregressive", "--parameters", toml),
    ]
    command = [sys.executable, "-m", "drftjax.commands.main", *map(str, arguments)]
    driver = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 100
    while not store.exists() or store.read_bytes().count(b"\n") < 3:
        assert time.monotonic() < deadline
        assert driver.poll() is None
        time.sleep(0.01)
    driver.kill()
    driver.wait()
    kept = store.read_bytes()
    steps = kept.count(b"\n") - 1

    answer = drft(*arguments)
    assert answer.code == 0, answer
    assert f"has {steps} steps of the solver" in answer.out
    assert f"left out: {bad}: is not an HDF5 file" in answer.out
    assert store.read_bytes().startswith(kept)
    document = json.loads((tmp_path / "fit.json").read_text())
    assert set(document["failures"]) == {"bad"}
    for label, value in alone.shared.items():
        ours = document["shared"][label]
        assert ours["value"] == pytest.approx(value.value, rel=SAME)
        assert ours["error"] == pytest.approx(value.error, rel=SAME)


def test_a_lost_scheduler_is_one_sentence(logs, tmp_path):
    from distributed import Client, LocalCluster

    started = LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None)

    def prepared(done: int, workers: int) -> None:
        if done == len(logs):
            started.close()

    with (
        Client(started) as client,
        store_at(tmp_path / "fit.store") as store,
        pytest.raises(InputError, match="the cluster is lost"),
    ):
        fit_together_on(client, logs, SETTINGS, store, prepared)


def test_runs_that_kill_their_workers_end_the_fit_with_one_sentence(client, tmp_path):
    from distributed.scheduler import KilledWorker

    def gather(tasks: object) -> None:
        raise KilledWorker("task", None, 3)

    with store_at(tmp_path / "fit.store") as store:
        place = evaluator.OnCluster(client, SETTINGS, store)
        place._watch.client = SimpleNamespace(gather=gather)  # pyright: ignore
        with pytest.raises(InputError, match="every worker that simulated one of the chunks"):
            place._gather([])


def test_a_store_of_lone_fits_takes_no_fit_of_all_together(drft, folder, tmp_path):
    path = tmp_path / "fit.store"
    alone = FitOptions((ZETA,), step=FAST_STEP)
    with WorkStore(path, FIT_STORE, alone.plain_values()) as store:
        store.append([FinishedWork("aa", "log.h5", {}, b"result")])
    run = folder / "run0.h5"
    answer = drft("fit", run, "--share", "lambda", "--cluster", "local:1", "-o", tmp_path / "fit")
    assert "holds fits with parameters" in answer.refusal
