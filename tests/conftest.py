"""Set-up of JAX for the tests, the folder of reference data, and fixtures.

JAX reads these variables when it is first imported, and so do the programs that tests start; this
file itself does not import it.
"""

import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import psutil
import pytest

from drftjax.common.jax_config import with_options

if TYPE_CHECKING:
    from tests.helpers.drft_command import Drft

ROOT = Path(__file__).resolve().parents[1]

os.environ |= {
    "JAX_ENABLE_X64": "1",
    "JAX_NUMPY_DTYPE_PROMOTION": "strict",
    "JAX_NUM_CPU_DEVICES": "2",
    # Compiled programs outlive the run: the second run of the tests takes a fraction of the first.
    "JAX_COMPILATION_CACHE_DIR": str(ROOT / ".pytest_cache" / "jax"),
    # The least of them, too: every file of tests asks for the same hundred small ones.
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    # A compiled program needs no places in the source, which take a tenth of the time of a trace.
    "JAX_TRACEBACK_IN_LOCATIONS_LIMIT": "0",
    "MPLBACKEND": "agg",
    # As `drft` and the workers of a cluster have it: sums of other threads round otherwise.
    "OPENBLAS_NUM_THREADS": "1",
}
# As `drft` compiles, whichever test of a process comes first.
os.environ.setdefault("XLA_FLAGS", with_options(""))
# A run on an accelerator names it: JAX_PLATFORMS=cuda,cpu make test
os.environ.setdefault("JAX_PLATFORMS", "cpu")


# Files that take about a minute and more, the longest first: lest a worker is left alone with one.
LONGEST = (
    "diagnose/test_several_effects",
    "identify/test_profiles_bootstrap_multistart",
    "package/test_notebooks",
    "identify/test_posterior",
    "identify/test_design",
    "diagnose/change/test_comparison",
    "hils/commands/test_run",
    "diagnose/hypotheses/test_screening",
    "diagnose/test_missing_dynamic_terms",
    "diagnose/test_pipeline",
    "drftjax/effects/test_contract",
    "identify/test_cluster",
    "diagnose/next_runs/test_discrimination",
    "diagnose/hypotheses/test_set_screening",
    "identify/test_fit_path_jointly",
    "diagnose/test_api",
    "identify/test_screening",
    "identify/test_joint_fit_on_cluster",
    "diagnose/test_driven_carriage",
    "drftjax/simulation/test_reference_rigs",
    "identify/test_fit_constant",
    "identify/test_unmodified_rig",
    "identify/test_outliers",
    "identify/test_zeta_path",
    "identify/test_priors",
)


def _named(path: Path) -> str:
    return path.relative_to(ROOT / "tests").with_suffix("").as_posix()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    places = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(_named(item.path), len(places)))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    from tests.helpers.scheduling import ByPackage

    return ByPackage(config, log)


def pytest_collection_finish() -> None:
    """Have Python look for unused objects less often, and not among what was imported.

    A trace of JAX makes objects by the hundred thousand, which mostly stay.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder `shared` beside the repository, with the reference runs and measurements."""
    folder = ROOT.parent / "shared"
    if not folder.is_dir():
        pytest.skip("there is no folder ../shared with the reference runs beside the repository")
    return folder


@pytest.fixture
def compiled() -> Iterator[list[str]]:
    """List that collects the compilations that a test causes."""
    from jax import monitoring

    found = []

    def listen(event: str, _: float, **__: object) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            found.append(event)

    monitoring.register_event_duration_secs_listener(listen)
    yield found
    monitoring.unregister_event_duration_listener(listen)


@pytest.fixture
def drft(monkeypatch, capsys) -> "Drft":
    """`drft` run inside the process of the test."""
    from tests.helpers.drft_command import Drft

    return Drft(monkeypatch, capsys)


# Memory of a worker beyond which it frees its compiled programs [bytes]: three workers leave room
# beside them on a machine of 8 GB. To trace and load programs anew takes time.
HELD = 1e9


@pytest.fixture(scope="module", autouse=True)
def compiled_programs_go_before_they_fill_the_memory():
    """Free the compiled programs after a file with which a worker holds too much."""
    yield
    if _memory_held() > HELD and "jax" in sys.modules:
        sys.modules["jax"].clear_caches()
        gc.collect()
        _memory_held()


def _memory_held() -> int:
    """Memory of this process [bytes], once what it freed has gone back to the system."""
    if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):  # of the GNU C library
        trim(0)
    return psutil.Process().memory_info().rss
