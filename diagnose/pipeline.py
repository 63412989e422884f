"""The steps of a diagnosis: screen effects, weigh hypotheses, measure and locate the gap."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from diagnose.checks.caveats import caveats
from diagnose.checks.outlier_runs import (
    gap_carried_by_one_run,
    outliers_among_repeats,
    outliers_by_zeta,
)
from diagnose.dataset import RigDataset, with_step_errors_of, without_step_errors
from diagnose.gap.budget import ChannelBudget, doubted_weights, gap_budget
from diagnose.gap.cross_validation import HeldOutPrediction, at_mean_sinkage, predict_held_out
from diagnose.gap.discretization_error import (
    beside_plates,
    changes_with_finer_plates,
    discretization_errors,
    of_positions,
)
from diagnose.gap.gap import Gap, gaps
from diagnose.gap.noise_floor import noise_floors
from diagnose.gap.one_zeta import one_zeta_gaps, zeta_shares
from diagnose.gap.repeatability import repeat_variance
from diagnose.gap.selected_effects import SelectedEffects, best_selection, effects_of
from diagnose.gap.standard_errors import relative_strength_errors, standard_errors
from diagnose.gap.stepwise import stepwise_gap
from diagnose.gap.zeta_matching import (
    REFERENCE_NAME,
    WITH_EFFECTS_NAME,
    residuals_of,
    unmatched,
)
from diagnose.hypotheses.hypothesis import Hypothesis, top_ranked
from diagnose.hypotheses.screening import Report, Screening, ScreeningResult, screen_effects
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.localization.localization import localize
from diagnose.localization.shares import GapShare
from diagnose.measured_gap import MeasuredGap, ReferenceRuns
from diagnose.next_runs.discrimination import next_run
from diagnose.result import Diagnosis, parameter_estimates
from diagnose.run_pool import RunPool
from diagnose.selection.model_weights import (
    NONE,
    UNKNOWN,
    LeftByRun,
    ScoredHypothesis,
    weights,
)
from diagnose.selection.verdict import (
    believing_listed,
    competing_hypotheses,
    decide,
    explaining_candidates,
    hypothesis_behind,
    reassign_unknown,
    weight_by_name,
    weights_without,
)
from diagnose.settings import DEFAULT_SETTINGS, DiagnosisSettings
from diagnose.unknown.correction_fit import UnknownEffect, fit_unknown_effect
from diagnose.unknown.disturbances import by_stage, estimate_disturbances
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import reported_name, reported_names


def diagnose(
    dataset: RigDataset,
    effects: Sequence[type[AbstractEffect]],
    report: Report = lambda stage: None,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
) -> Diagnosis:
    """Find which effects explain the runs of a dataset.

    Args:
        dataset: Runs of one rig.
        effects: Effects to choose from.
        report: Called with what is done next.
        settings: Numbers by which the diagnosis decides.

    Raises:
        InputError: where no run has a sinkage.
        RunError: where a run cannot be simulated.
    """
    with RunPool() as pool:
        dataset = without_step_errors(dataset, pool, settings.screening.initial_zeta)
        found = screen_effects(dataset, effects, pool, report, settings.screening)
        plain = predict_held_out(replace(found.regressors, dataset=dataset), found.none, pool)
        dataset = with_step_errors_of(found.regressors.dataset, dataset)
        return _Diagnosing(dataset, pool, report, settings).run(found, plain, effects)


@dataclass(frozen=True, eq=False)
class _Weighed:
    """Hypotheses and their weights.

    Attributes:
        screening: All that were screened.
        leading: Those that were weighed beside the reference model.
        held_out: Prediction of held-out runs by each of them, by names.
        share: Weights that sum to one.
        verdict: Names of the verdict.
        groups: Names that cannot be told from each of the verdict's.
        chosen: The hypothesis behind the verdict.
    """

    screening: ScreeningResult
    leading: list[Hypothesis]
    held_out: Mapping[tuple[str, ...], HeldOutPrediction]
    share: dict[tuple[str, ...], float]
    verdict: tuple[str, ...]
    groups: list[list[str]]
    chosen: Hypothesis


@dataclass(frozen=True, eq=False)
class _Diagnosing:
    """One diagnosis, step by step.

    Attributes:
        dataset: Runs of one rig.
        pool: Threads.
        report: Called with what is done next.
        settings: Numbers by which it decides.
    """

    dataset: RigDataset
    pool: RunPool
    report: Report
    settings: DiagnosisSettings

    def run(
        self,
        found: ScreeningResult,
        plain: HeldOutPrediction,
        effects: Sequence[type[AbstractEffect]],
    ) -> Diagnosis:
        """All steps once the effects are screened; `plain` is of the reference model."""
        dataset, settings = self.dataset, self.settings
        finer = changes_with_finer_plates(
            dataset, found.none.log_zeta, self.pool, settings.discretization
        )
        reference = ReferenceRuns(
            plain, at_mean_sinkage(plain, self.pool), discretization_errors(dataset, finer)
        )
        first = self.weigh(found, self.leading(found), finer)
        weighed, gap = self.judge(first, reference)
        # Look-alikes of the set that is named, which need not be the one with the best score.
        if len(weighed.verdict) > 1:
            screening = Screening(found.regressors, self.pool, settings.screening)
            rivals = screening.rivals(found, weighed.chosen, first.leading)
            if rivals:
                every = self.weigh(found, [*first.leading, *rivals], finer, first.held_out)
                weighed, gap = self.judge(every, reference)
        one_zeta = self.one_zeta_gap(weighed, gap)
        every_gap = (*gap.selected.gap.values(), *one_zeta.values())
        if weighed.verdict != (NONE,) and not any(each.is_reducible for each in every_gap):
            weighed = self.without_a_gap(weighed)
            gap = self.measure_gap(weighed, reference)
            one_zeta = self.one_zeta_gap(weighed, gap)
        competing = competing_hypotheses(
            found, weighed.leading, weighed.share, weighed.verdict, settings.verdict
        )
        self.report("where the gap lies")
        places = list(localize(dataset, gap.before, dict(gap.floors), settings.localization))
        notes, unknown, selected = gap.notes, None, gap.selected
        if weighed.verdict != (NONE,):
            unknown, more = self.explain_unknown(weighed, gap, places)
            places += more
        if weighed.verdict == (UNKNOWN,):
            weighed, selected, notes = self.judge_unknown(
                weighed, gap, unknown, places, {reported_name(e.about.name) for e in effects}
            )
        notes = [*notes, *unmatched(dataset, reference.matches, REFERENCE_NAME)]
        if selected.effects:
            notes += unmatched(dataset, selected.matches, WITH_EFFECTS_NAME)
        self.report("what to run next")
        chosen, advice = weighed.chosen, {}
        if competing:
            advice = next_run(dataset, chosen, competing, gap.floors, self.pool, settings.next_run)
        is_listed = selected is gap.selected
        errors = standard_errors(found.regressors, chosen, self.pool, settings.standard_error)
        budget, by_name = self.budget(weighed, gap, errors), weight_by_name(weighed.share)
        if is_listed:  # A correction in an effect's place leaves less than the budget's set.
            by_name = doubted_weights(by_name, budget, UNKNOWN, settings.budget)
        return Diagnosis(
            verdict=reported_names(weighed.verdict),
            weights=by_name,
            groups=[reported_names(group) for group in weighed.groups],
            selected=selected,
            parameters=parameter_estimates(chosen, errors) if chosen.names and is_listed else {},
            notes=notes,
            next_run=advice,
            screening=found,
            chosen=chosen,
            residual_before=gap.before,
            floors=gap.floors,
            localization=places,
            unknown_effect=unknown,
            stepwise=(
                stepwise_gap(
                    found,
                    chosen,
                    weighed.held_out,
                    gap.before,
                    gap.floors,
                    gap.selected.gap,
                    self.pool,
                    settings.gap,
                )
                if weighed.verdict == chosen.names and is_listed
                else []
            ),
            budget=budget,
            one_zeta_gap=one_zeta,
            zeta_shares=zeta_shares(found.regressors),
        )

    def judge(self, weighed: _Weighed, reference: ReferenceRuns) -> tuple[_Weighed, MeasuredGap]:
        """The verdict by what its set leaves of the gap."""
        settings, gap = self.settings, self.measure_gap(weighed, reference)
        for _ in range(settings.verdict.max_retries):
            if len(weighed.verdict) < 2 or gap.selected.worsens_no_channel(settings.selection):
                break
            weighed = self.without_set(weighed)
            gap = self.measure_gap(weighed, reference)
        if weighed.verdict == (UNKNOWN,):
            return self.with_explaining_set(weighed, gap, reference)
        return weighed, gap

    def leading(self, found: ScreeningResult) -> list[Hypothesis]:
        """The hypotheses that are weighed."""
        limits = self.settings.held_out.of_sizes(found.by_size)
        ranked = zip(found.by_size, limits, strict=True)
        first = [each for several, count in ranked for each in top_ranked(several, count)]
        # One by which the runs cannot be simulated explains nothing.
        return [each for each in first if each.is_simulated]

    def weigh(
        self,
        found: ScreeningResult,
        leading: Sequence[Hypothesis],
        finer: Sequence[np.ndarray],
        known: Mapping[tuple[str, ...], HeldOutPrediction] = MappingProxyType({}),
    ) -> _Weighed:
        """Predict held-out runs by the leading hypotheses, and weigh them.

        Args:
            found: Of the screening.
            leading: Hypotheses.
            finer: By run, what finer plates change, shape (channels, samples).
            known: Predictions that were made already, by names.
        """
        self.report("predicting the held-out runs")
        predictions = [
            *known.values(),
            *self.pool.map_outer(
                lambda each: predict_held_out(found.regressors, each, self.pool),
                [each for each in leading if each.names not in known],
            ),
        ]
        # With numbers at which a held-out run cannot be simulated an effect explains nothing.
        held_out = {
            each.hypothesis.names: each
            for each in predictions
            if self.dataset.all_finite(each.residual)
        }
        leading = [each for each in leading if each.names in held_out]
        share = self.weights(found, leading, held_out, finer)
        return self.decided(_Weighed(found, leading, held_out, share, (), [], found.none), share)

    def with_explaining_set(
        self, weighed: _Weighed, likeliest: MeasuredGap, reference: ReferenceRuns
    ) -> tuple[_Weighed, MeasuredGap]:
        """Name the likeliest set, if it explains most of the gap, or a larger one, if all.

        Else the likeliest set of several effects, or a larger one, if it explains a part, and more
        than a part of it that was tried.
        """
        settings, limits = self.settings.verdict, self.settings.selection
        share, chosen = weighed.share, weighed.chosen
        sets = {each.names: each for each in (*weighed.leading, chosen)}
        tried = []
        for names in explaining_candidates(share, chosen.names, settings):
            is_likeliest, other = names == chosen.names, replace(weighed, chosen=sets[names])
            gap = likeliest if is_likeliest else self.measure_gap(other, reference)
            tried.append((names, gap))
            is_enough = is_likeliest or not gap.selected.leaves_gap
            if gap.selected.explains_most(limits) and is_enough:
                return self.naming(names, weighed, gap, reference, settings.listed_share)
        for names, gap in tried:
            fewer = [other.selected for part, other in tried if set(part) < set(names)]
            is_better = all(gap.selected.remaining < each.remaining for each in fewer)
            if is_better and gap.selected.explains_part(limits):
                return self.naming(names, weighed, gap, reference, settings.part_listed_share)
        return weighed, likeliest

    def naming(
        self,
        names: tuple[str, ...],
        weighed: _Weighed,
        gap: MeasuredGap,
        reference: ReferenceRuns,
        listed_share: float,
    ) -> tuple[_Weighed, MeasuredGap]:
        """The verdict where so much of the weight of `unknown` goes to a set that leaves this."""
        leaves_gap = gap.selected.leaves_gap
        share = believing_listed(weighed.share, names, leaves_gap, listed_share)
        found = self.decided(weighed, share)
        return found, gap if found.chosen.names == names else self.measure_gap(found, reference)

    def decided(self, weighed: _Weighed, share: dict[tuple[str, ...], float]) -> _Weighed:
        """The verdict by other weights."""
        verdict, groups = decide(share, self.settings.verdict)
        chosen = hypothesis_behind(weighed.screening, weighed.leading, share, verdict)
        return replace(weighed, share=share, verdict=verdict, groups=groups, chosen=chosen)

    def without_a_gap(self, weighed: _Weighed) -> _Weighed:
        """The verdict where no channel has a gap: there is nothing that an effect would explain."""
        verdict, groups = decide(weighed.share, self.settings.verdict, has_gap=False)
        return replace(weighed, verdict=verdict, groups=groups, chosen=weighed.screening.none)

    def one_zeta_gap(self, weighed: _Weighed, gap: MeasuredGap) -> dict[str, Gap]:
        """The gap of each channel with one zeta for the bed."""
        regressors, both = weighed.screening.regressors, (gap.reference.prediction, gap.prediction)
        return one_zeta_gaps(regressors, *both, gap.floors, self.pool, self.settings.gap)

    def without_set(self, weighed: _Weighed) -> _Weighed:
        """The weights without the verdict's set, which makes a channel worse."""
        dropped = weighed.verdict
        leading = [each for each in weighed.leading if each.names != dropped]
        return self.decided(
            replace(weighed, leading=leading), weights_without(weighed.share, dropped)
        )

    def weights(
        self,
        found: ScreeningResult,
        leading: Sequence[Hypothesis],
        held_out: Mapping[tuple[str, ...], HeldOutPrediction],
        finer: Sequence[np.ndarray],
    ) -> dict[tuple[str, ...], float]:
        """Weights of the reference model, the leading hypotheses and unknown."""
        regressors, none = found.regressors, found.none

        def left(residual: list[np.ndarray], log_zeta: np.ndarray) -> LeftByRun:
            plain = beside_plates(self.dataset, residual, finer, self.settings.discretization)
            power = regressors.block_powers(plain, self.pool)
            return LeftByRun(power, log_zeta + regressors.log_reference_zeta)

        scored = [ScoredHypothesis((), 0, left(none.residual, none.log_zeta))]
        for each in leading:
            predicted = held_out[each.names]
            by_all = predicted.by_all
            scored.append(
                ScoredHypothesis(
                    each.names,
                    len(each.coordinates),
                    left(each.residual, each.log_zeta),
                    left(predicted.residual, predicted.log_zeta),
                    left(by_all.residual, by_all.log_zeta) if by_all else None,
                    predicted.conditions,
                )
            )
        matrices, residuals = regressors.gram_matrices, [e.residual for e in (none, *leading)]
        by_repeats = repeat_variance(regressors.dataset, residuals, none.by_zeta)
        of_plates = regressors.block_powers(of_positions(self.dataset, finer), self.pool)
        by_plates = regressors.noise_power + of_plates.sum(axis=0)
        return weights(
            scored,
            matrices.blocks,
            matrices.sample_count.sum(axis=0),
            regressors.noise_power,
            self.settings.weights,
            np.maximum(by_repeats, by_plates),
            regressors.settings,
        )

    def measure_gap(self, weighed: _Weighed, reference: ReferenceRuns) -> MeasuredGap:
        """The gap without and with the chosen hypothesis, and its noise floors."""
        dataset, pool, settings = self.dataset, self.pool, self.settings
        regressors, none = weighed.screening.regressors, weighed.screening.none
        chosen = weighed.chosen
        prediction, matches = reference.prediction, reference.matches
        if chosen.names:
            prediction = weighed.held_out[chosen.names]
            matches = at_mean_sinkage(prediction, pool)
        before, after = residuals_of(reference.matches), residuals_of(matches)
        own = reference.discretization
        floors, how = noise_floors(dataset, before, after, own, none.by_zeta)
        notes = [
            how,
            *caveats(dataset),
            *outliers_among_repeats(
                dataset, [before, after], own, none.by_zeta, settings.outlier_runs
            ),
            *outliers_by_zeta(regressors, chosen, settings.outlier_runs),
        ]
        gap = gaps(dataset, before, after, floors, settings.gap)
        selected = SelectedEffects(effects_of(chosen), chosen.log_zeta, matches, gap)
        return MeasuredGap(reference, floors, notes, selected, prediction)

    def budget(
        self, weighed: _Weighed, gap: MeasuredGap, errors: np.ndarray
    ) -> dict[str, ChannelBudget]:
        """The gap of each channel, divided by the verdict's effects.

        `errors` are the standard errors of the coordinates behind the verdict, shape (free,).
        """
        named = weighed.verdict == weighed.chosen.names
        prediction = gap.prediction if named else gap.reference.prediction
        after = gap.selected.after if named else gap.before
        return gap_budget(
            prediction,
            gap.before,
            after,
            gap.floors,
            relative_strength_errors(weighed.chosen, errors),
            reported_names(prediction.hypothesis.names),
            self.pool,
            self.settings.budget,
        )

    def explain_unknown(
        self, weighed: _Weighed, gap: MeasuredGap, places: Sequence[GapShare]
    ) -> tuple[UnknownEffect | None, list[GapShare]]:
        """The simplest unknown signal, if that is the verdict, and shares of the gap by stage."""
        dataset, pool, settings = self.dataset, self.pool, self.settings
        none, screened = weighed.screening.none, weighed.screening.regressors.dataset
        # With the plates of the screening, whose program is compiled.
        linearized = linearize_runs(screened, none.log_zeta, pool, settings.screening.linearization)
        disturbances = estimate_disturbances(
            dataset,
            linearized,
            pool,
            settings=settings.unknown_effect,
            linear_fit=settings.linear_fit,
        )
        stages = by_stage(disturbances, settings.localization)
        if weighed.verdict != (UNKNOWN,) or not disturbances:
            return None, stages
        self.report("what an effect that explains it would look like")
        unknown = fit_unknown_effect(
            dataset,
            linearized,
            disturbances,
            gap.before,
            gap.floors,
            [*places, *stages],
            pool,
            settings.unknown_effect,
            settings.correction_steps,
        )
        return unknown, stages

    def judge_unknown(
        self,
        weighed: _Weighed,
        gap: MeasuredGap,
        unknown: UnknownEffect | None,
        places: Sequence[GapShare],
        listed: set[str],
    ) -> tuple[_Weighed, SelectedEffects, list[str]]:
        """Choose between the likeliest listed effect, a correction and neither.

        Args:
            weighed: With the verdict unknown.
            gap: Of the likeliest listed effect.
            unknown: The simplest unknown signal, if there is one.
            places: Shares of the gap.
            listed: Names of the effects to choose from.

        Returns:
            The weights, where the correction is a form of a listed effect with its verdict; the
            effects selected; and the notes with those on the choice.
        """
        correction = None if unknown is None else unknown.best_correction
        curve = None if correction is None else correction.selection
        known, log_zeta = gap.selected, weighed.screening.none.log_zeta
        settings = self.settings
        without = gaps(self.dataset, gap.before, gap.before, gap.floors, settings.gap)
        reference = SelectedEffects((), log_zeta, gap.reference.matches, without)
        tried = [known] if curve is None else [known, curve]
        selected = best_selection(tried, reference, settings.selection)
        offered = curve is not None and selected is curve
        notes = [
            *gap.notes,
            *([] if unknown is None else unknown.sentences(selected is curve)),
            *gap_carried_by_one_run(
                self.dataset, places, gap.before, gap.floors, settings.outlier_runs
            ),
        ]
        meant = correction.listed_effect if correction is not None and offered else None
        if meant is not None and meant in listed:
            share = reassign_unknown(weighed.share, meant)
            weighed = replace(weighed, share=share, verdict=(meant,), groups=[[meant]])
        return weighed, selected, notes
