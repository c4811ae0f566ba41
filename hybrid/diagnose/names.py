"""Which of two names to give what has the same columns under both."""

from __future__ import annotations

from dataclasses import replace

from hybrid.diagnose.candidates import Candidate, candidate
from hybrid.diagnose.model import ALIKE, Model
from hybrid.diagnose.refine import gain
from hybrid.diagnose.reversals import vanishes
from hybrid.diagnose.term import Term
from hybrid.effects.asymmetric_friction import AsymmetricFriction
from hybrid.effects.counterbalance import Counterbalance
from hybrid.effects.payload import LinkInertia, Payload
from hybrid.effects.spring import Spring
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.torque_ripple import TorqueRipple

_ANGLE = 6.0  # nats that a second amplitude costs, and an angle does not


def name_plainly(model: Model) -> None:
    """Exchange the terms of a model for the plainest effects that they may be."""
    for k, term in enumerate(model.terms):
        plain = None
        if term.place[0] in (LinkInertia.id, Payload.id):
            plain = _load(model, term)
        elif term.place[0] == Counterbalance.id:
            plain = _without_a_crank(model, term)
        elif term.place[0] in (TorqueOffset.id, AsymmetricFriction.id):
            plain = _at_reversals(model, term)
        if plain is not None:
            model.terms[k] = model.term(plain)


def _load(model: Model, term: Term) -> Candidate | None:
    """A link for a last one that is too light, or else a payload.

    A link may be wrong anywhere, and either way; a payload is here alone, and heavy.
    """
    joints, mass = term.place[1], term.index[:1]
    solution = model.evidence.solve(model.base())
    (more,), (deviation,) = solution.of(mass), solution.deviation(mass)
    kind = LinkInertia if more < -deviation else Payload
    if kind.id == term.place[0] or not model.pool.at((kind.id, joints)):
        return None
    return replace(term.candidate, effect=kind(joints, term.candidate.effect.values))


def _without_a_crank(model: Model, term: Term) -> Candidate | None:
    """A spring or a ripple, if a counterbalance is no better than it.

    On a crank too short for one, its torque repeats once per turn.
    """
    joints, base = term.place[1], model.base(term)
    least = model.loss(term) - _ANGLE
    for effect in (Spring(joints), TorqueRipple(joints, {"periods": 1.0})):
        c = candidate(model.gap, effect)
        if model.pool.at(c.place) and gain(model.evidence, base, c) > least:
            return c
    return None


def _at_reversals(model: Model, term: Term) -> Candidate | None:
    """Friction that differs by direction, or an offset, if reversals tell that."""
    gone = vanishes(model, term)
    if gone is None:
        return None
    other = AsymmetricFriction if gone else TorqueOffset
    found = model.pool.at((other.id, term.place[1]))
    if other.id == term.place[0] or not found:
        return None
    least = model.loss(term) - ALIKE
    better = gain(model.evidence, model.base(term), found[0]) > least
    return found[0] if better else None
