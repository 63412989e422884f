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
    """What a model file adds to the reference model.

    Attributes:
        effects: With their numbers.
        origin: Recorded x that the effects' x = 0 stands for [m]; None where the file says nothing.
        kind: Its wheel and carriage, in words.
    """

    effects: tuple[AbstractEffect, ...]
    origin: float | None
    kind: str

    def caveats(self, candidates: Sequence[PreparedRun]) -> list[str]:
        """What these runs' rig has otherwise than the model, in sentences."""
        kind = describe_rig(candidates[0].setup)
        if kind == self.kind or not self.effects:
            return []
        return [
            f"The model was found for {self.kind}, these runs are of {kind}: whether the effects "
            "are the same there is not known."
        ]


def read_model_file(path: Path) -> ModelFile:
    """The effects of a model file, and where they count from.

    Raises:
        InputError: names the file, the entry and what must hold.
    """
    if path.suffix.lower() == ".json" and read_document(path).get("schema") == SCHEMA:
        raise InputError(f"{path}: is a diagnosis; give its model.toml")
    setup = read_setup(path)
    effects = tuple(
        build_effects(entry, place) for place, entry in enumerate(setup.effects, start=1)
    )
    return ModelFile(effects, setup.start.origin, describe_rig(setup))
