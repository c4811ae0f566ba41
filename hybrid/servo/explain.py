"""Which numbers of a file are wrong: explanations of logs compete.

An explanation is a set of numbers that differ from the file's. Its evidence is the
Laplace approximation

    log p = −J(x̂) − ½ log |1 + S H S| − c · (how many)

with J of :mod:`hybrid.servo.fit`, prior deviations S, curvature H of the data, and the
odds c of one cause among some hundred places. Laws are never exact: numbers that do not
differ are the file's but for 3 % of S, and are integrated out.

J is a sum over joints, and a servo moves its own joint before others, so that joints
search side by side: the numbers that promise most by a secant of the replays are
fitted, and the best stays. A search starts at the file and, where everything may be
wrong, at a plain fit; at the end every number goes back to the file's, others making up
for it, and stays there if the evidence grows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.servo.drive import NAMES, PLAIN, QUANTITIES
from hybrid.servo.fit import SHARED, Estimate, Problem
from hybrid.servo.noise import Noise

COST = 5.0  # nats: prior odds of one number, among some hundred, to be wrong
# Shapes of friction have no number in the file; they are no cause of their own.
_SHAPES = np.isin(NAMES, ("stribeck_speed", "presliding"))[:, None]
_SIGN = NAMES.index("sign")
_SAME = 0.03  # of the prior deviation: closer numbers are the same
_RANKS = 2  # numbers of a joint that are fitted in a round, each alone
_TURNS = 4  # Gauss–Newton steps of one of them
_ROUNDS = 8
_LARGEST = 1.5  # of a probe's change
_CLEAR = 0.2  # of the best gain: less may be another joint's doing, and waits
_EQUAL = 3.0  # nats of likelihood: less is not told by motion
_CLOSE = 30.0  # nats: a loss by linear algebra below it is looked at again


@dataclass(frozen=True, eq=False)
class Explanation:
    """Servos with some numbers other than the file's.

    Attributes:
        found: Their numbers, and the errors of replays.
        causes: Numbers that differ, shape (len(QUANTITIES), n).
        equals: Numbers that would do as well in place of one: motion does not tell.
        losses: How much evidence is lost with one of them back, [nats]; not yet known
            where it is not there.
    """

    found: Estimate
    causes: NDArray[np.bool_]
    equals: Mapping[tuple[int, int], tuple[int, ...]] = field(default_factory=dict)
    losses: Mapping[tuple[int, int], float] = field(default_factory=dict)


@dataclass(frozen=True)
class _Move:
    """A number that may differ, by a secant of replays."""

    k: int
    j: int
    gain: float
    x: Array


@dataclass(frozen=True, eq=False)
class _Base:
    """Curvature of the posterior about servos, over P numbers that may differ."""

    places: NDArray[np.int_]  # (P, 2)
    slopes: Array  # (P, M, n)
    matrix: Array
    gradient: Array
    weight: Array  # (M, n)
    spread: Array  # (P,)

    @property
    def all(self) -> NDArray[np.bool_]:
        """Every number."""
        return np.ones(len(self.places), dtype=bool)

    def quad(self, own: NDArray[np.bool_]) -> float:
        """Fall of the cost when some of the numbers go where they like."""
        pull = self.gradient[own]
        return float(0.5 * pull @ np.linalg.solve(self.matrix[np.ix_(own, own)], pull))


class Search:
    """Explanations of logs.

    Args:
        problem: The logs.
        errors: What good replays miss, shape (M, n), [rad].
        moving: Joints that move, shape (n,).
        known: Effects that are no candidates.
        hint: Coordinates that may hold, shape (len(QUANTITIES), n).
        progress: Is told what is done.
    """

    def __init__(
        self,
        problem: Problem,
        errors: Array,
        moving: NDArray[np.bool_],
        known: Sequence[tuple[int, int]] = (),
        *,
        hint: Array,
        progress: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.problem, self.hint, self._best = problem, hint, errors
        self.noise = Noise.of(errors, problem.pulled, problem.stretches)
        self.progress = progress
        self.shapes = _SHAPES & moving
        self.soft = np.isin(NAMES, (*PLAIN, "zero"))[:, None] & moving
        self.allowed = ~_SHAPES & moving
        for k, j in known:
            self.allowed[k, j] = False

    def _learn(self, errors: Sequence[Array]) -> None:
        """Take noise from the best replay known of each joint."""
        known = self._best
        for each in errors:
            better = (each**2).sum(axis=0) < (self._best**2).sum(axis=0)
            self._best = np.where(better, each, self._best)
        if self._best is not known:
            problem = self.problem
            self.noise = Noise.of(self._best, problem.pulled, problem.stretches)

    def file(self) -> Explanation:
        """Nothing is wrong, but shapes of friction that a file does not state."""
        x = self.problem.prior.coordinates
        start = self.problem.at(x, self.shapes)
        noise = self.noise.reaching(start.rms)
        found = self.problem.fitted(start, noise, _TURNS)
        return Explanation(found, np.zeros_like(self.shapes))

    def of(self, x: Array, causes: NDArray[np.bool_], turns: int = 2) -> Explanation:
        """Some numbers differ, from coordinates where they may be."""
        free = self.shapes | causes
        free[_SIGN] = False
        start = self.problem.at(x, free)
        noise = self.noise.reaching(start.rms)
        return Explanation(self.problem.fitted(start, noise, turns), causes)

    def evidence(self, what: Explanation, noise: Noise) -> Array:
        """Log evidence of each joint but for a constant, shape (n,), [nats]."""
        found = what.found
        out = -self.problem.cost(found, noise) - COST * what.causes.sum(axis=0)
        base = self._base(found, noise)
        scaled = base.matrix * np.outer(base.spread, base.spread)
        for j in range(len(out)):
            own = base.places[:, 1] == j
            if own.any():
                out[j] += base.quad(own)
                out[j] -= 0.5 * np.linalg.slogdet(scaled[np.ix_(own, own)])[1]
        return np.asarray(out)

    def grown(self, start: Explanation, rounds: int = _ROUNDS) -> Explanation:
        """The explanation with all numbers that add to its evidence."""
        now = start
        for turn in range(rounds):
            self.progress(f"servos: {int(now.causes.sum())} causes, round {turn + 1}")
            after = self._wider(now)
            if after is None:
                break
            now = after
        return now

    def _wider(self, now: Explanation) -> Explanation | None:
        """With one more number at every joint that gains by it; None if none does."""
        moves = sorted(self._moves(now), key=lambda x: -x.gain)
        noise = self.noise.reaching(now.found.rms)
        own: dict[int, list[_Move]] = {}
        for move in moves:
            mine = own.setdefault(move.j, [])
            if not SHARED[move.k] and all(x.k != move.k for x in mine):
                mine.append(move)
        trials = [[m] for m in moves if SHARED[m.k]][:1]
        for rank in range(_RANKS):
            trials.append([x[rank] for x in own.values() if len(x) > rank])
        before = self.evidence(now, noise)
        tried, gains = [], []
        for trial in filter(None, trials):
            x, causes = now.found.x.copy(), now.causes.copy()
            for move in trial:
                seen = slice(None) if SHARED[move.k] else move.j
                x[:, seen], causes[move.k, move.j] = move.x[:, seen], True
            tried.append(self.of(x, causes, _TURNS))
            gains.append(self.evidence(tried[-1], noise) - before)
        if not tried:
            return None
        gain = np.array(gains)
        single = gain.max(axis=0)
        if SHARED[trials[0][0].k] and gain[0].sum() > max(single.max(), 0.0):
            return tried[0]
        if single.max() <= 0.0:
            return None
        # Joints move each other a little: the clearest first.
        sure = single > max(0.0, _CLEAR * single.max())
        which = np.where(sure, gain.argmax(axis=0), -1)
        after = self._mixed(now, tried, which, noise)
        return after and replace(after, equals=self._equals(now, tried, which, noise))

    def _equals(
        self, now: Explanation, tried: list[Explanation], which: Array, noise: Noise
    ) -> dict[tuple[int, int], tuple[int, ...]]:
        """Numbers that were tried beside the ones taken, and fit as well."""
        out = dict(now.equals)
        costs = [self.problem.cost(x.found, noise) for x in tried]
        new = [(x.causes & ~now.causes) & ~SHARED[:, None] for x in tried]
        for j, i in enumerate(which.tolist()):
            for k in np.flatnonzero(new[i][:, j]).tolist() if i >= 0 else ():
                out[k, j] = tuple(
                    int(other)
                    for cost, more in zip(costs, new, strict=True)
                    for other in np.flatnonzero(more[:, j])
                    if other != k and cost[j] < costs[i][j] + _EQUAL
                )
        return out

    def _mixed(
        self, now: Explanation, tried: list[Explanation], which: Array, noise: Noise
    ) -> Explanation | None:
        """Each joint as in one trial or as it is (−1), or only the best joint."""
        least = self.evidence(now, noise).sum()
        best = int(np.argmax(which >= 0))
        alone = np.where(np.arange(len(which)) == best, which, -1)
        for choice in (which, alone):
            x, causes = now.found.x.copy(), now.causes.copy()
            for j, k in enumerate(choice.tolist()):
                if k >= 0:
                    x[:, j] = tried[k].found.x[:, j]
                    causes[:, j] = tried[k].causes[:, j]
            mixed = self.of(x, causes)
            if self.evidence(mixed, noise).sum() > least:
                return mixed
        return None

    def _moves(self, now: Explanation) -> list[_Move]:
        """Numbers that promise a gain, with the place where a fit starts."""
        found, problem = now.found, self.problem
        probes = self._probes(now)
        groups: dict[tuple[int, int, int], list[tuple[int, int, float]]] = {}
        for k, j, turn, delta in probes:
            key = (k, turn, j if SHARED[k] else -1)
            groups.setdefault(key, []).append((k, j, delta))
        points = []
        for group in groups.values():
            y = found.x.copy()
            for k, j, delta in group:
                y[k, j] += delta
            points.append(problem.prior.moved(y).coordinates)
        best: dict[tuple[int, int], _Move] = {}
        tried = problem.errors(points)
        self._learn([found.errors, *tried])
        base = self._base(found, self.noise.reaching(found.rms))
        for group, after in zip(groups.values(), tried, strict=True):
            for k, j, delta in group:
                move = self._move(found, base, after, (k, j, delta))
                if move.gain > max(0.0, best[k, j].gain if (k, j) in best else 0.0):
                    best[k, j] = move
        return list(best.values())

    def _move(
        self,
        wide: Estimate,
        base: _Base,
        after: Array,
        change: tuple[int, int, float],
    ) -> _Move:
        """What a number promises: errors change along the secant to its probe."""
        k, j, delta = change
        prior, sign = self.problem.prior, QUANTITIES[k].name == "sign"
        mine = base.places[:, 1] == j if not SHARED[k] else base.all
        others = mine & ~((base.places[:, 0] == k) & (base.places[:, 1] == j))
        seen: slice | list[int] = slice(None) if SHARED[k] else [j]
        secant = after - wide.errors
        weighed = (base.weight * secant)[:, seen].ravel()
        cross = base.slopes[others][:, :, seen].reshape(int(others.sum()), -1) @ weighed
        rest = np.linalg.solve(
            base.matrix[np.ix_(others, others)], np.c_[base.gradient[others], cross]
        )
        unit = 0.0 if sign else delta / prior.spread[k, j]
        away = (wide.x - prior.coordinates)[k, j] / prior.spread[k, j]
        curve = secant[:, seen].ravel() @ weighed + unit**2 - cross @ rest[:, 1]
        pull = wide.errors[:, seen].ravel() @ weighed + unit * away - cross @ rest[:, 0]
        share = 1.0 if sign else float(np.clip(-pull / curve, 0.0, _LARGEST))
        gain = 0.5 * base.gradient[others] @ rest[:, 0] - base.quad(mine)
        gain -= pull * share + 0.5 * curve * share**2 + COST
        gain -= 0.0 if sign else 0.5 * np.log(max(curve / unit**2, 1.0))
        x = wide.x.copy()
        x[k, j] += share * delta
        ks, js = base.places[others].T
        step = np.where(wide.free[ks, js], self.problem.step[ks, js], 0.0)
        x[ks, js] += np.clip(-rest[:, 0] - rest[:, 1] * share, -step, step)
        return _Move(k, j, float(gain), prior.moved(x).coordinates)

    def _base(self, found: Estimate, noise: Noise) -> _Base:
        """Curvature of the posterior of all that may differ a little."""
        wide = replace(found, free=found.free | self.soft)
        spread = self.problem.prior.spread * np.where(found.free, 1.0, _SAME)
        slopes = self.problem.slopes(wide)
        matrix, gradient = self.problem.normal(wide, slopes, noise, spread)
        weight = noise.weights(found.errors)
        places = np.argwhere(wide.free)
        return _Base(places, slopes, matrix, gradient, weight, spread[wide.free])

    def _probes(self, now: Explanation) -> list[tuple[int, int, int, float]]:
        """Numbers to be changed, how many times each, and by how much."""
        out, x = [], now.found.x
        open_ = self.allowed & ~now.causes
        usual = _usual_changes(self.problem, x, self.hint)
        for k, j in np.argwhere(open_).tolist():
            for turn, changes in enumerate(usual[NAMES[k]]):
                if np.isfinite(changes[j]) and changes[j] != 0:
                    out.append((k, j, turn, float(changes[j])))
        return out

    def pruned(self, what: Explanation) -> Explanation:
        """With all numbers back at the file's by which the evidence grows."""
        now = what
        while True:
            noise = self.noise.reaching(now.found.rms)
            before = float(self.evidence(now, noise).sum())
            tried = self._without_one(now, noise)
            losses = {
                at: before - float(self.evidence(x, noise).sum())
                for at, x in tried.items()
            }
            better = None
            for at in sorted(losses, key=lambda at: losses[at])[:_RANKS]:
                if losses[at] > _CLOSE:
                    break
                start = tried[at]
                less = self.of(start.found.x, start.causes, _TURNS)
                loss = before - float(self.evidence(less, noise).sum())
                losses[at] = min(losses[at], loss)
                if loss < 0:
                    better = replace(less, equals=now.equals)
                    break
            if better is None:
                return replace(now, losses=losses)
            self.progress(f"servos: {int(better.causes.sum())} causes")
            now = better

    def _without_one(
        self, now: Explanation, noise: Noise
    ) -> dict[tuple[int, int], Explanation]:
        """Each number back, others making up for it: x' = x − C_i (x_i − f_i)/C_ii."""
        problem, found = self.problem, now.found
        places = [tuple(p) for p in np.argwhere(found.free).tolist()]
        prior, out = problem.prior.coordinates, {}
        matrix, _ = problem.normal(found, problem.slopes(found), noise)
        covariance = np.linalg.inv(matrix)
        for k, j in np.argwhere(now.causes).tolist():
            x, free, causes = found.x.copy(), found.free.copy(), now.causes.copy()
            if free[k, j]:
                i = places.index((k, j))
                change = covariance[i] / covariance[i, i] * (prior[k, j] - x[k, j])
                most = 2 * problem.step[free]
                x[free] += np.clip(change, -most, most)
            x[k, j], free[k, j], causes[k, j] = prior[k, j], False, False
            x = problem.prior.moved(x).coordinates
            out[k, j] = Explanation(problem.at(x, free), causes)
        return out


def _usual_changes(problem: Problem, x: Array, hint: Array) -> dict[str, list[Array]]:
    """Changes of every number by which it is probed, in coordinates, each (n,)."""
    spread = problem.prior.spread
    ones = np.ones_like(spread[0])
    rates = [np.abs(np.diff(s.command, axis=0)) / s.step for s in problem.stretches]
    fastest = np.maximum(np.quantile(np.concatenate(rates), 0.98, axis=0), 1e-3)
    command = np.concatenate([s.command for s in problem.stretches])
    q = problem.measured
    out: dict[str, list[Array]] = {}
    for k, each in enumerate(QUANTITIES):
        if each.positive:
            out[each.name] = [0.5 * ones, -0.5 * ones, hint[k] - x[k]]
        else:
            out[each.name] = [spread[k], -spread[k], hint[k] - x[k]]
        if each.least == 0.0:
            out[each.name] = [spread[k], 0.25 * spread[k], hint[k] - x[k]]
    # A limit shows only where it is reached: how far below the file's is not known.
    out["stall"] = [-far * spread[NAMES.index("stall")] for far in (1.0, 2.0, 3.0)]
    out["pace"] = [share / fastest for share in (1.2, 2.0, 4.0)]
    # A joint that runs into a stop is there for a while.
    for name, ends in (("lower", (0.01, 0.05)), ("upper", (0.99, 0.95))):
        way = 1.0 if name == "upper" else -1.0
        beyond = (way * command).max(axis=0) > (way * q).max(axis=0)
        places = [np.quantile(q, end, axis=0) - x[NAMES.index(name)] for end in ends]
        out[name] = [np.where(beyond, place, 0.0) for place in places]
    out["mass"] = [0.3 * ones, -0.3 * ones]
    out["sign"] = [-2.0 * ones]
    return out
