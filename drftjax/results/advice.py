"""Advice of a diagnosis on the next run, as its JSON file holds it and in words."""

import msgspec

_NAMES = {"none": "the reference model", "unknown": "something that is not known here"}


class ProposedRun(msgspec.Struct, frozen=True):
    """Run, or channel of a run, that tells hypotheses apart.

    Attributes:
        run: The run in words.
        channel: The channel in which the hypotheses differ.
        difference: By so much, in `unit`.
        unit: Of the difference.
        floors: The same in noise floors.
    """

    run: str
    channel: str
    difference: float
    unit: str
    floors: float


class NextRunAdvice(msgspec.Struct, frozen=True):
    """Entry `next_run` of a diagnosis.

    Attributes:
        tells: Hypotheses that it tells apart, the first from the others; none where there is no
            need.
        run: The run to make.
        channel: The channel to record on a run as made.
    """

    tells: tuple[str, ...] = ()
    run: ProposedRun | None = None
    channel: ProposedRun | None = None

    def sentences(self) -> list[str]:
        """The run or channel that would tell the hypotheses apart, in one sentence."""
        if not self.tells:
            return []
        first, *others = (" with ".join(map(worded, each.split("+"))) for each in self.tells)
        second = " and from ".join(others)
        named = ((self.run, "run {0.run}"), (self.channel, "record {0.channel} on {0.run}"))
        proposals = [
            f"{words.format(each)}, where {each.channel} differs by {each.difference:.3g} "
            f"{each.unit} ({each.floors:.1f} noise floors)"
            for each, words in named
            if each is not None
        ]
        if not proposals:
            return [f"No variation of these runs would tell {first} from {second}."]
        return [f"To tell {first} from {second}: {'; or '.join(proposals)}."]


def worded(name: str) -> str:
    """Name of an effect, of no effect or of an unknown one, in a sentence."""
    return _NAMES.get(name, name)
