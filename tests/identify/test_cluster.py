"""Fits on a Dask cluster: the same numbers as in one process, and nothing lost by any kill."""

import dataclasses
import json
import os
import signal
import socket
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from drftjax.cluster import connection
from drftjax.cluster.connection import (
    ClusterSettings,
    LocalWorkers,
    RemoteScheduler,
    connect,
    parse_address,
)
from drftjax.cluster.pieces import LogFile
from drftjax.cluster.store import FinishedWork, WorkStore
from drftjax.common.errors import InputError
from drftjax.recorded.prepared_run import prepare_run
from drftjax.runlog.hdf5.api import read_result, read_run, write_run
from drftjax.setups.fitted_model import FIT_SCHEMA
from identify.cluster.fit_options import (
    FIT_STORE,
    FitOptions,
    ParameterSpec,
    fit_parameters,
    parameter_specs,
)
from identify.cluster.lone_fits import fit_on
from identify.cluster.result_codec import SingleRunResult, decode_result
from identify.cluster.worker import fit_logs, fit_replies
from identify.fit_constant import fit
from identify.parameters.parameter import parameter
from identify.results.result import FitResult
from identify.uncertainty.noise_model import Autoregressive
from tests.helpers.synthetic_runs import recorded, setup_of

# Two programs compiled for other numbers of devices may round otherwise.
SAME = 1e-9
# So short that fits converge; where they stall on rough ground, their end hangs on the last bit.
STEP = 5e-4
PROFILE = ([0.0, 0.1, 0.6, 0.8], [0.0, 0.0, 0.5, 0.5])
PRIOR = (0.8, 0.01)
START = 0.79
ZETA = ParameterSpec("terrain.zeta", None, PRIOR, START)
# Every entry that can be told in the result differs from its default.
SETTINGS = FitOptions((ZETA,), noise="autoregressive", step=STEP)
RUNS = 8


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    first = recorded(setup_of(PROFILE, 0.74), 0)
    for number in range(RUNS):
        x, z = (
            values + 20e-6 * np.random.default_rng(number).standard_normal(len(values))
            for values in (first.measured.x, first.measured.z)
        )
        measured = dataclasses.replace(first.measured, x=x, z=z)
        write_run(folder / f"run{number:02}.h5", dataclasses.replace(first, measured=measured))
    return folder


@pytest.fixture(scope="module")
def logs(folder) -> list[LogFile]:
    return [LogFile.at(path) for path in sorted(folder.glob("run*.h5"))]


@pytest.fixture(scope="module")
def client():
    with connect(LocalWorkers(2)) as client:
        yield client


@cache
def alone(path: Path) -> FitResult:
    """A run fitted by this process, with nothing of what makes tasks of it."""
    each = prepare_run(path.stem, read_run(path), step=STEP)
    return fit(
        [each], [parameter("zeta", shared=False, prior=PRIOR, start=START)], noise=Autoregressive()
    )


def silent(done: int, workers: int) -> None:
    pass


def check_same(result: SingleRunResult, other: FitResult) -> None:
    ours, theirs = result.run, other.runs[0]
    for name, value in theirs.values.items():
        assert ours.values[name].value == pytest.approx(value.value, rel=SAME, abs=0)
        assert ours.values[name].error == pytest.approx(value.error, rel=SAME, abs=0)
    for what in ("time", "recorded", "before", "after"):
        np.testing.assert_allclose(getattr(ours, what), getattr(theirs, what), rtol=0, atol=SAME)
    assert (result.status, result.steps) == (other.status, other.steps)


def test_cluster_finds_what_one_process_finds(client, logs, tmp_path):
    with WorkStore(tmp_path / "fit.store", FIT_STORE, SETTINGS.plain_values()) as store:
        assert fit_on(client, logs, SETTINGS, store, silent) == {}
        assert len(store) == RUNS
        for log in logs[:2]:
            check_same(decode_result(store.result(log.digest)), alone(log.path))


def test_a_log_does_not_hang_on_its_neighbours_in_a_task(logs):
    encoded = SETTINGS.encoded()
    sent = [(log.digest, log.read()) for log in logs[:3]]
    together = [each.result for each in fit_replies(fit_logs(encoded, sent))]
    apart = [fit_replies(fit_logs(encoded, [each]))[0].result for each in reversed(sent)]
    assert together == apart[::-1]


def test_parameters_are_the_same_on_the_wire(tmp_path):
    given = [
        parameter("zeta", shared=False, bounds=(0.5, 1.0), prior=PRIOR, start=0.7),
        parameter("lambda", shared=False),
        parameter("rig.mass_z", shared=False),
    ]
    settings = FitOptions(parameter_specs(given))
    # Two NaN are not equal, but read alike.
    assert repr(fit_parameters(settings.encoded())) == repr(given)
    assert fit_parameters(settings.encoded()) is fit_parameters(settings.encoded())


def test_a_killed_worker_loses_nothing(client, logs, tmp_path):
    pids = list(client.run(os.getpid).values())
    killed = []

    def report(done: int, workers: int) -> None:
        if done and not killed:
            killed.append(pids[0])
            os.kill(pids[0], signal.SIGKILL)

    with WorkStore(tmp_path / "fit.store", FIT_STORE, SETTINGS.plain_values()) as store:
        assert fit_on(client, logs, SETTINGS, store, report) == {}
        assert killed
        assert {log.digest for log in logs if log.digest in store} == {log.digest for log in logs}
        check_same(decode_result(store.result(logs[0].digest)), alone(logs[0].path))
        last, here = decode_result(store.result(logs[-1].digest)), alone(logs[-1].path)
        assert (last.status, last.steps) == (here.status, here.steps)
        check_same(last, here)


def test_a_killed_call_goes_on_where_it_ended_and_names_bad_files(drft, folder, logs, tmp_path):
    stem = tmp_path / "fit"
    store = tmp_path / "fit.store"
    bad, gone = tmp_path / "bad.h5", tmp_path / "gone.h5"
    bad.write_bytes(b"no run log")
    toml = tmp_path / "fit.toml"
    toml.write_text(f'[[parameter]]\nname = "zeta"\nprior = {list(PRIOR)}\nstart = {START}\n')
    arguments = [
        *("fit", bad, *sorted(folder.glob("run*.h5")), gone, "--cluster", "local:1"),
        *("--step", STEP, "--autoregressive", "--parameters", toml),
    ]
    command = [sys.executable, "-m", "drftjax.commands.main", *map(str, arguments), "-o", str(stem)]
    driver = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 50
    while not store.exists() or store.read_bytes().count(b"\n") < 2:
        assert time.monotonic() < deadline
        assert driver.poll() is None
        time.sleep(0.01)
    driver.kill()
    driver.wait()
    kept = store.read_bytes()
    done = kept.count(b"\n") - 1
    assert done < RUNS
    # As if it had been killed while it wrote.
    store.write_bytes(kept + kept.splitlines()[1][:200])

    answer = drft(*arguments, "-o", stem)
    assert answer.code == 0, answer
    assert f"has {done} of these {RUNS + 2} runs" in answer.out
    assert "dashboard: http://127.0.0.1:" in answer.out
    assert f"{RUNS + 1 - done}/{RUNS + 1 - done}" in answer.out
    assert f"left out: {bad}: is not an HDF5 file" in answer.out
    assert f"left out: {gone}: there is no such file" in answer.out
    assert store.read_bytes().startswith(kept)
    lines = [json.loads(line) for line in store.read_bytes().splitlines()[1:]]
    assert sorted(line["digest"] for line in lines) == sorted(log.digest for log in logs)
    document = json.loads((tmp_path / "fit.json").read_text())
    assert set(document["failures"]) == {"bad", "gone"}
    assert [run["name"] for run in document["runs"]] == [log.path.stem for log in logs]
    assert len(read_result(tmp_path / "fit.h5", FIT_SCHEMA).groups) == RUNS
    zeta = alone(logs[0].path).runs[0].values["terrain.zeta"].value
    assert document["runs"][0]["values"]["terrain.zeta"]["value"] == pytest.approx(zeta, rel=SAME)
    # All is done: no cluster is needed.
    bad.unlink()
    again = drft(*arguments, "-o", stem)
    assert again.code == 0, again
    assert "dashboard" not in again.out


@pytest.mark.parametrize(
    "address",
    [
        "locale",
        "local:",
        "local:0",
        "local:-1",
        "local:two",
        "local:999999",
        "local:" + "9" * 400,
        "tcp://",
        "tcp://host",
        "tcp://host:0",
        "tcp://host:99999",
        "tcp://host:80/path",
        "http://host:80",
        "127.0.0.1:8786",
        "",
        "local\n",
    ],
)
def test_malformed_addresses_are_refused(drft, folder, tmp_path, address):
    answer = drft("fit", folder / "run00.h5", "--cluster", address, "-o", tmp_path / "fit")
    assert "--cluster" in answer.refusal
    assert not list(tmp_path.iterdir())


def test_addresses():
    assert parse_address("local") == LocalWorkers(os.cpu_count())
    assert parse_address("local:1") == LocalWorkers(1)
    assert parse_address("tcp://10.0.0.1:8786") == RemoteScheduler("tcp://10.0.0.1:8786")
    assert parse_address("tcp://[::1]:8786") == RemoteScheduler("tcp://[::1]:8786")


def test_a_scheduler_that_does_not_answer_is_given_up(drft, folder, tmp_path, monkeypatch):
    quick = ClusterSettings(connect_limit=1.0)
    monkeypatch.setattr(connection, "CLUSTER_SETTINGS", quick)
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        arguments = "fit", folder / "run00.h5", "-o", tmp_path / "fit", "--cluster"
        address = f"tcp://127.0.0.1:{mute.getsockname()[1]}"
        assert "no Dask scheduler answers" in drft(*arguments, address).refusal
        mute.listen()
        assert "no Dask scheduler answers" in drft(*arguments, address).refusal
    assert "no Dask scheduler" in drft(*arguments, "tcp://no-such-host.invalid:1").refusal


def test_without_workers_a_cluster_is_given_up(logs, tmp_path):
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=0, dashboard_address=None) as empty,
        Client(empty) as client,
        WorkStore(tmp_path / "fit.store", FIT_STORE, SETTINGS.plain_values()) as store,
        pytest.raises(InputError, match="no worker"),
    ):
        fit_on(client, logs, SETTINGS, store, silent, ClusterSettings(worker_limit=0.5))


def test_a_lost_scheduler_is_one_sentence(logs, tmp_path):
    from distributed import Client, LocalCluster

    started = LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None)

    def report(done: int, workers: int) -> None:
        started.close()

    with (
        Client(started) as client,
        WorkStore(tmp_path / "fit.store", FIT_STORE, SETTINGS.plain_values()) as store,
        pytest.raises(InputError, match=r"the cluster is lost .* keeps the \d+ fits"),
    ):
        fit_on(client, logs, SETTINGS, store, report)


def test_without_dask_the_extra_is_named(drft, folder, tmp_path, monkeypatch):
    monkeypatch.setattr(connection.importlib.util, "find_spec", lambda name: None)
    answer = drft("fit", folder / "run00.h5", "--cluster", "local", "-o", tmp_path / "fit")
    assert "pip install '.[cluster]'" in answer.refusal


def test_what_has_no_meaning_on_a_cluster_is_refused(drft, folder, tmp_path):
    arguments = "fit", folder / "run00.h5", "--cluster", "local:1"
    assert "give -o" in drft(*arguments).refusal
    answer = drft(*arguments, "--share", "lambda", "--starts", "2", "-o", tmp_path / "fit")
    assert "leave --zeta, --starts" in answer.refusal


def test_workers_of_another_version_are_refused(logs):
    other = FitOptions((ZETA,), software="0.0.0")
    with pytest.raises(InputError, match=r"must have 0\.0\.0"):
        fit_logs(other.encoded(), [])


@pytest.fixture
def store(tmp_path) -> Path:
    """A store of two fits."""
    path = tmp_path / "fit.store"
    with WorkStore(path, FIT_STORE, SETTINGS.plain_values()) as kept:
        kept.append(FinishedWork(2 * name, "log.h5", {}, b"result") for name in "ab")
    return path


def refusal(path: Path, settings: FitOptions = SETTINGS) -> str:
    before = path.read_bytes()
    with pytest.raises(InputError) as refused:
        WorkStore(path, FIT_STORE, settings.plain_values())
    assert path.read_bytes() == before
    text = str(refused.value)
    assert str(path) in text
    assert "\n" not in text
    return text


def test_a_store_of_other_settings_is_refused(store):
    for name, value in [("zeta", 0.7), ("step", None), ("noise", "white")]:
        other = FitOptions(**{**SETTINGS.plain_values(), "parameters": (ZETA,), name: value})
        assert f"holds fits with {name}" in refusal(store, other)


def test_a_store_of_before_noise_models_had_names_is_gone_on_with(tmp_path):
    path = tmp_path / "fit.store"
    plain = SETTINGS.plain_values()
    before = {name: value for name, value in plain.items() if name != "noise"}
    with WorkStore(path, FIT_STORE, before | {"autoregressive": True}) as kept:
        kept.append([FinishedWork("aa", "log.h5", {}, b"result")])
    with WorkStore(path, FIT_STORE, plain) as kept:
        assert "aa" in kept
    other = FitOptions((ZETA,), noise="white", step=STEP)
    assert "holds fits with noise" in refusal(path, other)


def test_a_store_without_fits_is_begun_anew_with_other_settings(tmp_path):
    path = tmp_path / "fit.store"
    other = FitOptions((ZETA,), step=2e-3)
    for settings in (SETTINGS, other):
        with WorkStore(path, FIT_STORE, settings.plain_values()) as kept:
            assert len(kept) == 0
    with WorkStore(path, FIT_STORE, other.plain_values()) as kept:
        kept.append([FinishedWork("aa", "log.h5", {}, b"result")])
    assert "holds fits with" in refusal(path)


def test_any_flipped_byte_of_a_store_is_found(store):
    whole = store.read_bytes()
    for place in range(0, len(whole) - 1, 7):
        damaged = bytearray(whole)
        damaged[place] ^= 4
        store.write_bytes(damaged)
        assert "damaged" in refusal(store)


def test_a_store_cut_anywhere_goes_on(store):
    whole = store.read_bytes()
    for length in range(len(whole)):
        store.write_bytes(whole[:length])
        with WorkStore(store, FIT_STORE, SETTINGS.plain_values()) as kept:
            assert len(kept) == max(0, whole[:length].count(b"\n") - 1)
            kept.append([FinishedWork("bb", "log.h5", {}, b"result")])
        with WorkStore(store, FIT_STORE, SETTINGS.plain_values()) as kept:
            assert "bb" in kept
            assert kept.result("bb") == b"result"


def test_a_file_that_is_no_store_is_left_alone(tmp_path):
    path = tmp_path / "fit.store"
    for content in (b"measured by hand", b"\n", b"{}\n", b"\x00" * 100, b'{"crc32":"00000000",}\n'):
        path.write_bytes(content)
        assert "no store" in refusal(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(InputError, match="ordinary file"):
        WorkStore(path, FIT_STORE, {})


def test_a_store_in_use_is_refused(store):
    with WorkStore(store, FIT_STORE, SETTINGS.plain_values()):
        assert "in use" in refusal(store)


def test_an_interrupt_reaches_no_process_begun_for_the_cluster():
    """A terminal sends Ctrl-C to all of them; the one that was called ends the others."""
    asked = "import signal; print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))"

    def held() -> str:
        return subprocess.run(
            [sys.executable, "-c", asked], capture_output=True, text=True, check=True
        ).stdout.strip()

    with connection._without_interrupts():
        begun = held()
    assert (begun, held()) == ("True", "False")
    # A shell has what it runs in the background ignore the signal.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), connection._without_interrupts():
            # What came meanwhile is not lost.
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
