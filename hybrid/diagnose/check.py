"""Whether a term is good enough to be the cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.diagnose.account import Account
from hybrid.diagnose.attribute import Search
from hybrid.diagnose.candidates import scale_of, with_gains
from hybrid.diagnose.gap import Gap
from hybrid.diagnose.term import Term
from hybrid.diagnose.thresholds import Thresholds
from hybrid.effects.contact import Contact
from hybrid.effects.effect import Port
from hybrid.effects.torque_ripple import TorqueRipple

_ECHO = 0.1  # of the evidence, least in the lower half of the band
_SLACK = 0.02  # of the range of a gain
_HALF = 0.5  # of what is there, explained by laws that hold roughly
_NEAR, _SERIES = 2.2, 4  # waves over the range of a joint between orders; how many
_MOST_CONTACTS = 3  # what happens more often is no contact
_MOST_TOUCHED = 0.6  # of the time; what lasts longer is none


@dataclass(frozen=True)
class Check:
    """What speaks against a term.

    Attributes:
        complete: Part of what is explainable at its joints that the terms there do,
            and of what the term itself adds to the gap of others. What numbers of the
            file would do without it, were they further off, it does.
        unsteady: Squares that its gains would still take from the gap if each fold had
            its own, over those that the term takes.
        crowd: Number of terms at its joint.
        remains: Squares of its torque and of another's together, over those of each,
            for the term of its kind at its joint that undoes it most.
        physical: Whether its gains are what such an effect may have.
        minor: Whether the terms at its joints do not explain what is there, or not
            half of it if some law holds roughly; or not half of the whole arm's, if it
            is on signals, or a body: what joint passes on to joint may look like one.
        echo: Whether its evidence is in the upper half of the band, where it may be of
            noise that its columns and the gap share.
        rough: Whether its law holds roughly, so that it may leave more.
        recurs: Whether it is of what happens once, and there are many such, or it lasts
            nearly all the time; or an order of ripple that is one of a series.
    """

    complete: float
    unsteady: float
    crowd: int
    remains: float
    physical: bool
    minor: bool
    echo: bool
    rough: bool
    recurs: bool

    def passes(self, limits: Thresholds) -> bool:
        """Whether the term may be named."""
        return self.sound(limits) and not self.echo

    def sound(self, limits: Thresholds) -> bool:
        """Whether it might be, were it not for noise that looks like it."""
        return (
            self.complete >= (limits.roughly if self.rough else limits.complete)
            and self.unsteady <= limits.steady
            and self.crowd <= limits.crowded
            and self.remains >= limits.undone
            and self.physical
            and not self.minor
            and not self.recurs
        )


def check(search: Search, term: Term, found: Account, limits: Thresholds) -> Check:
    """What speaks against a term of a search.

    Args:
        search: The search.
        term: One of its terms.
        found: The account of its gap.
        limits: How much of a gap is enough.
    """
    evidence = search.evidence
    whole, without = (evidence.solve(search.base(t)) for t in (None, term))
    left = evidence.squares(without.index, without.gains).sum(axis=1) / evidence.noise
    gained = np.maximum(left - found.after, 0.0)
    # The joints where it explains most; others it merely touches.
    main = gained > 0.2 * gained.max() if gained.max() > 0 else gained >= 0
    # Without it numbers of the file may explain as much, if they are far enough off.
    rigid = search.background
    relief = max(0.0, evidence.strain(without, rigid) - evidence.strain(whole, rigid))
    explained = found.explained[main].sum() + relief
    # What it surely adds where it does not belong is not explained either.
    added = np.where(found.after - left > limits.evident, found.after - left, 0.0)
    remains = found.recovered[main].sum() + added.sum()
    if explained < _HALF * found.before[main].sum():
        remains += found.doubtful[main].sum()
    complete = explained / max(explained + remains, 1e-12)
    joint = term.place[1]
    crowd = sum(t.place[1] == joint for t in search.terms)
    missed = np.maximum(found.missed, found.refused)
    rough = any(t.candidate.effect.steep for t in search.terms)
    least = _HALF if rough else limits.roughly
    minor = explained < least * (explained + missed[main].sum())
    minor |= bool(_kind(term)) and explained < missed.sum()
    contacts = [t for t in search.terms if t.place[0] == Contact.id]
    return Check(
        float(complete),
        _unsteady(search, term),
        crowd,
        _remains(search, term),
        _physical(search, term),
        bool(minor),
        _echo(search, term),
        term.candidate.effect.steep,
        term in contacts and _all_along(search.gap, contacts) or _series(search, term),
    )


def _all_along(gap: Gap, contacts: Sequence[Term]) -> bool:
    """Whether contacts are too many, or fill one of the recordings."""
    if len(contacts) > _MOST_CONTACTS:
        return True
    for motion in gap.motions:
        here = [
            c.candidate.effect.values["duration"]
            for c in contacts
            if c.candidate.effect.values["recording"] in (-1.0, motion.number)
        ]
        if sum(here) > _MOST_TOUCHED * (motion.t[-1] - motion.t[0]):
            return True
    return False


def _physical(search: Search, term: Term) -> bool:
    """Whether gains and shapes are within bounds; a scanned one not where it ends.

    Those of bodies have no bounds of their own: their priors hold them. Nor is there
    an upper one where it goes with the rated torque, which many files do not know.
    """
    effect = term.candidate.effect
    if effect.port is Port.BODY:
        return True
    solution = search.evidence.solve(search.base())
    gains = solution.of(term.index)
    least = term.candidate.lower
    if np.any((least > 0) & (gains < least)):
        return False
    motions = search.gap.motions
    if not all(map(effect.holds, motions)) or all(map(effect.imitates, motions)):
        return False
    law = with_gains(effect, gains).as_reported()
    for gain, lowest in zip(law.gains, least, strict=True):
        bound = gain.scaled(scale_of(search.gap, law))
        lowest = lowest if np.isfinite(lowest) else bound.lower
        value, slack = law.values[gain.name], _SLACK * (bound.upper - bound.lower)
        if effect.steep:
            if value > bound.upper - slack:
                return False
        elif value < lowest - slack:
            return False
        elif gain.per == (0, 0) and value > bound.upper + slack:
            return False
    return True


def _series(search: Search, term: Term) -> bool:
    """Whether orders of ripple at a joint are a wave or two over its range apart.

    So many of them are the Fourier series of a law over this range, whatever it is.
    """
    if term.place[0] != TorqueRipple.id:
        return False
    gap, joint = search.gap, term.place[1][0]
    alike = [t.candidate.effect for t in search.terms if t.place == term.place]
    q = gap.sampled.q[gap.moving[:, joint], joint]
    apart = np.diff(sorted(e.values["periods"] for e in alike))
    near = apart * max(float(np.ptp(q)), 1e-9) < _NEAR * 2 * np.pi
    return int(np.sum(np.append(near, False) | np.insert(near, 0, False))) >= _SERIES


def _echo(search: Search, term: Term) -> bool:
    """Whether columns of the lower half of the band show next to nothing of a term."""
    c, base = term.candidate, search.base(term)
    if not c.effect.echoes:
        return False
    whole, lower = (
        search.evidence.trial(base, columns, c.std, c.lower)[0]
        for columns in (
            search.gap.columns(c.effect),
            search.gap.columns(c.effect, calm=True),
        )
    )
    return lower < _ECHO * whole


def _remains(search: Search, term: Term) -> float:
    """What is left of a term beside the one that undoes it most.

    Two effects on signals, or on bodies, of which each is large and little is left of
    both, are a makeshift for something else. Laws of friction may well do so.
    """
    alike = [
        t
        for t in search.terms
        if t is not term
        and t.place[1][-1] == term.place[1][-1]
        and _kind(t) == _kind(term)
    ]
    if not alike or not _kind(term):
        return 1.0
    evidence, terms = search.evidence, [term, *alike]
    solution = evidence.solve(search.base())
    A, _ = evidence.normal(solution.index)
    # Gains of each term, zero elsewhere; their products are those of its torques.
    gains = [
        np.where(np.isin(solution.index, t.index), solution.gains, 0) for t in terms
    ]
    products = np.stack(gains) @ A @ np.stack(gains).T
    each = products[0, 0] + np.diag(products)[1:]
    return float(np.min(1.0 + 2 * products[0, 1:] / np.maximum(each, 1e-12)))


def _kind(term: Term) -> str:
    effect = term.candidate.effect
    if effect.observes or effect.reports:
        return "signal"
    return "body" if effect.port is Port.BODY else ""


def _unsteady(search: Search, term: Term) -> float:
    """What a term's gains lose by being the same on all folds, over what they gain."""
    evidence, base = search.evidence, search.base(term)
    rest = evidence.solve(base)
    others = np.zeros(evidence.size)
    others[rest.index] = rest.gains
    whole = evidence.solve(search.base())
    others[whole.index] = whole.gains
    p, total, count = len(term.index), 0.0, 0
    mean = others[term.index]
    for f in range(len(evidence.folds)):
        both = np.concatenate([term.index, base])
        A, b = evidence.normal(both, np.array([f]))
        H = A[:p, :p]
        if np.trace(H) <= 0:
            continue
        # The others stay as all folds have them.
        s = b[:p] - A[:p, p:] @ others[base] - H @ mean
        unit = np.sqrt(np.maximum(np.diag(H), 1e-300))
        values, vectors = np.linalg.eigh(H / unit / unit[:, None])
        keep = values > 1e-3
        score = vectors[:, keep].T @ (s / unit)
        total += float((score**2 / values[keep]).sum())
        count += int(keep.sum())
    taken = 2 * whole.evidence - 2 * rest.evidence
    return max(0.0, total - count) / max(taken, 1.0)
