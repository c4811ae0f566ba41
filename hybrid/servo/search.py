"""Which numbers of a file are wrong: explanations of logs compete by their evidence.

J is a sum over joints, and a servo moves its own joint before others, so that joints
search side by side. The search begins with the plain fit. The numbers that promise most
by a secant of the replays are fitted, and the best stays. At the end every number goes
back to the file's, others making up for it, and stays there if the evidence grows.

Evidence is of the parts of the logs that are fitted. No step is taken at a joint which
makes the other parts less probable than by any explanation met before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.progress import Progress, silent
from hybrid.servo.drive import NAMES
from hybrid.servo.evidence import COST, Curvature, Explanation, evidence
from hybrid.servo.moves import Move, probed, promising
from hybrid.servo.noise import Noise
from hybrid.servo.problem import SHARED, Estimate, Problem

# Shapes of friction have no number in the file; they are no cause of their own.
_SHAPES = np.isin(NAMES, ("stribeck_speed", "presliding"))[:, None]
_SIGN = NAMES.index("sign")
_RANKS = 2  # numbers of a joint that are fitted in a round, each alone
_TURNS = 4  # Gauss–Newton steps of one of them
_ROUNDS = 8
_CLEAR = 0.2  # of the best gain: less may be another joint's doing, and waits
_EQUAL = 3.0  # nats of likelihood: less is not told by motion
_TOLD = 1.0  # nats: less is hardly worth a mention (Jeffreys)
_NEAR = 1  # rounds from the file before it is compared with the plain fit
_CLOSE = 3.0  # nats: a loss by linear algebra below it is looked at again

Place = tuple[int, int]


class Search:
    """Explanations of logs.

    Args:
        problem: The logs.
        plain: A plain fit of them.
        aside: The parts that are not fitted, if there are any.
        allowed: Numbers that may differ, shape (len(QUANTITIES), n).
        progress: Is told what is done.
    """

    def __init__(
        self,
        problem: Problem,
        plain: Estimate,
        aside: Problem | None,
        allowed: NDArray[np.bool_],
        progress: Progress = silent,
    ) -> None:
        self.problem, self.aside, self.progress = problem, aside, progress
        self.plain = Explanation(plain, plain.free)
        self.met: list[Explanation] = []
        self.noise = problem.noise(plain.errors)
        self.shapes = _SHAPES & allowed
        self.allowed = ~_SHAPES & allowed

    def best(self) -> Explanation:
        """The best explanation of each joint, from the file or from the plain fit."""
        near, plain = self.grown(self.file(), _NEAR), self.plain
        self.met = [plain]
        tried = [near, self.of(plain.found.x, plain.causes)]
        usual = np.minimum(near.found.usual, plain.found.usual)
        noise = self.noise.reaching(usual)
        gain = self.gain(plain, tried, noise)
        which = np.where((gain > 0).any(axis=0), gain.argmax(axis=0), -1)
        start = self._mixed(plain, tried, which, noise) or plain
        grown = self.grown(replace(start, equals=near.equals))
        return self.pruned(grown)

    def file(self) -> Explanation:
        """Nothing is wrong, but shapes of friction that a file does not state."""
        x = self.problem.prior.coordinates
        return self.of(x, np.zeros_like(self.shapes), _TURNS)

    def of(self, x: Array, causes: NDArray[np.bool_], turns: int = 2) -> Explanation:
        """Some numbers differ, from coordinates where they may be."""
        free = self.shapes | causes
        free[_SIGN] = False
        start = self.problem.at(x, free)
        noise = self.noise.reaching(start.usual)
        return Explanation(self.problem.fitted(start, noise, turns), causes)

    def gain(
        self, now: Explanation, tried: Sequence[Explanation], noise: Noise
    ) -> Array:
        """Evidence that trials add at each joint, shape (trials, n), [nats].

        Where they make the parts set aside less probable, no more than is lost there.
        """
        before = evidence(self.problem, now, noise)
        gain = np.array([evidence(self.problem, x, noise) - before for x in tried])
        if self.aside is None:
            return gain
        points = [x.found.x for x in (*self.met, *tried)]
        costs = np.array([noise.cost(x) for x in self.aside.errors(points)])
        known = len(self.met)
        harm = costs[known:] - costs[:known].min(axis=0)
        return np.asarray(np.where(harm > _TOLD, np.minimum(gain, -harm), gain))

    def grown(self, start: Explanation, rounds: int = _ROUNDS) -> Explanation:
        """The explanation with all numbers that add to its evidence."""
        now = start
        self.met.append(now)
        for turn in range(rounds):
            self.progress(f"servos: {int(now.causes.sum())} causes, round {turn + 1}")
            after = self._wider(now)
            if after is None:
                break
            now = after
            self.met.append(now)
        return now

    def _wider(self, now: Explanation) -> Explanation | None:
        """With one more number at every joint that gains by it; None if none does."""
        trials = self._trials(now)
        if not trials:
            return None
        noise = self.noise.reaching(now.found.usual)
        tried = []
        for trial in trials:
            x, causes = now.found.x.copy(), now.causes.copy()
            for move in trial:
                seen = slice(None) if SHARED[move.k] else move.j
                x[:, seen], causes[move.k, move.j] = move.x[:, seen], True
            tried.append(self.of(x, causes, _TURNS))
        gain = self.gain(now, tried, noise)
        more = [(x.causes & ~now.causes).any(axis=0) for x in tried]
        single = np.where(more, gain, 0.0).max(axis=0)
        if SHARED[trials[0][0].k] and gain[0].sum() > max(single.max(), 0.0):
            return tried[0]
        gain = np.where(more, gain, 0.0)
        # Joints move each other a little: the clearest first.
        sure = single > max(0.0, _CLEAR * single.max())
        which = np.where(sure, gain.argmax(axis=0), -1)
        after = self._mixed(now, tried, which, noise)
        return after and replace(after, equals=self._equals(now, tried, which, noise))

    def _trials(self, now: Explanation) -> list[list[Move]]:
        """Numbers to be fitted: one that moves all joints, or one at every joint."""
        problem, found, hint = self.problem, now.found, self.plain.found.x
        open_ = self.allowed & ~now.causes
        changes, errors = probed(problem, found.x, open_, hint)
        for each in (found.errors, *errors):
            self.noise = self.noise.least(problem.noise(each))
        about = Curvature.of(problem, found, self.noise.reaching(found.usual))
        moves = promising(problem, found, about, changes, errors)
        own: dict[int, list[Move]] = {}
        for move in moves:
            if not SHARED[move.k]:
                own.setdefault(move.j, []).append(move)
        trials = [[m] for m in moves if SHARED[m.k]][:1]
        for rank in range(_RANKS):
            trials.append([x[rank] for x in own.values() if len(x) > rank])
        return [x for x in trials if x]

    def _equals(
        self, now: Explanation, tried: list[Explanation], which: Array, noise: Noise
    ) -> dict[Place, tuple[int, ...]]:
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
        self,
        now: Explanation,
        tried: Sequence[Explanation],
        which: Array,
        noise: Noise,
    ) -> Explanation | None:
        """Each joint as in one trial or as it is (−1), where it gains by that."""
        while (which >= 0).any():
            x, causes = now.found.x.copy(), now.causes.copy()
            for j, k in enumerate(which.tolist()):
                if k >= 0:
                    x[:, j] = tried[k].found.x[:, j]
                    causes[:, j] = tried[k].causes[:, j]
            mixed = self.of(x, causes)
            (gain,) = self.gain(now, [mixed], noise)
            if gain.sum() > 0 and (gain[which >= 0] > 0).all():
                return mixed
            # Joints move each other a little: those that lose, or gain least, wait.
            least = gain[which >= 0].min()
            which = np.where((gain > 0) & (gain > least), which, -1)
        return None

    def pruned(self, what: Explanation) -> Explanation:
        """With all numbers back at the file's by which the evidence grows."""
        now, kept = what, dict[Place, float]()
        while True:
            self.progress(f"servos: {int(now.causes.sum())} causes, fewer")
            noise = self.noise.reaching(now.found.usual)
            losses, tried = self._without_one(now, noise)
            losses |= kept
            weakest = self._weakest(losses, kept)
            if not weakest:
                return replace(now, losses=losses)
            x, causes = now.found.x.copy(), now.causes.copy()
            for at in weakest:
                seen = slice(None) if SHARED[at[0]] else at[1]
                x[:, seen], causes[at] = tried[at][:, seen], False
            less = self.of(x, causes)
            (gain,) = self.gain(now, [less], noise)
            if SHARED[weakest[0][0]]:
                gain[:] = gain.sum()
                after = less if gain[0] > 0 else None
            else:
                after = self._mixed(now, [less], np.where(gain > 0, 0, -1), noise)
            kept |= {at: -float(gain[at[1]]) for at in weakest}
            if after is not None:
                now = replace(after, equals=now.equals)
                kept = {at: x for at, x in kept.items() if now.causes[at] and x > 0}

    def _weakest(
        self, losses: Mapping[Place, float], kept: Mapping[Place, float]
    ) -> list[Place]:
        """The number of each joint that is missed least, or one that moves all."""
        out: dict[int, Place] = {}
        for at in sorted(losses, key=lambda at: losses[at]):
            if losses[at] > _CLOSE or at in kept:
                continue
            if SHARED[at[0]]:
                return list(out.values()) or [at]
            out.setdefault(at[1], at)
        return list(out.values())

    def _without_one(
        self, now: Explanation, noise: Noise
    ) -> tuple[dict[Place, float], dict[Place, Array]]:
        """Loss and place of each number back: x' = x − C_i (x_i − f_i)/C_ii."""
        problem, found = self.problem, now.found
        places = [tuple(p) for p in np.argwhere(found.free).tolist()]
        prior, spread = problem.prior.coordinates, problem.prior.spread
        matrix, _ = problem.normal(found, problem.slopes(found), noise)
        covariance = np.linalg.inv(matrix)
        points, widths = {}, {}
        for k, j in np.argwhere(now.causes).tolist():
            x, widths[k, j] = found.x.copy(), 0.0
            if found.free[k, j]:
                i = places.index((k, j))
                own = covariance[i] / covariance[i, i]
                most = 2 * problem.step[found.free]
                x[found.free] += np.clip(own * (prior[k, j] - x[k, j]), -most, most)
                widths[k, j] = 0.5 * np.log(spread[k, j] ** 2 / covariance[i, i])
            x[k, j] = prior[k, j]
            points[k, j] = problem.prior.moved(x).coordinates
        before, losses = problem.cost(found, noise).sum(), {}
        replays = problem.errors(list(points.values()))
        for at, errors in zip(points, replays, strict=True):
            free = found.free.copy()
            free[at] = False
            back = replace(found, x=points[at], free=free, errors=errors)
            after = problem.cost(back, noise).sum()
            losses[at] = float(after - before - widths[at] - COST)
        return losses, points
