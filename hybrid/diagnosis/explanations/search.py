"""The search for the most probable explanation of a gap.

Causes are added, exchanged and removed as long as the :class:`.Posterior` rises. Each
step must lower the cross-validated loss as well, and each cause of the result the loss
on test samples.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.diagnosis.evidence.bayes import PRIOR_FACTORS
from hybrid.diagnosis.evidence.candidates import Candidate, Place, Term, usual
from hybrid.diagnosis.evidence.refine import refine
from hybrid.diagnosis.evidence.shapes import price
from hybrid.diagnosis.explanations.belief import Belief, beliefs
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.moves import LEAST_GAIN, Moves
from hybrid.diagnosis.explanations.posterior import around
from hybrid.diagnosis.gap.gap import Gap
from hybrid.effects import Effect
from hybrid.progress import Progress, silent

_ROUNDS = 4  # of additions and exchanges
_FEW = 3  # causes; an explanation with more is compared with the usual effects


class Search(Moves):
    """Causes of a gap, added, exchanged and removed until nothing is gained.

    Attributes:
        beliefs: Probabilities of its known causes, once it has run.
        whole: The final explanation with its unknown laws, once it has run.
    """

    _replaced = False  # whether an improbable cause was

    def __init__(
        self,
        gap: Gap,
        learn: Mask | None = None,
        without: Sequence[str] = (),
    ) -> None:
        super().__init__(gap, learn, without)
        self.causes, self._certain, self._progress = [], [], silent
        self._checked = {}
        self.beliefs: list[Belief] = []
        self.whole: list[Cause] = []

    @property
    def known(self) -> list[Cause]:
        """Causes that are effects of the library."""
        return [c for c in self.causes if c.candidate is not None]

    @property
    def terms(self) -> list[Term]:
        """The same causes, as candidates with their columns."""
        return [Term(c.candidate, c.index) for c in self.causes if c.candidate]

    @property
    def background(self) -> Index:
        """Columns of the background and of the unknown laws."""
        unknown = [c.index for c in self.causes if c.candidate is None]
        return np.concatenate([self.rigid, *unknown])

    def base(self) -> Index:
        """Columns of the whole explanation, those of known causes last."""
        return np.concatenate([self.background, *(c.index for c in self.known)])

    def ranked(self, base: Index) -> list[tuple[Candidate, float]]:
        """See :meth:`.Pool.ranked`."""
        there = [c for c in self.known if c.index[0] in base]
        return self.pool.ranked(base, self.taken(there))

    def loss(self, term: Term) -> float:
        """Log evidence that is lost without a term, [nat]."""
        base = self.base()
        rest = base[~np.isin(base, term.index)]
        whole, without = (self.evidence.solve(x).evidence for x in (base, rest))
        return float(whole - without - price(term.candidate.effect))

    def placed(self, found: Term | Candidate) -> tuple[str, str]:
        """Id of an effect, and the name of its last joint."""
        effect_id, joints = found.place
        return effect_id, self.gap.robot.joints[joints[-1]]

    def run(self, progress: Progress = silent) -> list[Cause]:
        """Find the most probable explanation whose causes help on test samples.

        Args:
            progress: Called with each cause that is added.
        """
        self._progress = progress
        self._converge(most=_FEW)
        if len(self.known) < len(self.causes) or len(self.causes) > _FEW:
            self._restart()
        self.beliefs = beliefs(self)
        while self._replace_limits() or self._replace_improbable():
            self.beliefs = beliefs(self)
        self.whole = list(self.causes)
        return self.causes

    def happened_in_test(self) -> Mask:
        """Test samples around contacts that happened there alone, shape (M,).

        No motion foretells what happens once: those samples can only be for training.
        What happens during most of the test is no event, and leaves nothing to test by.
        """
        gap, test = self.gap, self.test
        base, most = test.columns(self.causes), self.prior.most_repeated
        happened, left = list[Effect](), test.residuals(self.causes)
        for c in self.pool.contacts(test.evidence, left, most * len(gap.motions)):
            better, worth = refine(test.evidence, base, c)
            if worth - self.prior.cause - self.model_error_odds(better) <= LEAST_GAIN:
                continue
            cause = self.cause(better)
            if self.is_isolated(cause, [*self.causes, cause], test):
                happened.append(better.effect)
        found = np.zeros(len(test.use), dtype=bool)
        for x in happened:
            found |= around(gap, x)
        found &= test.use
        return found if 2 * found.sum() < test.use.sum() else np.zeros_like(found)

    def _restart(self) -> None:
        """Start from the usual effects, and keep the more probable explanation.

        The first search may have added an unknown law, or an effect that nearly fits,
        in place of two or three other effects, or have stopped because the gap has many
        causes. What the new one gains in score has to be more than what it loses in
        held-out loss.
        """
        before, refused = (self.causes, self.file_error), self.refused
        self.causes, self.refused = self._with_usual([]), frozenset()
        self._fit_file_error()
        self.update_noise(self.causes)
        self._remove()
        for self.library_only in (True, False):
            self._converge()
        now, loss = self._judged(self.causes, self.file_error)
        then, lost = self._judged(*before)
        if then > now or np.any(lost - then < loss - now):
            self.causes, self.refused = before[0], refused
            self.set_file_error(before[1])
            if len(self.causes) > _FEW:
                self._converge()  # that search has stopped early
        self.evidence.scale_prior(self.numbers, self.file_error)

    def _judged(self, causes: list[Cause], file_error: float) -> tuple[float, Array]:
        """Score of an explanation with an error of the file, and its held-out loss."""
        self.evidence.scale_prior(self.numbers, file_error)
        score = self.score(causes) - self.file_error_odds(file_error)
        return score, self.held_out_loss(causes)

    def _with_usual(self, causes: Sequence[Cause]) -> list[Cause]:
        """Some causes and the usual effects, with the most probable width of prior."""
        there = {c.place for c in causes}
        more = [c for c in usual(self.gap, self.pool.without) if c.place not in there]
        each = [
            [self.cause(replace(c, prior_factor=x)) for c in more]
            for x in PRIOR_FACTORS
        ]
        return max(([*causes, *x] for x in each), key=self.score)

    def substitute_unknown_laws(self) -> None:
        """Replace unknown laws and dropped causes by effects of the library.

        A simulator has no other laws. The effects are not reported as causes.
        """
        if self.known == self.whole and not self._replaced:
            return
        self.causes, self.library_only = self.known, True
        while (gains := self.unseen_gain(self.causes)) and min(gains.values()) <= 0:
            self.causes.remove(min(gains, key=gains.__getitem__))
        self._certain, self.refused = list(self.causes), frozenset()
        usual = self._with_usual(self.causes)
        self.causes = max(self.causes, usual, key=self.score)
        self._remove()
        self._converge()

    def _converge(self, most: float = np.inf) -> None:
        """Improve the explanation until all of its causes help on test samples.

        It stops as soon as there are more causes than ``most``. What did not help
        beside another noise is tried once more.
        """
        failed, again = set[Place](), set[Place]()
        while True:
            self._improve(most)
            if len(self.causes) > most:
                break
            gains = self.unseen_gain(self.causes)
            bad = [c for c in self._doubtful() if gains[c] <= 0]
            if not bad:
                if not self.update_noise(self.causes):
                    break
                self.refused -= failed - again
                again |= failed
            self.causes = [c for c in self.causes if c not in bad]
            failed |= {c.place for c in bad}
            self.refused |= {c.place for c in bad}

    def _improve(self, most: float = np.inf) -> None:
        for _ in range(_ROUNDS):
            changed = False
            while len(self.causes) <= most and self._add():
                changed = True
            if len(self.causes) > most:
                break
            for cause in self._doubtful():
                if cause in self.causes and not self._is_checked(cause):
                    changed |= self._exchange(cause)
            if not (changed or self._fit_file_error() or self._exchange_file_error()):
                break

    def _fit_file_error(self) -> bool:
        """Set the most probable error of the links' numbers; whether it has changed."""

        def score(error: float) -> float:
            self.evidence.scale_prior(self.numbers, error)
            return self.score(self.causes) - self.file_error_odds(error)

        def loss(error: float) -> Array:
            self.evidence.scale_prior(self.numbers, error)
            return self.held_out_loss(self.causes)

        now, best = self.file_error, max(self.prior.file_errors, key=score)
        better = score(best) > score(now) + LEAST_GAIN
        better = better and bool(np.all(loss(best) < loss(now)))
        self.evidence.scale_prior(self.numbers, now)
        if better:
            self.set_file_error(best)
        return better

    def _exchange_file_error(self) -> bool:
        """Exchange a large error of the links' numbers for the best cause."""
        typical, error = self.prior.file_errors[1], self.file_error
        if error <= typical:
            return False
        now = self.score(self.causes) - self.file_error_odds(error)
        loss = self.held_out_loss(self.causes)
        self.evidence.scale_prior(self.numbers, typical)
        for found in self.proposals(self.causes)[:1]:
            causes = [*self.causes, found.cause]
            worth = self.score(causes) - self.file_error_odds(typical) - now
            if worth > LEAST_GAIN and np.all(self.held_out_loss(causes) < loss):
                self.causes = causes
                self.set_file_error(typical)
                return True
        self.evidence.scale_prior(self.numbers, error)
        return False

    def _replace_limits(self) -> bool:
        """Exchange causes for the laws that they have become; whether there are any.

        A law has to help on test samples as well.
        """
        before = list(self.causes)
        for cause, law in ((b.cause, b.become) for b in self.beliefs):
            if law is None or law in self.causes:  # two causes may become the same law
                continue
            causes = [law if c is cause else c for c in self.causes]
            if self.unseen_gain(causes)[law] > 0:
                self.causes = causes
        return self.causes != before

    def _replace_improbable(self) -> bool:
        """Replace the least probable effect by an unknown law; whether there is one.

        An effect at the limit of its law is improbable too: there it is another law,
        for which it would have been exchanged if the library had that one.
        """
        least = self.prior.probable
        at = [b for b in self.beliefs if b.limit is not None or b.probability <= least]
        if not at:
            return False
        cause = min(at, key=lambda b: b.probability).cause
        here = {*cause.place[1]}
        self.refused |= {cause.place}
        self._replaced = True
        self.causes = [c for c in self.causes if c is not cause]
        self._certain = [c for c in self.causes if not here & {*c.place[1]}]
        laws = [x for x in self.laws.open(self.causes) if here & {*x.place[1]}]
        if laws:
            base = self.columns(self.causes)
            found = self.best_law(laws, self.causes, base, base[:0], {})
            self.causes.append(found.cause)
        self._remove()
        self._certain = []
        return True
