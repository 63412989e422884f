"""Binomial proportions and their intervals."""

from dataclasses import dataclass
from math import sqrt
from statistics import NormalDist

# Confidence of the intervals; the files name it in `interval_90`.
INTERVAL_CONFIDENCE = 0.90


@dataclass(frozen=True)
class Proportion:
    """Proportion of hits.

    Attributes:
        hits: Number of hits.
        of: Number of cases.
    """

    hits: int
    of: int

    @property
    def value(self) -> float | None:
        """Share of hits; None without cases."""
        return self.hits / self.of if self.of else None

    def interval(self) -> tuple[float, float] | None:
        r"""Score interval of a binomial proportion (E. B. Wilson 1927, JASA 22:209), at 90 %.

        $\left(\hat p + \tfrac{z^2}{2n} \pm z\sqrt{\hat p(1-\hat p)/n + z^2/(4n^2)}\right) /
        (1 + z^2/n)$; None without cases.
        """
        if not self.of:
            return None
        z = NormalDist().inv_cdf((1 + INTERVAL_CONFIDENCE) / 2)
        share, spread = self.hits / self.of, z**2 / self.of
        centre = (share + spread / 2) / (1 + spread)
        half = sqrt(share * (1 - share) * spread + spread**2 / 4) / (1 + spread)
        return max(0.0, centre - half), min(1.0, centre + half)

    def document(self) -> dict:
        """Proportion as a result file holds it."""
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
