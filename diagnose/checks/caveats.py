"""Limits of what the runs of a dataset can show, whatever the diagnosis."""

from diagnose.dataset import RigDataset
from drftjax.recorded.observation import comparable_channels
from drftjax.recorded.repeats import group_by_condition


def caveats(dataset: RigDataset) -> list[str]:
    """Limits of what these runs can show, in sentences."""
    return [
        *_condition_sentences(dataset),
        *_channel_sentences(dataset),
        *_origin_sentences(dataset),
    ]


def _origin_sentences(dataset: RigDataset) -> list[str]:
    origin = dataset.runs[0].setup.start.origin
    if not origin:
        return []
    return [f"x = 0 is {origin:.4g} m of the recorded x, where the run nearest to zero starts."]


def _condition_sentences(dataset: RigDataset) -> list[str]:
    if len(dataset.runs) == 1:
        return [
            "One run only: nothing can be predicted that was not fitted, and no repeat shows what "
            "is chance; what follows is a description of this run, not a finding."
        ]
    if len(group_by_condition(dataset.runs)) == 1:
        return [
            "All runs have one command and load: no run of another condition checks the effect."
        ]
    return []


def _channel_sentences(dataset: RigDataset) -> list[str]:
    """Channels that are prescribed, missing in all runs or in some, or not compared."""
    driven = dataset.runs[0].setup.rig.carriage == "driven"
    notes = []
    if driven:
        notes.append(
            "The carriage was driven: x is given, and effects show in sinkage, forces and torque."
        )
    for channel in comparable_channels(driven):
        lacking = [c.name for c in dataset.runs if channel not in c.observation.channels]
        # Torque of a free carriage is more than most rigs record.
        if len(lacking) == len(dataset.runs) and (driven or channel != "torque"):
            notes.append(f"No run has {channel}: effects that show in it cannot be told apart.")
        elif lacking and len(lacking) < len(dataset.runs):
            lack = "lacks" if len(lacking) == 1 else "lack"
            note = f"{', '.join(lacking)} {lack} {channel}, which other runs have"
            unplaced = "; taken to start at x = 0, wherever that was" if channel == "x" else ""
            notes.append(f"{note}{unplaced}.")
    forces = [each for each in ("fx", "fz") if each in dataset.channels]
    if forces and not driven:
        are = "is" if len(forces) == 1 else "are"
        notes.append(
            f"{' and '.join(forces)} of the free carriage {are} compared less its inertia: what is "
            "left holds the carriage, or weighs on it, on any sand."
        )
    unused = sorted({channel for c in dataset.runs for channel in c.observation.unused})
    if unused and not driven:
        was = "was" if len(unused) == 1 else "were"
        in_loop = any(each.made_in_loop is not None for each in dataset.runs)
        why = ": the loop drove the carriage" if in_loop else ""
        notes.append(f"{', '.join(unused)} {was} recorded and not compared{why}.")
    return notes
