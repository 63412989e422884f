"""Threads for the tests of the diagnosis's steps."""

from collections.abc import Iterator

import pytest

from diagnose.run_pool import RunPool


@pytest.fixture(scope="session")
def pool() -> Iterator[RunPool]:
    with RunPool() as pool:
        yield pool
