"""Read a model file that a diagnosis wrote."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from diagnose.result import SCHEMA
from diagnose.rig_runs import describe_rig
from drftjax.common.errors import InputError
from drftjax.common.structured_files import read_document
from drftjax.effects.base import AbstractEffect
from drftjax.effects.serialization import build_effects
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.setups.setup import read_setup


@dataclass(frozen=True)
class ModelFile:
    """Effects that a model file adds to the reference model.

    Attributes:
        effects: With their numbers.
        origin: Recorded x at which the effects' x is 0 [m]; None where the file does not give it.
        rig: Its wheel and carriage, in words.
    """

    effects: tuple[AbstractEffect, ...]
    origin: float | None
    rig: str

    def caveats(self, runs: Sequence[PreparedRun]) -> list[str]:
        """One sentence where the runs' rig is another one than the model's; empty otherwise."""
        rig = describe_rig(runs[0].setup)
        if rig == self.rig or not self.effects:
            return []
        return [
            f"The model was found for {self.rig}, these runs are of {rig}: whether the effects "
            "are the same there is not known."
        ]


def read_model_file(path: Path) -> ModelFile:
    """Read the effects of a model file, and the origin of their x.

    Raises:
        InputError: where it is no set-up file, or an effect is not known or cannot be built; the
            message names the file and the entry.
    """
    if path.suffix.lower() == ".json" and read_document(path).get("schema") == SCHEMA:
        raise InputError(f"{path}: is a diagnosis; give its model.toml")
    setup = read_setup(path)
    effects = tuple(
        build_effects(entry, place) for place, entry in enumerate(setup.effects, start=1)
    )
    return ModelFile(effects, setup.start.origin, describe_rig(setup))
