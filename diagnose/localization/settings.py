"""Numbers of the localisation of a gap."""

import itertools
from dataclasses import dataclass


@dataclass(frozen=True)
class LocalizationSettings:
    """Bins, bootstrap and thresholds by which a gap is localised.

    Attributes:
        standing_speed: A wheel stands below this share of its fastest rim speed [-].
        steady_growth: Its speed is steady where it changes by less than this share of the fastest
            in a second [1/s].
        growth_window: Time over which that change is taken [s], so that rounding in a recorded
            command is no acceleration.
        state_bins: Bins of a state variable, about as many.
        edge_steps: Steps of the grid of round numbers on which their edges lie, about as many over
            the variable's range.
        slip_edges: Edges between bins of slip [-].
        frequency_edges: Edges between bands [Hz].
        min_turns: Turns of a run in which a period of once a turn is distinguished from a drift.
        min_line_frequency: Lowest frequency at which a line is looked for [Hz],
        line_width: and its width [Hz].
        min_order, max_order: Orders between which a line over turning is looked for [periods a
            turn],
        order_width: and its width [periods a turn].
        min_line_share: A line has this share of the power in its own octave at least [-],
        min_line_gain: and so many times the share that it would have counted the other way [-]: by
            order for one at fixed frequency, and the reverse.
        line_cells: Cells, four in a line's width, that are summed for one line.
        neighbour_distance: Cells between a line and what it must stand out from.
        max_neighbour_ratio: Power there over the line's, at most [-].
        probability: Of the intervals of shares [-].
        draws: Bootstrap draws of an interval.
        seed: Of the draws.
        min_named_share: Share of the gap that a bin named in the summary has at least [-].
        most_share: A share that is called most of the gap [-].
        max_named: Bins named in the summary at most.
        marked_order_share: Share of the gap that a marked order (once a turn, grousers, a line) has
            by chance [-].
    """

    standing_speed: float = 0.02
    steady_growth: float = 0.02
    growth_window: float = 0.25
    state_bins: int = 5
    edge_steps: int = 25
    slip_edges: tuple[float, ...] = (0.0, 0.1, 0.2, 0.3, 0.5)
    frequency_edges: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0, 10.0)
    min_turns: float = 3.0
    min_line_frequency: float = 0.5
    line_width: float = 0.2
    min_order: float = 0.7
    max_order: float = 60.0
    order_width: float = 0.5
    min_line_share: float = 0.5
    min_line_gain: float = 1.5
    line_cells: int = 5
    neighbour_distance: int = 6
    max_neighbour_ratio: float = 0.5
    probability: float = 0.9
    draws: int = 400
    seed: int = 20240
    min_named_share: float = 0.25
    most_share: float = 0.5
    max_named: int = 3
    marked_order_share: float = 0.05

    @property
    def frequency_labels(self) -> tuple[str, ...]:
        """Names of the bands between `frequency_edges`, the lowest first."""
        edges = self.frequency_edges
        between = [f"{a:g} to {b:g} Hz" for a, b in itertools.pairwise(edges)]
        return (f"under {edges[0]:g} Hz", *between, f"over {edges[-1]:g} Hz")

    @property
    def beyond_orders(self) -> str:
        """Name of the band of orders above `max_order`."""
        return f"over {self.max_order:g} a turn"


DEFAULT_LOCALIZATION = LocalizationSettings()
