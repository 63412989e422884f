"""Screening: which effects, alone or in pairs, explain the runs of a dataset.

All effects are ranked by linear fits; the leading ones are refined by simulation, alone, then in
pairs with all others, then in larger sets, stepwise: to the best sets of one size each other effect
is added, two at once to those a size below, and those that no longer help are taken out again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnose.dataset import RigDataset, match_initial_zeta
from diagnose.hypotheses.exchange import doubly_exchanged, exchanged_sets
from diagnose.hypotheses.hypothesis import (
    Hypothesis,
    best_first,
    best_of_each,
    linear_start,
    top_ranked,
)
from diagnose.hypotheses.joint_additions import joint_starts
from diagnose.hypotheses.large_strengths import at_large_strengths
from diagnose.hypotheses.leading_step_errors import without_leading_step_errors
from diagnose.hypotheses.linear_ranking import ranked_effects
from diagnose.hypotheses.refinement import predicted_score, refine, relinearize
from diagnose.hypotheses.set_candidates import SetScreeningSettings
from diagnose.hypotheses.set_screening import race, refine_sets, without_effect
from diagnose.hypotheses.settings import DEFAULT_SCREENING, ScreeningSettings
from diagnose.linear.linear_fit import LinearFit, floor_inflation, log_score
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import Regressors, ShapeVariant, begin_derivatives
from diagnose.model.augmented_model import AugmentedModel, predict, shared_model
from diagnose.run_pool import RunPool
from drftjax.effects.base import AbstractEffect
from drftjax.recorded.repeats import group_by_condition

Report = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class ScreeningResult:
    """Hypotheses that a screening refined.

    Attributes:
        regressors: The runs, with the responses to all effects.
        none: The reference model with each run's own zeta, refined.
        singles: Effects simulated alone, best first.
        pairs: Pairs simulated, best first.
        larger_sets: Sets of three effects and more, best first within one size, by size.
        exchanged: Sets, by names, in which look-alikes were tried in each effect's place.
    """

    regressors: Regressors
    none: Hypothesis
    singles: tuple[Hypothesis, ...]
    pairs: tuple[Hypothesis, ...]
    larger_sets: tuple[tuple[Hypothesis, ...], ...] = ()
    exchanged: frozenset[frozenset[str]] = frozenset()

    @property
    def by_size(self) -> tuple[tuple[Hypothesis, ...], ...]:
        """Hypotheses of one effect, of two, and so on, best first within one size."""
        return (self.singles, self.pairs, *self.larger_sets)


def screen_effects(
    dataset: RigDataset,
    effects: Sequence[type[AbstractEffect]],
    pool: RunPool,
    report: Report = lambda stage: None,
    settings: ScreeningSettings = DEFAULT_SCREENING,
) -> ScreeningResult:
    """Rank every effect, simulate the leading ones, then pairs of them with all.

    Args:
        dataset: Runs of one rig.
        effects: The catalogue.
        pool: Threads.
        report: Called with what is done next.
        settings: Numbers of the screening.

    Raises:
        InputError: where no run has a sinkage.
        RunError: where a run cannot be simulated.
    """
    report("baseline: zeta of each run")
    log_zeta = match_initial_zeta(dataset, pool, settings.initial_zeta)
    dataset = replace(dataset.with_fewer_plates(), shared=shared_model(effects))
    _begin_shared_programs(dataset, pool)
    report(f"linearising {len(dataset.runs)} runs, and {len(effects)} effects along them")
    linearized = linearize_runs(dataset, log_zeta, pool, settings.linearization)
    regressors = Regressors.of(dataset, linearized, effects, pool, settings.linear_fit)
    return Screening(regressors, pool, settings).run(report)


def _begin_shared_programs(dataset: RigDataset, pool: RunPool) -> None:
    """Begin with the two programs that serve most sets, while the responses leave a core idle."""
    if dataset.shared.effects:
        dataset.compile(pool, predict, AugmentedModel(dataset.shared.effects[:1]), waits=False)
        begin_derivatives(dataset, dataset.shared, pool)


@dataclass(frozen=True, eq=False)
class Screening:
    """The screening of one dataset.

    Attributes:
        regressors: The runs.
        pool: Threads.
        settings: Numbers of the screening.
    """

    regressors: Regressors
    pool: RunPool
    settings: ScreeningSettings = DEFAULT_SCREENING

    def run(self, report: Report) -> ScreeningResult:
        """The screening, once repeats have shown how far zeta scatters."""
        plain = self.refine(linear_start(self.regressors, []), self.settings.reference_simulations)
        regressors = self.regressors
        groups = group_by_condition(regressors.dataset.runs)
        zetas = plain.log_zeta + regressors.log_reference_zeta
        bed = regressors.settings.bed.after_repeats(zetas, groups)
        weights = replace(regressors.settings, bed=bed)
        seen = replace(self, regressors=replace(regressors, settings=weights))
        return seen.screen(seen.refine(replace(plain, is_simulated=False), 1), report)

    def screen(self, none: Hypothesis, report: Report) -> ScreeningResult:
        """Rank, simulate and join the effects."""
        report("screening")
        is_far = self.is_far(none)
        ranked = ranked_effects(
            self.regressors,
            self.settings.rankings,
            self.settings.min_simulated,
            self.settings.min_linear_gain,
        )
        ranked = ranked[: None if is_far else self.settings.max_simulated]
        report(f"simulating the leading {len(ranked)} effects")
        singles = self.simulate_singles(ranked)
        if is_far:
            singles = best_of_each([*singles, *self.at_large_strengths(none)])
        here, by_size = self.at_leading([self.finish(singles), []])
        exchanged = frozenset[frozenset[str]]()
        if by_size[0] and self.leaves_gap(by_size[0][0]):
            report("pairs of effects")
            pairs = self.settings.pairs.where(is_far)
            larger_sets = self.settings.larger_sets.where(is_far)
            by_size[1] = here.sets_beside(by_size[0], [none], by_size[0], pairs)
            here, by_size = here.at_leading(by_size)
            here.add_effects(by_size, larger_sets, report)
            here, by_size = here.at_leading(by_size)
            exchanged = here.exchange_effects(by_size, larger_sets, report)
            here, by_size = here.at_leading(by_size)
        best = max((several[0].score for several in by_size if several), default=-np.inf)
        alone, in_pairs, *larger = (here.refine_leading(each, best) for each in by_size)
        return ScreeningResult(here.regressors, none, alone, in_pairs, tuple(larger), exchanged)

    def at_leading(
        self, by_size: list[list[Hypothesis]]
    ) -> tuple["Screening", list[list[Hypothesis]]]:
        """The same without the error of the step at the leading numbers, and what is known."""
        regressors, known = without_leading_step_errors(self.regressors, by_size, self.pool)
        return replace(self, regressors=regressors), known

    def refine_leading(self, several: list[Hypothesis], best: float) -> tuple[Hypothesis, ...]:
        """Hypotheses of one size; those near the best score have derivatives at their numbers."""
        least, count = best - self.settings.hopeless_deficit, self.settings.max_leading
        near = [e for e in top_ranked(several, count) if e.is_simulated and e.score > least]

        def refined(each: Hypothesis) -> Hypothesis:
            before = -np.inf
            # Once, and again where that still gained, as the derivatives are then of another place.
            for _ in range(2):
                if each.score - before < self.settings.refinement.min_gain:
                    break
                before, exact = each.score, relinearize(self.regressors, each, self.pool)
                # The step is short: what a simulation says of the way is mostly roughness.
                each = replace(self.refine(exact, 1), columns=exact.columns)
            return each

        done = self.pool.map_outer(refined, near)
        return tuple(best_of_each([*done, *(each for each in several if each not in near)]))

    def is_far(self, none: Hypothesis) -> bool:
        """Tell whether the reference model is so far off that linear fits say little."""
        settings, weights = self.settings, self.regressors.settings
        blocks = self.regressors.gram_matrices.blocks
        # What adds up over a run is no sign that a response bends.
        without_levels = replace(weights, level_worth=0.0)
        miss = floor_inflation(blocks, none.fit.mean_square, 1.0, without_levels)
        most = settings.far_from_scatter * weights.bed.scatter
        return miss > settings.far_from_floor or none.fit.zeta_variance > most**2

    def add_effects(
        self, by_size: list[list[Hypothesis]], limits: SetScreeningSettings, report: Report
    ) -> None:
        """Add one effect after another to the best sets while that pays.

        Args:
            by_size: Singles and pairs, best first; larger sets are appended.
            limits: Numbers of the choice of larger sets.
            report: Called with what is done next.
        """
        while by_size[-1] and len(by_size) < self.settings.max_effects:
            # A smaller set, found by taking out, may leave none either.
            leave_gap = all(self.leaves_gap(several[0]) for several in by_size if several)
            if not (leave_gap and self.still_gains(by_size)):
                break
            report(f"sets of {len(by_size) + 1} effects")
            by_size.append(self.sets_beside(by_size[-1], by_size[-2], by_size[0], limits))
            if by_size[-1]:
                self.take_out(by_size, len(by_size) - 1)

    def still_gains(self, by_size: Sequence[Sequence[Hypothesis]]) -> bool:
        """Tell whether the last effects that were added gained enough for one more.

        One that gained little is not the end: where several effects act, what makes up for all of
        them at once can hide what each of two does until both are there.

        Args:
            by_size: Singles, pairs and larger sets, best first, the last one not empty.
        """
        settings, best = self.settings, by_size[-1][0].score
        for added in range(1, 1 + min(settings.patience, len(by_size) - 1)):
            smaller = by_size[-1 - added]
            if not smaller:
                continue
            left = self.best_score() - smaller[0].score
            asked = max(settings.min_set_gain * added, settings.min_set_share * left)
            if best - smaller[0].score >= asked:
                return True
        return len(by_size) <= settings.patience

    def exchange_effects(
        self, by_size: list[list[Hypothesis]], limits: SetScreeningSettings, report: Report
    ) -> frozenset[frozenset[str]]:
        """Try look-alikes in the places of the best set's effects, again while that pays.

        Args:
            by_size: Singles, pairs and larger sets, best first; those that begin with a better set
                take the place of larger ones.
            limits: Numbers of the choice of larger sets.
            report: Called with what is done next.

        Returns:
            Names of the sets in which they were tried.
        """
        done = set[frozenset[str]]()
        for _ in range(self.settings.max_exchanges):
            # Look-alikes belong to the set that is told, which may be a part of the one found.
            self.take_out_further(by_size)
            leading = [several[0] for several in by_size[1:] if several]
            best = max(leading, key=self.worth, default=None)
            # Where it leaves no gap, too: what does as well belongs in a group with it.
            if best is None or frozenset(best.names) in done:
                break
            done.add(frozenset(best.names))
            report(f"look-alikes in sets of {len(best.names)} effects")
            place = len(best.names) - 1
            refined = self.with_look_alikes(best, by_size[place], limits)
            by_size[place] = best_of_each([*by_size[place], *refined])
            if by_size[place][0].score < best.score + self.settings.min_round_gain:
                break
            del by_size[place + 1 :]
            self.add_effects(by_size, limits, report)
        self.take_out_further(by_size)
        return frozenset(done)

    def with_look_alikes(
        self, best: Hypothesis, known: Sequence[Hypothesis], limits: SetScreeningSettings
    ) -> list[Hypothesis]:
        """A set with look-alikes in the places of its effects, of one or of two, simulated.

        Args:
            best: The set.
            known: Sets that were simulated already.
            limits: Numbers of the choice of larger sets.
        """
        settings, exchange = self.settings, self.settings.exchange
        of_best = best, known, self.pool, exchange
        by_place = exchanged_sets(self.regressors, *of_best, with_sums=self.leaves_gap(best))
        # What takes another's place has a long way to go.
        of_place = replace(limits, max_continued=exchange.max_continued, fresh_derivatives=True)
        tried = [
            each
            for starts in by_place
            for each in race(self.regressors, starts, self.pool, of_place, settings.refinement)
        ]
        # A look-alike with which no run can be simulated says nothing.
        done = [each for each in self.finish(tried, best.score) if each.is_simulated]
        twice = doubly_exchanged(best, [*known, *done], exchange)
        raced = race(self.regressors, twice, self.pool, of_place, settings.refinement)
        return done + [each for each in self.finish(raced, best.score) if each.is_simulated]

    def rivals(
        self, found: ScreeningResult, told: Hypothesis, weighed: Sequence[Hypothesis]
    ) -> list[Hypothesis]:
        """Sets with another effect in one's place that do about as well as the one that is told.

        The screening exchanges the effects of the set with the best score, which need not be the
        one that is told.

        Args:
            found: What this screening found.
            told: A set of several effects, one of those found.
            weighed: Hypotheses that are weighed already, and looked for no further.
        """
        names, known = frozenset(told.names), found.by_size[len(told.names) - 1]
        tried = []
        if names not in found.exchanged:
            limits = self.settings.larger_sets.where(self.is_far(found.none))
            tried = self.with_look_alikes(told, known, limits)
        least = told.score - self.settings.min_set_gain
        seen = {frozenset(each.names) for each in weighed}
        near = [
            each
            for each in best_of_each([*known, *tried])
            if each.is_simulated
            and each.score > least
            and len(names.difference(each.names)) == 1
            and frozenset(each.names) not in seen
        ]
        return list(self.refine_leading(near[: self.settings.max_leading], told.score))

    def take_out_further(self, by_size: list[list[Hypothesis]]) -> None:
        """Try the best set without one effect after another, while that costs little."""
        place = max(
            (place for place, several in enumerate(by_size) if several),
            key=lambda place: by_size[place][0].score,
        )
        while place > 0:
            best = by_size[place][0]
            self.take_out(by_size, place)
            place -= 1
            if by_size[place][0].score < best.score - self.settings.min_set_gain:
                break

    def take_out(self, by_size: list[list[Hypothesis]], place: int) -> None:
        """Try the best set of one size without each of its effects.

        The larger it is, the more likely that one which was added early has no part in it. What is
        left is one of the sets of the size below.

        Args:
            by_size: Singles, pairs and larger sets, best first.
            place: Of the size among them, pairs or more.
        """
        best = by_size[place][0]
        # One that is far behind may have gone astray, on its way from elsewhere. A single effect
        # may have stopped short, and is tried again from here.
        least = best.score - self.settings.hopeless_deficit
        known = {
            frozenset(each.names) for each in by_size[place - 1] if place > 1 and each.score > least
        }
        missing = [
            index
            for index, name in enumerate(best.names)
            if frozenset(best.names) - {name} not in known
        ]
        simulations = self.settings.larger_sets.max_simulations

        def without(index: int) -> Hypothesis:
            first = self.refine(without_effect(best, index), 1)
            if first.score < least:
                return first
            return self.refine(first, simulations - 1)

        kept = [each for each in self.pool.map_outer(without, missing) if each.is_simulated]
        # The others make up for an effect only as far as derivatives hold: what may lead gets
        # fresh ones.
        worth = by_size[place - 1][0].score - self.settings.min_set_gain
        promising = [predicted_score(self.regressors, each, self.pool) > worth for each in kept]
        leading = self.finish([each for each, may in zip(kept, promising, strict=True) if may])
        rest = [each for each, may in zip(kept, promising, strict=True) if not may]
        by_size[place - 1] = best_of_each([*by_size[place - 1], *leading, *rest])

    def refine(self, start: Hypothesis, simulations: int) -> Hypothesis:
        """Refine a hypothesis by so many simulations at most."""
        return refine(self.regressors, start, simulations, self.pool, self.settings.refinement)

    def sets_beside(
        self,
        bases: Sequence[Hypothesis],
        smaller: Sequence[Hypothesis],
        singles: Sequence[Hypothesis],
        limits: SetScreeningSettings,
    ) -> list[Hypothesis]:
        """Simulate the leading sets of one effect more than the bases have, best first.

        Args:
            bases: Hypotheses that an effect is added to, best first.
            smaller: Hypotheses of one effect less, to which two are added at once.
            singles: Effects simulated alone, best first.
            limits: Numbers of the choice.
        """
        regressors, pool, settings = self.regressors, self.pool, self.settings
        found = refine_sets(regressors, bases, singles, pool, limits, settings.refinement)
        for base in bases[: limits.far_bases]:
            found += self.at_large_strengths(base)
        of_joint = replace(limits, max_continued=settings.joint.max_continued)
        starts = joint_starts(regressors, smaller, found, pool, settings.joint)
        raced = race(regressors, starts, pool, of_joint, settings.refinement)
        found += [each for each in raced if each.is_simulated]
        return self.finish(best_of_each(found))

    def simulate_singles(
        self, ranked: Sequence[tuple[ShapeVariant, LinearFit]]
    ) -> list[Hypothesis]:
        """Refine each of the leading effects by a few simulations."""
        starts = [linear_start(self.regressors, [variant], fit) for variant, fit in ranked]
        self.regressors.begin_compiling([each.model for each in starts], self.pool)
        simulations = self.settings.first_simulations
        return self.pool.map_outer(lambda each: self.refine(each, simulations), starts)

    def at_large_strengths(self, base: Hypothesis) -> list[Hypothesis]:
        """A hypothesis with each effect at a strength far from zero."""
        settings = self.settings
        search = self.pool, settings.large_strengths, settings.refinement
        return at_large_strengths(self.regressors, base, *search)

    def finish(self, hypotheses: list[Hypothesis], best_known: float = -np.inf) -> list[Hypothesis]:
        """Refine the leading hypotheses to their end; return all of them, best first.

        Args:
            hypotheses: Simulated, most of them.
            best_known: Log score of a rival that is refined already [-].
        """
        regressors, pool, settings = self.regressors, self.pool, self.settings
        worth = pool.map_outer(lambda each: predicted_score(regressors, each, pool), hypotheses)
        ranked = sorted(zip(worth, hypotheses, strict=True), key=lambda each: -each[0])
        hypotheses = [each for _, each in ranked]
        done: list[Hypothesis] = []
        for predicted, each in ranked[: settings.max_continued]:
            best = max([best_known, *(other.score for other in done)])
            hopeless = each.is_simulated and predicted < best - settings.hopeless_deficit
            done.append(each if hopeless else self.finish_one(each, best))
        return best_first(done + hypotheses[settings.max_continued :])

    def finish_one(self, here: Hypothesis, best_score: float) -> Hypothesis:
        """Refine a hypothesis with fresh derivatives, round by round, while that gains.

        It gets a round where it leaves no gap, too: the numbers of the one that leads are reported.
        """
        settings = self.settings
        if not here.is_simulated:
            here = self.refine(here, settings.simulations_per_round)
        for number in range(settings.max_rounds if here.is_simulated else 0):
            if number > 0 and not self.leaves_gap(here):
                break
            exact = relinearize(self.regressors, here, self.pool)
            further = self.refine(exact, settings.simulations_per_round)
            gain = further.score - here.score
            here = further
            hopeless = here.score + gain < best_score - settings.hopeless_deficit
            if gain < settings.min_round_gain or hopeless:
                break
        return here

    def worth(self, each: Hypothesis) -> float:
        """Log score of a hypothesis, less what its effects must gain."""
        return each.score - self.settings.min_set_gain * len(each.names)

    def best_score(self) -> float:
        """Log score of a model that leaves noise alone."""
        regressors = self.regressors
        matrices, noise = regressors.gram_matrices, regressors.noise_power
        count, runs = matrices.sample_count.sum(axis=0), len(matrices.log_zeta)
        return log_score(matrices.blocks, count, noise, 0.0, runs, settings=regressors.settings)

    def leaves_gap(self, best: Hypothesis) -> bool:
        """Tell whether a hypothesis leaves more than the model error in a slow part or a level."""
        blocks = self.regressors.gram_matrices.blocks
        errors = self.regressors.settings.model_errors(blocks)
        return any(
            np.sqrt(left) > self.settings.pair_floor * error
            for (_, kind), error, left in zip(blocks, errors, best.fit.mean_square, strict=True)
            if kind != "fast"
        )
