"""Everything that might be a cause, with its columns."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from hybrid.diagnosis.evidence.candidates import (
    Candidate,
    Place,
    candidate,
    candidates,
    fine_candidates,
    same,
)
from hybrid.diagnosis.evidence.contacts import Contacts
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.evidence.refine import gain
from hybrid.diagnosis.evidence.ripples import ripple_orders
from hybrid.diagnosis.evidence.shapes import price
from hybrid.diagnosis.evidence.term import Term
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.effects import effect_classes
from hybrid.effects.contact import Contact
from hybrid.effects.torque_ripple import TorqueRipple

_RIPPLES, _MOST_RIPPLES = 3, 24  # orders tried at each joint at a time, and in all
_CONTACTS = 2  # stretches of time tried at a time
_ODD = 10.0  # nats for any cause, without which a joint has no gap


class Pool:
    """Candidates of all effects at all places, whose columns are in the evidence.

    Args:
        evidence: Cross-products of the gap, with its background.
        without: Ids of effects to leave out of the library.
    """

    def __init__(self, evidence: Evidence, without: Sequence[str]) -> None:
        self.gap: Gap = evidence.gap
        self.evidence = evidence
        self.without = tuple(without)
        self.tried: list[Term] = []
        self._contacts = None if Contact.id in without else Contacts(self.gap)
        self._take(candidates(self.gap, without))
        self._take(
            [x for j in range(self.gap.robot.size) for x in self._ripples(j, [1])]
        )

    def _take(self, found: Sequence[Candidate]) -> None:
        blocks: list[Columns] = []
        kept: list[Candidate] = []
        for c in found:
            columns = self.gap.columns(c.effect)
            if blocks and kept[-1].place == c.place and same(columns, blocks[-1]):
                continue  # this shape does not show in first order
            blocks.append(columns)
            kept.append(c)
        if kept:
            index = self.evidence.add(blocks, [c.std for c in kept])
            self.tried += [Term(c, i) for c, i in zip(kept, index, strict=True)]

    def take_ripples(self, base: Index, count: int = _RIPPLES) -> None:
        """Take in ripples of the orders that stand out of what columns leave.

        Args:
            base: Columns that are in already.
            count: Number of orders, at each joint.
        """
        if TorqueRipple.id in self.without:
            return
        solution = self.evidence.solve(base)
        sampled, found = self.gap.sampled, list[Candidate]()
        for j, rows in enumerate(self.evidence.rows):
            left = self.evidence.residual(j, solution.index, solution.gains)
            q, v = sampled.q[rows, j], sampled.v[rows, j]
            orders = ripple_orders(left, q, v, self.gap.cutoff, count)
            found += self._ripples(j, orders.tolist())
        self._take(found)

    def _ripples(self, joint: int, orders: Sequence[int]) -> list[Candidate]:
        """Ripples of some orders at a joint that are not in yet, up to a number."""
        if TorqueRipple.id in self.without:
            return []
        place = TorqueRipple.id, (joint,)
        known = {x.effect.values["periods"] for x in self.at(place)}
        room = max(0, _MOST_RIPPLES - len(known))
        new = [float(k) for k in orders if k not in known][:room]
        effects = (TorqueRipple((joint,), {"periods": k}) for k in new)
        return [candidate(self.gap, effect) for effect in effects]

    def take_contacts(self, base: Index) -> None:
        """Take in contacts where most is left, in units of noise, by some columns."""
        if self._contacts is None:
            return
        evidence, solution = self.evidence, self.evidence.solve(base)
        left = [
            evidence.residual(i, solution.index, solution.gains)
            for i in range(len(evidence.rows))
        ]
        found = self._contacts.strongest(left, evidence.rows, evidence.noise, _CONTACTS)
        known = [t.candidate.effect.shape_values for t in self.tried]
        new = (c for c in found if c.shape_values not in known)
        self._take([candidate(self.gap, c) for c in new])

    def take_steep(self, base: Index) -> None:
        """Take in steep effects at the gain that adds most to some columns.

        Only at joints where there is a gap: their grid is too fine for all.
        """
        worth = {c.place: x for c, x in reversed(self.ranked(base))}
        odd = {joints[-1] for (_, joints), x in worth.items() if x > _ODD}
        for effect_id, joints in worth:
            cls = effect_classes()[effect_id]
            if cls.steep and joints[-1] in odd:
                fine = fine_candidates(self.gap, cls, joints)
                self._take([max(fine, key=lambda c: gain(self.evidence, base, c))])

    def at(self, place: Place) -> list[Candidate]:
        """All shapes of an effect that were tried at a place."""
        return [t.candidate for t in self.tried if t.place == place]

    def ranked(
        self, base: Index, taken: Collection[Place] = (), less: Index | None = None
    ) -> list[tuple[Candidate, float]]:
        """The best shape of each form of an effect at a place, most evidence first.

        Args:
            base: Columns that are in already.
            taken: Places where nothing more may be.
            less: Columns of the base that are to be left out.
        """
        gains = self.evidence.screen(
            base,
            [t.index for t in self.tried],
            [t.candidate.lower for t in self.tried],
            [t.candidate.made_at for t in self.tried],
            np.zeros(0, dtype=np.intp) if less is None else less,
        )
        best: dict[tuple[object, ...], tuple[Candidate, float]] = {}
        for term, worth in zip(self.tried, gains, strict=True):
            if term.place in taken:
                continue
            effect = term.candidate.effect
            inner = (x.name for x in effect.shapes if x.inner and x.whole)
            form = *term.place, *(effect.values[name] for name in inner)
            worth -= price(effect)
            if form not in best or worth > best[form][1]:
                best[form] = term.candidate, float(worth)
        return sorted(best.values(), key=lambda x: -x[1])
