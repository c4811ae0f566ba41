"""The posterior probability of an explanation of a gap.

An explanation is a set of causes: effects of the library at places of the arm, and
unknown laws of joints. Its score is the log marginal likelihood of the gap, less the
odds against each cause:

    log p(gap | causes) + Σ log p(cause).

The noise is the residual of a flexible regression, or of the explanation where that is
smaller, plus the errors of laws and simulators. As it is an upper bound, the likelihood
is at the most probable noise below it.

Source: MacKay 1992, doi 10.1162/neco.1992.4.3.415 (evidence and its Occam factor).
"""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np
from scipy.special import log_ndtr

from hybrid.arrays import Array, Index, Mask
from hybrid.diagnosis.evidence.bayes import size_odds
from hybrid.diagnosis.evidence.candidates import Candidate, candidate
from hybrid.diagnosis.evidence.evidence import Evidence, Solution
from hybrid.diagnosis.evidence.noise import without_events
from hybrid.diagnosis.evidence.noise_model import NoiseModel, estimate_noise
from hybrid.diagnosis.evidence.pool import Pool
from hybrid.diagnosis.evidence.refine import refine
from hybrid.diagnosis.evidence.shapes import price
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.other_samples import OtherSamples, add_background
from hybrid.diagnosis.explanations.unknown_laws import UnknownLaws
from hybrid.diagnosis.gap.background import background
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.diagnosis.gap.measure import unseen_samples
from hybrid.diagnosis.prior import Prior
from hybrid.effects import Effect, effect_classes
from hybrid.statistics import robust_std

_RIPPLES = 9  # orders at each joint, in the regression that estimates the noise


class Posterior:
    """The log posterior of any causes of a gap.

    Args:
        learn: Training samples, shape (M,); all by default.
        without: Ids of effects to leave out of the library.

    Attributes:
        evidence: Cross-products of the gap on the training samples.
        rigid: Columns of the background; see :mod:`.background`.
        declared: Columns of the numbers in the file, a part of these.
        numbers: Columns of the links' numbers, a part of these.
        file_error: Relative standard deviation of the links' numbers.
        pool: Candidates of all effects at all places.
        laws: Unknown laws of all joints.
        noise: Noise of each joint, and errors of laws and simulators.
    """

    def __init__(
        self,
        gap: Gap,
        learn: Mask | None = None,
        without: Sequence[str] = (),
    ) -> None:
        self.gap, self.prior = gap, Prior()
        self.learn = np.ones(len(gap.fold), dtype=bool) if learn is None else learn
        self.evidence = Evidence(gap, self.learn)
        self.rigid, blocks = add_background(self.evidence, self.prior)
        self.declared = np.concatenate(blocks)
        self.numbers = np.concatenate(blocks[: gap.robot.size])
        self._numbers_of = list(zip(map(max, background(gap)[0]), blocks, strict=True))
        self.file_error = self.prior.file_errors[1]
        self.pool = Pool(self.evidence, without)
        self.pool.add_ripples(self.rigid, _RIPPLES)
        estimate_noise(self.evidence, np.arange(self.evidence.size))
        self.noise = NoiseModel(self.evidence, self.prior)
        self._set_noise()
        self.pool.add_contacts(self.rigid)
        self.laws = UnknownLaws(self.evidence, self.rigid, self.prior)
        self._causes: dict[tuple[object, ...], Cause] = {}

    def _set_noise(self) -> None:
        """Set the noise model, and forget all that depends on it."""
        self.noise.apply(self.rigid)
        rigid = self.evidence.solve(self.rigid)
        squares = self.evidence.weighted_squares(rigid.index, rigid.gains)
        self._explainable = squares / 2
        self._cache: dict[tuple[object, ...], Any] = {}
        self.__dict__.pop("test", None)

    def model_error_odds(self, c: Cause | Candidate) -> float:
        """Evidence for a cause that may come from the errors of other laws, [nat]."""
        known, at = isinstance(c, Candidate) or c.candidate is not None, [*c.place[1]]
        part = self.noise.law_errors[at] if known else self.prior.real_law_error
        return float(np.max(part**2 * self._explainable[at]))

    def odds(self, c: Cause) -> float:
        """Log odds against a cause, [nat]."""
        return c.cost + self.model_error_odds(c)

    @property
    def reported_file_error(self) -> float:
        """Relative error of the links' numbers to which intervals refer."""
        return max(self.file_error, self.prior.file_errors[2])

    def columns(self, causes: Sequence[Cause]) -> Index:
        """Columns of the background and of some causes, shape (k,)."""
        return np.concatenate([self.rigid, *(c.index for c in causes)])

    def columns_of(self, cause: Cause) -> Columns:
        """Torque per unit of each gain of a cause, by joint, shape (M, p) each."""
        if cause.candidate is None:
            return self.laws.columns(cause)
        return self.gap.columns(cause.candidate.effect)

    def cause(self, c: Candidate) -> Cause:
        """Make a cause of a candidate, and add its columns, once."""
        key = c.place, tuple(c.effect.values.items()), c.prior_factor
        if key not in self._causes:
            columns, std = self.gap.columns(c.effect), c.prior_factor * c.std
            (index,) = self.evidence.add([columns], [std])
            cost = self._kind_odds(self._places(type(c.effect)))[0] + price(c.effect)
            cost += float(size_odds(c.prior_factor))
            self._causes[key] = Cause(c.place, index, cost, c, c.effect.rough)
        return self._causes[key]

    def score(self, causes: Sequence[Cause]) -> float:
        """Log posterior of an explanation, up to a constant, [nat]."""

        def score() -> float:
            found = self.evidence.solve(self.columns(causes))
            known = found.evidence + self._log_bounded(found, causes)
            known += self.noise.gain_if_lower(found)
            return known - sum(map(self.odds, causes))

        found: float = self._cached(score, "score", frozenset(causes))
        return found + self.kind_discount(causes)

    def _log_bounded(self, found: Solution, causes: Sequence[Cause]) -> float:
        """Log evidence that gains are above their lower bounds, [nat].

        Their prior ends there, and the evidence of a solution knows no bounds: gains
        that cancel one another would be as good as others.
        """
        known = [(c.index, c.candidate.lower) for c in causes if c.candidate]
        if not known:
            return 0.0
        index, lower = map(np.concatenate, zip(*known, strict=True))
        after = (found.of(index) - lower) / found.std(index)
        before = -lower * np.sqrt(self.evidence.precision[index])
        return float(np.sum(log_ndtr(after) - log_ndtr(before)))

    def _cached(self, function: Callable[[], Any], *arguments: object) -> Any:
        """Value of a function of some arguments, and of the error of the file."""
        key = *arguments, float(self.evidence.precision[self.numbers[0]])
        if key not in self._cache:
            self._cache[key] = function()
        return self._cache[key]

    def kind_discount(self, causes: Sequence[Cause]) -> float:
        """Discount on the odds for causes of one kind at many places, [nat].

        The cost of each cause is that of a kind at one of its places. At many places it
        is that of a kind which each place may have with one half: a file without
        friction lacks it at all joints.
        """
        # In their order: that of a set would differ from run to run, and with it a sum.
        places = dict.fromkeys(c.place for c in causes if c.candidate is not None)
        count, less = Counter(kind for kind, _ in places), 0.0
        for kind, k in count.items():
            one, every = self._kind_odds(self._places(effect_classes()[kind]))
            less += max(k * one - every, 0.0)
        return less

    def _kind_odds(self, places: int) -> tuple[float, float]:
        """Log odds against a kind of cause at one place, and at any of all, [nat].

        All kinds are as probable as one that each joint may have.
        """
        each = self.prior.cause
        one = each + np.log(places / self.gap.robot.size)
        return float(one), float(each + places * np.log(2.0))

    def _places(self, kind: type[Effect]) -> int:
        """Number of places for a kind of cause."""
        size = self.gap.robot.size
        count: int = self._cached(lambda: sum(1 for _ in kind.places(size)), kind)
        return count

    def file_error_odds(self, error: float) -> float:
        """Log odds against a relative error of the links' numbers, [nat].

        An error above the typical one costs as much as a kind of cause that each joint
        may have: any link may be another one then.
        """
        typical = self.prior.file_errors[1]
        far = np.log(error / typical) / np.log(self.prior.file_factor)
        _, kind = self._kind_odds(self.gap.robot.size)
        return float(0.5 * far**2 + (kind if error > typical else 0.0))

    def refine(self, base: Index, c: Candidate) -> tuple[Candidate, float]:
        """See :func:`.refine.refine`; results are cached."""
        fit = partial(refine, self.evidence, base, c)
        key = base.tobytes(), c.place, tuple(c.effect.values.items())
        found: tuple[Candidate, float] = self._cached(fit, *key)
        return found

    def held_out_loss(self, causes: Sequence[Cause]) -> Array:
        """Cross-validated loss of some causes, shape (2,), [nat]."""
        return np.asarray(self.held_out_losses(causes).sum(axis=0))

    def held_out_losses(self, causes: Sequence[Cause]) -> Array:
        """The same of each fold, shape (F, 2), [nat].

        See :meth:`.Evidence.held_out_losses`; the log prior of the background is added,
        in equal parts.
        """

        def losses() -> Array:
            evidence, columns = self.evidence, self.columns(causes)
            squares = evidence.held_out_losses(columns)
            prior = evidence.prior_squares(evidence.solve(columns), self.rigid)
            return np.asarray((squares + prior / len(squares)) / 2)

        return np.asarray(self._cached(losses, "held-out loss", frozenset(causes)))

    def is_isolated(
        self, cause: Cause, causes: Sequence[Cause], test: OtherSamples | None = None
    ) -> bool:
        """Whether one of some causes is an event, and not a part of what recurs.

        Its torque has to be all that happens around its time, and no unknown law that
        fits all other times may foretell it.

        Args:
            cause: The cause.
            causes: All causes, which are fitted together.
            test: The samples; those of training by default.
        """
        if cause.candidate is None or not cause.is_event:
            return False
        seen, near = test or self, around(self.gap, cause.candidate.effect)
        evidence, index = seen.evidence, seen.columns(causes)
        own = cause.index if test is None else test.own(cause)
        gains, columns = evidence.solve(index).of(own), self.columns_of(cause)
        left, rows = evidence.residuals(index), evidence.rows
        torque = [columns[i][r] @ gains for i, r in enumerate(rows)]
        sizes = np.array([x @ x for x in torque]) / evidence.noise
        i = int(np.argmax(sizes))  # other joints may have gaps of their own
        before, then = left[i] + torque[i], near[rows[i]]
        # The estimate of the noise may hold other events: most samples count.
        noise = min(evidence.noise[i], robust_std(left[i]) ** 2)
        rest = (left[i][then] ** 2 - noise).sum()
        alone = rest < self.prior.event_error**2 * (before[then] ** 2).sum()
        if not alone or test is not None:
            return bool(alone)
        return self.laws.foretold(i, before, then) < self.prior.event_error

    def unseen_loss(self, causes: Sequence[Cause]) -> Array:
        """Loss of some causes on the test samples, shape (2,), [nat].

        The first loss is of whitened samples, the second one takes samples as
        independent. Both are scaled to the number of training samples, and the log
        prior of the background is added.
        """
        seen, test = self.evidence, self.test
        losses = test.weighted_squares(causes), test.squares(causes) / seen.noise
        prior = seen.prior_squares(seen.solve(self.columns(causes)), self.rigid)
        return np.asarray((np.sum(losses, axis=1) * self._to_training + prior) / 2)

    def unseen_gain(self, causes: Sequence[Cause]) -> dict[Cause, float]:
        """By how much each cause lowers :meth:`unseen_loss`, [nat].

        The smaller fall of both losses counts. All other causes are refitted without
        it, and the simpler law that it becomes may take its place. At its joints the
        explanation has to leave less than the file as it stands, too. Of an event that
        is not on the test samples they say nothing: it has to explain its time.
        """
        if not causes:
            return {}
        whole, gains = self.unseen_loss(causes), dict[Cause, float]()
        falls = self._falls(causes)
        for c in causes:
            if c.is_event and not self.test.tests(c, causes):
                gains[c] = np.inf if self.is_isolated(c, causes) else 0.0
                continue
            rest = [x for x in causes if x is not c]
            others = [rest, *([*rest, x] for x in self._simpler(c, rest))]
            gains[c] = float(min(np.min(self.unseen_loss(x) - whole) for x in others))
            if c.candidate is not None and self.test.tests(c, causes):
                here = [*c.candidate.effect.reaches(len(falls))]
                gains[c] = min(gains[c], float(falls[here].sum()))
        return gains

    def _falls(self, causes: Sequence[Cause]) -> Array:
        """Fall of each joint's loss from the file as it stands, shape (n,), [nat].

        Stretches where some causes leave much more than usual, as in an event without
        a cause, do not count: whatever fits a part of that is no better elsewhere.
        """
        test, falls = self.test.evidence, list[float]()
        each = zip(test.rows, test.left, self.test.residuals(causes), strict=True)
        for row, before, after in each:
            use = without_events(after, row, self.gap.rate)
            falls.append(float(before[use] @ before[use] - after[use] @ after[use]))
        return np.array(falls) * self._to_training / self.evidence.noise / 2

    @property
    def _to_training(self) -> float:
        """Number of training samples over that of test samples."""
        unseen = max(self.test.evidence.count.sum(), 1)
        return float(self.evidence.count.sum() / unseen)

    def _simpler(self, c: Cause, rest: Sequence[Cause]) -> list[Cause]:
        """The simpler law that a cause becomes, unless it is among the rest."""
        becomes = c.candidate.effect.becomes if c.candidate else None
        if not becomes or not becomes[2] or becomes[2] in self.pool.without:
            return []
        place = becomes[2], c.place[1]
        if any(x.place == place for x in rest):
            return []
        effect = effect_classes()[place[0]](place[1])
        return [self.cause(candidate(self.gap, effect))]

    @cached_property
    def test(self) -> OtherSamples:
        """The test samples."""
        return OtherSamples(self, unseen_samples(self.gap, self.learn))

    def update_noise(self, causes: Sequence[Cause]) -> bool:
        """Lower the noise where some causes leave less; return whether they do."""
        lower = self.noise.lower(self.rigid, self.columns(causes))
        if lower:
            self._set_noise()
        return lower

    def doubtful_joints(self, causes: Sequence[Cause]) -> list[int]:
        """Joints at which the file's numbers are as improbable as a cause."""
        found = self.evidence.solve(self.columns(causes))
        far = {
            joint for joint, index in self._numbers_of
            if self.evidence.prior_squares(found, index) / 2 > self.prior.cause
        }  # fmt: skip
        return sorted(far)

    def set_file_error(self, error: float) -> None:
        """Set the relative error of the links' numbers, and the noise for it."""
        self.file_error = error
        self.evidence.scale_prior(self.numbers, error)
        self._set_noise()


def around(gap: Gap, contact: Effect) -> Mask:
    """Samples of a contact, and as many before and after, which bound it; (M,)."""
    start, length, recording = (
        contact.values[x] for x in ("start", "duration", "recording")
    )
    t, reach = gap.sampled.t, length + 1.0 / gap.cutoff
    near = (t >= start - reach) & (t < start + length + reach)
    return np.asarray(near & ((recording < 0) | (gap.trajectory == recording)))
