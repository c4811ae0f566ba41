"""How probable an explanation of a gap is.

An explanation is a set of causes. Its score is the log marginal likelihood of the gap,
with all gains integrated out under their priors, less the odds against each cause:

    log p(gap | causes) + Σ log p(cause).

Causes are effects of the library at places of the arm, and unknown laws of a joint. The
noise is that of the gap which no flexible regression removes, nor the explanation, and
the part of the gap by which any law of the library may be inexact.

Source: MacKay 1992, doi 10.1162/neco.1992.4.3.415 (evidence and its Occam factor).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.candidates import Candidate
from hybrid.diagnosis.evidence.estimate import estimate_noise, lower_noise
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.pool import Pool
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.evidence.refine import refine
from hybrid.diagnosis.evidence.shapes import price
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.elsewhere import Elsewhere
from hybrid.diagnosis.explanations.laws import Laws
from hybrid.diagnosis.explanations.weight import weigh
from hybrid.diagnosis.gap.background import background, clocks, rest
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.diagnosis.gap.split import between
from hybrid.diagnosis.prior import Prior

_RIPPLES = 9  # orders at each joint, of which noise is estimated


class Posterior:
    """The log posterior of any causes of a gap.

    Args:
        gap: The gap.
        learn: Samples to learn from, shape (M,); all by default.
        without: Ids of effects to leave out of the library.
        prior: What is believed before any recording.

    Attributes:
        evidence: Cross-products of the gap on the samples to learn from.
        rigid: Columns of the background: of the file's numbers, and what is open of any
            log.
        numbers: Those of the file's numbers.
        off: How far off these may be, relative.
        pool: Effects of the library at all places.
        laws: Unknown laws of all joints.
        noise: Variance of each joint's noise, shape (n,), [N²·m²].
    """

    def __init__(
        self,
        gap: Gap,
        learn: NDArray[np.bool_] | None = None,
        without: Sequence[str] = (),
        prior: Prior | None = None,
    ) -> None:
        self.gap, self.prior = gap, prior or Prior()
        self.learn = np.ones(len(gap.fold), dtype=bool) if learn is None else learn
        self.evidence = Evidence(gap, self.learn)
        columns, sizes = background(gap)
        blocks = self.evidence.add(columns, sizes)
        self.numbers = np.concatenate(blocks)
        self._numbers_of = list(zip(map(max, columns), blocks, strict=True))
        self.off = self.prior.file[1]
        self.evidence.spread(self.numbers, self.off)
        own = self.evidence.add(*rest(gap)) + self.evidence.add(*clocks(gap))
        self.rigid = np.concatenate([self.numbers, *own])
        self.pool = Pool(self.evidence, without)
        self.pool.take_ripples(self.rigid, _RIPPLES)
        estimate_noise(self.evidence, np.arange(self.evidence.size))
        self.noise = self.evidence.noise.copy()
        self._weigh()
        self.pool.take_contacts(self.rigid)
        self.pool.take_steep(self.rigid)
        self.laws = Laws(self.evidence, self.rigid, self.prior)

    def _weigh(self) -> None:
        """Let noise be what it is, and what no law and no simulator has exactly."""
        self.covariances = weigh(self.evidence, self.noise, self.rigid, self.prior)
        rigid = self.evidence.solve(self.rigid)
        self._whole = self.evidence.lost(rigid.index, rigid.gains) / 2
        self._kept: dict[tuple[object, ...], tuple[Candidate, float]] = {}
        self._asked: dict[tuple[object, ...], Array] = {}
        self.__dict__.pop("test", None)

    def mimicked(self, c: Cause | Candidate) -> float:
        """What a cause may be worth that is but the inexactness of another, [nat]."""
        known = isinstance(c, Candidate) or c.candidate is not None
        part = self.prior.inexact if known else self.prior.misfit
        return float(part**2 * self._whole[list(c.place[1])].max())

    def odds(self, c: Cause) -> float:
        """Odds against a cause, [nat]."""
        return c.cost + self.mimicked(c)

    @property
    def widest(self) -> float:
        """How far off the file's numbers may be at least, where values are stated."""
        return max(self.off, self.prior.file[2])

    def columns(self, causes: Sequence[Cause]) -> Index:
        """Columns of the background and of some causes, shape (k,)."""
        return np.concatenate([self.rigid, *(c.index for c in causes)])

    def columns_of(self, cause: Cause) -> Columns:
        """Torque per unit of each gain of a cause, by joint, shape (M, p) each."""
        if cause.candidate is None:
            return self.laws.columns(cause)
        return self.gap.columns(cause.candidate.effect)

    def cause(self, c: Candidate) -> Cause:
        """An effect as a cause."""
        std = c.wider * c.std
        (index,) = self.evidence.add([self.gap.columns(c.effect)], [std])
        cost = self.prior.cause + price(c.effect) + float(np.log(c.wider))
        return Cause(c.place, index, cost, c, c.effect.rough)

    def score(self, causes: Sequence[Cause]) -> float:
        """Log posterior of an explanation, up to a constant, [nat]."""

        def score() -> Array:
            known = self.evidence.solve(self.columns(causes)).evidence
            return np.asarray(known - sum(map(self.odds, causes)))

        return float(self._once("score", causes, score)) + self.alike(causes)

    def _once(
        self, what: str, causes: Sequence[Cause], found: Callable[[], Array]
    ) -> Array:
        """What is asked of some causes again and again, kept while it holds."""
        off = float(self.evidence.precision[self.numbers[0]])
        key = what, frozenset(causes), off
        if key not in self._asked:
            self._asked[key] = found()
        return self._asked[key]

    def alike(self, causes: Sequence[Cause], more: str = "") -> float:
        """How much less causes cost that are of one kind, at many joints, [nat].

        A file that has no friction has none at any joint: that is as probable as one
        cause, and then each joint may have some or not.

        Args:
            causes: The causes.
            more: Kind of one that there is besides.
        """
        places = {c.place for c in causes if c.candidate is not None}
        count = Counter([*(kind for kind, _ in places), *([more] if more else [])])
        less = [max(self.prior.cause * k - self._at_many, 0.0) for k in count.values()]
        return float(sum(less))

    @property
    def _at_many(self) -> float:
        """Odds against one kind of cause at any of the joints, [nat]."""
        return float(self.prior.cause + self.gap.robot.size * np.log(2.0))

    def doubt(self, off: float) -> float:
        """Odds against the file's numbers being so far off, [nat].

        If they are farther off than is usual, each link may be another one, as causes
        may be of one kind.
        """
        usual = self.prior.file[1]
        far = np.log(off / usual) / np.log(self.prior.file_factor)
        return float(0.5 * far**2 + (self._at_many if off > usual else 0.0))

    def refine(self, base: Index, c: Candidate) -> tuple[Candidate, float]:
        """See :func:`.refine.refine`; kept, for the same is asked again and again."""
        shapes = tuple(c.effect.values.items())
        key = base.tobytes(), self.off, c.place, shapes
        if key not in self._kept:
            self._kept[key] = refine(self.evidence, base, c)
        return self._kept[key]

    def left_out(self, causes: Sequence[Cause]) -> Array:
        """What some causes lose on each fold by the others, shape (2,), [nat]."""

        def left_out() -> Array:
            seen, columns = self.evidence, self.columns(causes)
            strain = seen.strain(seen.solve(columns), self.rigid)
            return np.asarray((seen.left_out(columns) + strain) / 2)

        return self._once("left out", causes, left_out)

    def lost(self, causes: Sequence[Cause]) -> Array:
        """What some causes lose on unseen samples, less what a fit says, [nat].

        With samples as independent ones, and as they are: shape (2,).
        """
        seen, unseen = self.evidence, self.test.evidence
        lost = self.test.lost(causes), self.test.squares(causes) / seen.noise
        # As if as much were unseen as was learnt from.
        more = seen.count.sum() / max(unseen.count.sum(), 1)
        strain = seen.strain(seen.solve(self.columns(causes)), self.rigid)
        return np.asarray((np.sum(lost, axis=1) * more + strain) / 2)

    def unseen(self, causes: Sequence[Cause]) -> dict[Cause, float]:
        """By how much each cause lowers the squares on unseen samples, [nat].

        As they are and as independent samples: the less of both. Without it all others
        are fitted anew. Numbers of the file that take its place are farther off: that
        counts as much as before any recording.
        """
        if not causes:
            return {}
        whole, without = self.lost(causes), dict[Cause, float]()
        for c in causes:
            fall = self.lost([x for x in causes if x is not c]) - whole
            without[c] = float(fall.min())
        return without

    @cached_property
    def test(self) -> Elsewhere:
        """The samples kept for scoring."""
        return Elsewhere(self, ~self.learn & between(self.gap, self.learn))

    def listen(self, causes: Sequence[Cause]) -> bool:
        """Let noise be what the explanation leaves where that is less; whether it is.

        An explanation is one of the regressions that noise is what they leave of.
        """
        lower = lower_noise(self.evidence, self.noise, self.columns(causes))
        less = bool(np.any(lower != self.noise))
        if less:
            self.noise = lower
            self._weigh()
        return less

    def strained(self, causes: Sequence[Cause]) -> list[int]:
        """Joints at which a link of the file, or another number, is far off.

        So far, beside some causes, that it is as improbable as another one.
        """
        found = self.evidence.solve(self.columns(causes))
        far = {
            joint for joint, index in self._numbers_of
            if self.evidence.strain(found, index) / 2 > self.prior.cause
        }  # fmt: skip
        return sorted(far)

    def spread(self, off: float) -> None:
        """Take the file's numbers to be so far off; what is inexact is the rest."""
        self.off = off
        self.evidence.spread(self.numbers, off)
        self._weigh()
