"""The pool of all candidates, with their columns."""

from collections.abc import Collection, Sequence

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.diagnosis.evidence.candidates import (
    Candidate,
    Place,
    Term,
    candidate,
    candidates,
    repeating,
    same_columns,
)
from hybrid.diagnosis.evidence.contacts import Contacts
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.ripples import ripple_orders
from hybrid.diagnosis.evidence.shapes import price
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.diagnosis.prior import Prior
from hybrid.effects import Effect

_Form = tuple[object, ...]

_RIPPLES, _MOST_RIPPLES = 3, 24  # orders added at each joint at a time, and in all


class Pool:
    """Candidates of all effects at all places.

    Args:
        evidence: Cross-products of the gap, to which their columns are added.
        without: Ids of effects to leave out of the library.

    Attributes:
        tried: The candidates with their columns.
    """

    def __init__(self, evidence: Evidence, without: Sequence[str]) -> None:
        self.gap: Gap = evidence.gap
        self.evidence = evidence
        self.without = tuple(without)
        self.tried: list[Term] = []
        self._fixed_gains: list[Array | None] = []
        self._prices: list[float] = []
        self._forms: list[_Form] = []
        events = repeating("recording", without)
        self._events = [Contacts(self.gap, law) for law in events]
        self._add(candidates(self.gap, without))
        self._add(
            [x for j in range(self.gap.robot.size) for x in self._ripples(j, [1])]
        )

    def _add(self, found: Sequence[Candidate]) -> None:
        blocks: list[Columns] = []
        kept: list[Candidate] = []
        for c in found:
            columns = self.gap.columns(c.effect)
            if blocks and kept[-1].place == c.place:
                if same_columns(columns, blocks[-1]):
                    continue  # the shape does not change the columns at zero gains
            blocks.append(columns)
            kept.append(c)
        if kept:
            index = self.evidence.add(blocks, [c.std for c in kept])
            self.tried += [Term(c, i) for c, i in zip(kept, index, strict=True)]
            self._fixed_gains += [c.fixed_gains(self.gap) for c in kept]
            self._prices += [price(c.effect) for c in kept]
            self._forms += [_form(c.effect) for c in kept]

    def add_ripples(self, base: Index, count: int = _RIPPLES) -> None:
        """Add ripples of the strongest orders at each joint in a base's residual."""
        sampled, found = self.gap.sampled, list[Candidate]()
        residuals = zip(self.evidence.rows, self.evidence.residuals(base), strict=True)
        for j, (rows, left) in enumerate(residuals):
            q, v = sampled.q[rows, j], sampled.v[rows, j]
            orders = ripple_orders(left, q, v, self.gap.cutoff, count)
            found += self._ripples(j, orders.tolist())
        self._add(found)

    def _ripples(self, joint: int, orders: Sequence[int]) -> list[Candidate]:
        """New ripples of some orders at a joint, up to a total number."""
        found: list[Candidate] = []
        for law in repeating("joint", self.without):
            place = law.id, (joint,)
            there = (t.candidate.effect for t in self.tried if t.place == place)
            known = {effect.values["periods"] for effect in there}
            room = max(0, _MOST_RIPPLES - len(known))
            new = [float(k) for k in orders if k not in known][:room]
            found += [candidate(self.gap, law((joint,), {"periods": k})) for k in new]
        return found

    def add_contacts(self, base: Index) -> None:
        """Add the contacts with the most evidence in the residual of a base."""
        left = self.evidence.residuals(base)
        found = self.contacts(self.evidence, left, Prior.most_repeated)
        known = [t.candidate.effect.shape_values for t in self.tried]
        self._add([c for c in found if c.effect.shape_values not in known])

    def contacts(
        self, evidence: Evidence, left: Sequence[Array], count: int
    ) -> list[Candidate]:
        """The contacts with the most evidence in the residual of some samples."""
        known = evidence.rows, evidence.noise
        found = (x.strongest(left, *known, count) for x in self._events)
        return [candidate(self.gap, c) for each in found for c in each]

    def ranked(
        self, base: Index, taken: Collection[Place] = (), less: Index | None = None
    ) -> list[tuple[Candidate, float]]:
        """The best candidate of each form of an effect at each place, best first.

        Forms are the values of inner shapes that are whole numbers. Places that are
        ``taken`` are excluded, and the columns ``less`` of the base are left out.

        Returns:
            Each candidate with its gain in log evidence, less its price, [nat].
        """
        gains = self.evidence.screen(
            base,
            [t.index for t in self.tried],
            [t.candidate.lower for t in self.tried],
            self._fixed_gains,
            np.zeros(0, dtype=np.intp) if less is None else less,
        )
        worth = gains - self._prices
        best: dict[_Form, tuple[Candidate, float]] = {}
        for k in np.argsort(-worth, kind="stable"):
            term = self.tried[k]
            if term.place not in taken:
                best.setdefault(self._forms[k], (term.candidate, float(worth[k])))
        return list(best.values())


def _form(effect: Effect) -> _Form:
    """Place of an effect, and its inner shapes that are whole numbers."""
    inner = (x.name for x in effect.shapes if x.inner and x.whole)
    return effect.id, effect.joints, *(effect.values[name] for name in inner)
