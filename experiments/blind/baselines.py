"""What simpler methods would name, from the same columns of the same recordings.

- ``ranking``: the single candidate that shrinks the gap most on folds left out.
- ``stepwise``: forward selection by an F-test for independent errors, at 1 % over all.
- ``stlsq``: sequentially thresholded least squares over all candidates at once
  (Brunton et al. 2016, doi 10.1073/pnas.1517384113).
- ``fixed``: a fit of rotors, damping, dry friction and the last link's mass, and of
  nothing else, as tools of system identification make; each number whose interval
  excludes the file's.
- ``sysid``: the same by ``mujoco.sysid`` from one log in closed loop, where that is
  installed; see :mod:`.sysid`.

The first three free the rigid parameters without a prior, as is usual. None abstains
unless its own rule says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import f as f_distribution

from blind.score import Named
from blind.sysid import fit_sysid, has_sysid
from hybrid.arrays import Array, Index
from hybrid.diagnosis.answer.result import Result
from hybrid.diagnosis.evidence.candidates import Term
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.errors import IdentificationError
from hybrid.recording import Recording
from hybrid.robot import Robot

_RIDGE = 1e-6  # of the largest diagonal entry
_LEVEL = 0.01
_MOST = 10
_NORMAL = 1.96
_NUMBERS = {"armature", "viscous", "coulomb", "payload"}
_SMALL = 0.1  # of a joint's largest contribution: what STLSQ throws out


def baselines(result: Result, log: Recording) -> Mapping[str, tuple[Named, ...]]:
    """Causes that each method names, most important first.

    Args:
        result: A diagnosis, whose columns the methods share.
        log: One of its recordings.
    """
    search, robot = result.search, result.gap.robot
    evidence, base, tried = search.evidence, search.background, search.pool.tried
    peer = {"sysid": by_sysid(robot, log)} if has_sysid() else {}
    return peer | {
        "ranking": _named(_ranking(evidence, base, tried), robot),
        "stepwise": _named(_stepwise(evidence, base, tried), robot),
        "stlsq": _named(_stlsq(evidence, base, tried), robot),
        "fixed": _named(_fixed(evidence, tried), robot),
    }


def by_sysid(robot: Robot, log: Recording) -> tuple[Named, ...]:
    """What ``mujoco.sysid`` names; nothing where it fails.

    Args:
        robot: The file, with gains of its servos.
        log: Positions, torques, and commands.
    """
    try:
        return fit_sysid(robot, log).named()
    except IdentificationError:
        return ()


def _ranking(evidence: Evidence, base: Index, tried: Sequence[Term]) -> list[Term]:
    """The candidate that takes most squares off folds left out, off each of them."""
    folds = list(zip(*evidence.normal_by_fold(_columns(base, tried)), strict=True))
    whole, moments = (np.sum(x, axis=0) for x in zip(*folds, strict=True))
    gains = np.zeros((len(tried), len(folds)))
    for f, (G, m) in enumerate(folds):
        k, start = len(base), len(base)
        A, b, H, s, across = _schur(whole - G, moments - m, k)
        alone = np.linalg.solve(A, b)
        for c, term in enumerate(tried):
            own = np.arange(start, start + len(term.index))
            start += len(term.index)
            at = own - k
            own_gains = _solve(H[np.ix_(at, at)], s[at])
            rigid = alone - np.linalg.solve(A, across[:, at] @ own_gains)
            both = np.concatenate([np.arange(k), own])
            new = np.concatenate([rigid, own_gains])
            old = np.concatenate([alone, np.zeros(len(own))])
            part = G[np.ix_(both, both)]
            gains[c, f] = (
                2 * m[both] @ (new - old) + old @ part @ old - new @ part @ new
            )
    total = np.where(np.all(gains > 0, axis=1), gains.sum(axis=1), -np.inf)
    best = int(np.argmax(total))
    return [tried[best]] if np.isfinite(total[best]) else []


def _stepwise(evidence: Evidence, base: Index, tried: Sequence[Term]) -> list[Term]:
    """Candidates in the order in which an F-test takes them in."""
    chosen: list[Term] = []
    samples = int(evidence.count.sum())
    rest = float((evidence.power / evidence.noise).sum())
    for _ in range(_MOST):
        now = np.concatenate([base, *(t.index for t in chosen)])
        open_ = [t for t in tried if t not in chosen]
        A, b, H, s, _ = _schur(*evidence.normal(_columns(now, open_)), len(now))
        left = rest - float(b @ np.linalg.solve(A, b))
        ranked, start = [], 0
        for term in open_:
            p = len(term.index)
            own = slice(start, start + p)
            start += p
            fall = float(s[own] @ _solve(H[own, own], s[own]))
            freedom = samples - len(now) - p
            ratio = (fall / p) / max((left - fall) / freedom, 1e-300)
            chance = float(f_distribution.sf(ratio, p, freedom))
            ranked.append((chance, -ratio, term))  # many a chance is zero
        chance, _, best = min(ranked, key=lambda x: x[:2])
        if chance > _LEVEL / len(tried):
            break
        chosen.append(best)
    return chosen


def _stlsq(evidence: Evidence, base: Index, tried: Sequence[Term]) -> list[Term]:
    """Candidates left when small contributions are thrown out again and again."""
    A, b, H, s, _ = _schur(*evidence.normal(_columns(base, tried)), len(base))
    edges = np.cumsum([0, *(len(t.index) for t in tried)])
    kept = list(range(len(tried)))
    worth = np.zeros(len(tried))
    for _ in range(_MOST):
        if not kept:
            break
        at = np.concatenate([np.arange(edges[k], edges[k + 1]) for k in kept])
        gains = _solve(H[np.ix_(at, at)], s[at])
        full = np.zeros(len(s))
        full[at] = gains
        worth[:] = 0.0
        for k in kept:
            own = slice(edges[k], edges[k + 1])
            squares = float(full[own] @ H[own, own] @ full[own])
            worth[k] = np.sqrt(max(squares, 0.0))
        fewer = [k for k in kept if worth[k] > _SMALL * worth.max()]
        if fewer == kept:
            break
        kept = fewer
    return [tried[k] for k in sorted(kept, key=lambda k: -worth[k])][:_MOST]


def _fixed(evidence: Evidence, tried: Sequence[Term]) -> list[Term]:
    """Numbers of the file that a fit of these alone takes to be off, largest first."""
    own = [t for t in tried if t.place[0] in _NUMBERS]
    index = np.array([t.index[0] for t in own], dtype=np.intp)  # of a payload its mass
    A, b = evidence.normal(index)
    inverse = np.linalg.inv(A + _RIDGE * np.diag(np.diag(A)) + 1e-12 * np.eye(len(b)))
    values = inverse @ b
    whole = float((evidence.power / evidence.noise).sum())
    each = (whole - float(b @ values)) / max(int(evidence.count.sum()) - len(b), 1)
    telling = values**2 / np.diag(inverse) / max(each, 1e-300)
    order = np.argsort(-telling)
    return [own[k] for k in order if telling[k] > _NORMAL**2]


def _columns(base: Index, terms: Sequence[Term]) -> Index:
    return np.concatenate([base, *(t.index for t in terms)])


def _schur(G: Array, m: Array, k: int) -> tuple[Array, Array, Array, Array, Array]:
    """Of k columns and candidates: those (A, b), these freed of them (H, s), and both.

    Args:
        G: Normal matrix of all, shape (K, K).
        m: Their products with the gap, shape (K,).
        k: Number of columns before the candidates.
    """
    A = G[:k, :k] + _RIDGE * np.diag(np.diag(G)[:k] + 1e-12)
    across = G[:k, k:]
    inverse = np.linalg.solve(A, np.column_stack([across, m[:k]]))
    H = G[k:, k:] - across.T @ inverse[:, :-1]
    s = m[k:] - across.T @ inverse[:, -1]
    return A, m[:k], H, s, across


def _solve(H: Array, s: Array) -> Array:
    size = np.diag(np.diag(H)) * _RIDGE + 1e-12 * np.eye(len(s))
    return np.asarray(np.linalg.lstsq(H + size, s, rcond=None)[0])


def _named(terms: Sequence[Term], robot: Robot) -> tuple[Named, ...]:
    """Terms by effect, as a diagnosis groups them."""
    grouped: dict[str, list[int]] = {}
    for term in terms:
        effect = term.candidate.effect
        joints = effect.joints[-1:] if effect.id == "link_inertia" else effect.joints
        grouped.setdefault(effect.id, []).extend(joints)
    return tuple(
        Named(name, tuple(robot.joints[j] for j in sorted(set(joints))), (name,))
        for name, joints in grouped.items()
    )
