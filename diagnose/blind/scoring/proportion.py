"""Shares of a count, with how far chance may have moved them."""

from dataclasses import dataclass
from math import sqrt
from statistics import NormalDist

CONFIDENCE = 0.90


@dataclass(frozen=True)
class Proportion:
    """So many of so many.

    Attributes:
        hits, of: The counts.
    """

    hits: int
    of: int

    @property
    def value(self) -> float | None:
        """The share; none of nothing."""
        return self.hits / self.of if self.of else None

    def interval(self) -> tuple[float, float] | None:
        """Wilson's 90 % interval of a binomial share (E. B. Wilson 1927, JASA 22:209)."""
        if not self.of:
            return None
        z = NormalDist().inv_cdf((1 + CONFIDENCE) / 2)
        share, spread = self.hits / self.of, z**2 / self.of
        centre = (share + spread / 2) / (1 + spread)
        half = sqrt(share * (1 - share) * spread + spread**2 / 4) / (1 + spread)
        return max(0.0, centre - half), min(1.0, centre + half)

    def document(self) -> dict:
        """As a result file holds it."""
        return {
            "hits": self.hits,
            "of": self.of,
            "share": self.value,
            "interval_90": self.interval(),
        }

    def __str__(self) -> str:
        interval = self.interval()
        if interval is None:
            return "-"
        low, high = (100 * each for each in interval)
        return f"{100 * self.hits / self.of:.0f} % ({low:.0f}-{high:.0f})"
