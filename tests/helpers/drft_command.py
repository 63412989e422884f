"""`drft` run inside the process of the test: its output and its exit code."""

import re
import sys
from dataclasses import dataclass

import jax
import pytest

from drftjax.commands.main import main

# What a slow machine hears while it works (`drftjax.commands.progress`).
PROGRESS = re.compile(r".* \(\d+ s\)\n")


@dataclass(frozen=True)
class Answer:
    """Exit code, output and error output of a program, without its lines of progress."""

    code: int
    out: str
    err: str

    @property
    def refusal(self) -> str:
        """Sentence of a refusal, without its "drft: "."""
        assert self.code == 2, self
        assert self.err.startswith("drft: "), self
        assert self.err.count("\n") == 1, self
        assert self.err.endswith("\n"), self
        return self.err.removeprefix("drft: ").rstrip("\n")


class Drft:
    """`drft`, to be called with its arguments."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
        self._monkeypatch, self._capsys = monkeypatch, capsys
        monkeypatch.setenv("COLUMNS", "200")
        jax.devices()  # so that no command splits the CPU again, and programs compile once

    def __call__(self, *arguments: object) -> Answer:
        self._monkeypatch.setattr(sys, "argv", ["drft", *map(str, arguments)])
        self._capsys.readouterr()
        with pytest.raises(SystemExit) as end:
            main()
        out, err = self._capsys.readouterr()
        lines = err.splitlines(keepends=True)
        err = "".join(line for line in lines if not PROGRESS.fullmatch(line))
        code = end.value.code
        return Answer(code if isinstance(code, int) else int(code is not None), out, err)
