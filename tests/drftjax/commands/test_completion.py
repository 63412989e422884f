"""Completion in a shell: the names are all there, and JAX is not imported for them."""

import os
import subprocess
import sys

import pytest

from drftjax.commands.options import CHANNEL_NAMES, complete_effects, effect_names, tuner_names
from drftjax.effects.catalogue import catalogue
from drftjax.runlog.record import CHANNELS
from drftjax.tuning.registry import tuners

# Modules that take longer to import than a user waits for a key.
SLOW = ("jax", "equinox", "numpy", "matplotlib")


def test_names_of_effects_and_tuners_are_those_of_the_registries():
    assert sorted(effect_names()) == sorted(catalogue())
    assert sorted(tuner_names()) == sorted(tuners())
    assert CHANNEL_NAMES == CHANNELS


def test_the_last_of_several_effects_is_completed():
    assert complete_effects("loosening,bulld") == ["loosening,bulldozing"]
    assert "loosening" in complete_effects("")


def completed(words: str) -> tuple[list[str], str]:
    """Answers to a press of Tab after these words, and the slow modules that it imported."""
    program = (
        "import sys, atexit\n"
        f"atexit.register(lambda: print(*(set({SLOW}) & set(sys.modules)), file=sys.stderr))\n"
        "from drftjax.commands.main import main\nmain()"
    )
    environment = os.environ | {
        "_DRFT_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split(" ")) - 1),
    }
    answer = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True
    )
    return answer.stdout.split(), answer.stderr.strip()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("drft diag", ["diagnose"]),
        ("drft effects slip_so", ["slip_softening"]),
        ("drft diagnose runs --effects loosening,bulld", ["loosening,bulldozing"]),
        ("drft hils run --tuner k", ["kalman"]),
        ("drft hils run --mode f", ["free"]),
        ("drft fit runs --zeta pa", ["path"]),
        ("drft fit runs --compare f", ["fx", "fz"]),
    ],
)
def test_a_press_of_tab_completes_without_jax(words, expected):
    assert completed(words) == (expected, "")
