"""Search for the parameters of a file that are wrong, by their evidence.

A servo moves mainly its own joint, so that all joints are searched side by side. The
search starts at the file or at the plain fit. In each round the most promising
parameters of each joint are fitted, and the best one is added. At the end each added
parameter is set back to the file, and stays there if the evidence grows by that.

Evidence is computed on the parts of the logs that are fitted. No step may make the
parts set aside less probable than the best explanation so far does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.progress import Progress, silent
from hybrid.servo.drive import NAMES
from hybrid.servo.evidence import COST, Curvature, evidence
from hybrid.servo.moves import Move, probed, promising
from hybrid.servo.noise import Noise
from hybrid.servo.problem import SHARED, Estimate, Place, Problem

# No file states these shapes of friction: they are always fitted, and never a cause.
_SHAPES = np.isin(NAMES, ("stribeck_speed", "presliding"))[:, None]
_SIGN = NAMES.index("sign")
_RANKS = 2  # parameters of a joint that are tried in a round, one at a time
_TURNS = 4  # Gauss–Newton steps of a trial
_ROUNDS = 8
_CLEAR = 0.2  # of the best gain: a smaller one may come from another joint, and waits
_CLOSE = 3.0  # nats: two explanations are about equally good (odds of 20)
_TOLD = 1.0  # nats: a negligible difference (Jeffreys)
_NEAR = 1  # rounds from the file before it is compared with the plain fit


class Search:
    """The search of one set of logs, beside parts of them that are set aside.

    It knows a plain fit of the logs, and the parameters that are allowed to differ,
    shape (len(QUANTITIES), n).
    """

    def __init__(
        self,
        problem: Problem,
        plain: Estimate,
        aside: Problem | None,
        allowed: Mask,
        progress: Progress = silent,
    ) -> None:
        self.problem, self.aside, self.progress = problem, aside, progress
        self.plain = plain
        self.met: list[Estimate] = []
        self.noise = problem.noise(plain.errors)
        self.shapes = _SHAPES & allowed
        self.allowed = ~_SHAPES & allowed

    def best(self) -> Estimate:
        """Search from the better of the file and the plain fit at each joint."""
        near, plain = self.grown(self.file(), _NEAR), self.plain
        self.met = [plain]
        tried = [near, self.of(plain.x, plain.causes)]
        usual = np.minimum(near.usual, plain.usual)
        noise = self.noise.reaching(usual)
        gain = self.gain(plain, tried, noise)
        which = np.where((gain > 0).any(axis=0), gain.argmax(axis=0), -1)
        start = self._mixed(plain, tried, which, noise) or plain
        grown = self.grown(replace(start, equals=near.equals))
        return self.pruned(grown)

    def file(self) -> Estimate:
        """The explanation without causes: only the shapes of friction are fitted."""
        x = self.problem.prior.coordinates
        return self.of(x, np.zeros_like(self.shapes), _TURNS)

    def of(self, x: Array, causes: Mask, turns: int = 2) -> Estimate:
        """Fit an explanation with given causes, starting at given coordinates."""
        free = self.shapes | causes
        free[_SIGN] = False
        start = self.problem.at(x, free)
        noise = self.noise.reaching(start.usual)
        return replace(self.problem.fitted(start, noise, turns), causes=causes)

    def gain(self, now: Estimate, tried: Sequence[Estimate], noise: Noise) -> Array:
        """Evidence that trials add at each joint, shape (trials, n), [nats].

        A trial that makes the parts set aside less probable has that loss as its gain.
        """
        before = evidence(self.problem, now, noise)
        gain = np.array([evidence(self.problem, x, noise) - before for x in tried])
        if self.aside is None:
            return gain
        points = [x.x for x in (*self.met, *tried)]
        costs = np.array([noise.cost(x) for x in self.aside.errors(points)])
        known = len(self.met)
        harm = costs[known:] - costs[:known].min(axis=0)
        return np.asarray(np.where(harm > _TOLD, np.minimum(gain, -harm), gain))

    def grown(self, start: Estimate, rounds: int = _ROUNDS) -> Estimate:
        """Add causes until the evidence no longer grows."""
        now = start
        self.met.append(now)
        for turn in range(rounds):
            count = int(now.causes.sum())
            self.progress(f"servos: {count} causes, round {turn + 1}", None)
            after = self._wider(now)
            if after is None:
                break
            now = after
            self.met.append(now)
        return now

    def _wider(self, now: Estimate) -> Estimate | None:
        """Add one cause at every joint that gains by it; None if none does."""
        trials = self._trials(now)
        if not trials:
            return None
        noise = self.noise.reaching(now.usual)
        tried = []
        for trial in trials:
            x, causes = now.x.copy(), now.causes.copy()
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
        # Joints move each other a little: the clearest gains first.
        sure = single > max(0.0, _CLEAR * single.max())
        which = np.where(sure, gain.argmax(axis=0), -1)
        after = self._mixed(now, tried, which, noise)
        return after and replace(after, equals=self._equals(now, tried, which, noise))

    def _trials(self, now: Estimate) -> list[list[Move]]:
        """Parameters to try: one that moves all joints, then one of every joint."""
        problem, hint = self.problem, self.plain.x
        open_ = self.allowed & ~now.causes
        changes, errors = probed(problem, now.x, open_, hint)
        for each in (now.errors, *errors):
            self.noise = self.noise.least(problem.noise(each))
        about = Curvature.of(problem, now, self.noise.reaching(now.usual))
        moves = promising(problem, now, about, changes, errors)
        own: dict[int, list[Move]] = {}
        for move in moves:
            if not SHARED[move.k]:
                own.setdefault(move.j, []).append(move)
        trials = [[m] for m in moves if SHARED[m.k]][:1]
        for rank in range(_RANKS):
            trials.append([x[rank] for x in own.values() if len(x) > rank])
        return [x for x in trials if x]

    def _equals(
        self, now: Estimate, tried: list[Estimate], which: Array, noise: Noise
    ) -> dict[Place, tuple[int, ...]]:
        """Quantities that fit as well as the ones that are added."""
        out = dict(now.equals)
        costs = [self.problem.cost(x, noise) for x in tried]
        new = [(x.causes & ~now.causes) & ~SHARED[:, None] for x in tried]
        for j, i in enumerate(which.tolist()):
            for k in np.flatnonzero(new[i][:, j]).tolist() if i >= 0 else ():
                out[k, j] = tuple(
                    int(other)
                    for cost, more in zip(costs, new, strict=True)
                    for other in np.flatnonzero(more[:, j])
                    if other != k and cost[j] < costs[i][j] + _CLOSE
                )
        return out

    def _mixed(
        self, now: Estimate, tried: Sequence[Estimate], which: Array, noise: Noise
    ) -> Estimate | None:
        """Combine trials: each joint as in one of them or unchanged (−1).

        Joints that do not gain by the combination stay unchanged.
        """
        while (which >= 0).any():
            x, causes = now.x.copy(), now.causes.copy()
            for j, k in enumerate(which.tolist()):
                if k >= 0:
                    x[:, j] = tried[k].x[:, j]
                    causes[:, j] = tried[k].causes[:, j]
            mixed = self.of(x, causes)
            (gain,) = self.gain(now, [mixed], noise)
            if gain.sum() > 0 and (gain[which >= 0] > 0).all():
                return mixed
            # Joints move each other a little: those that lose or gain least wait.
            least = gain[which >= 0].min()
            which = np.where((gain > 0) & (gain > least), which, -1)
        return None

    def pruned(self, what: Estimate) -> Estimate:
        """Remove causes as long as the evidence grows by that."""
        now, kept = what, dict[Place, float]()
        while True:
            self.progress(f"servos: {int(now.causes.sum())} causes, fewer", None)
            noise = self.noise.reaching(now.usual)
            losses, tried = self._without_one(now, noise)
            losses |= kept
            weakest = self._weakest(losses, kept)
            if not weakest:
                return replace(now, losses=losses)
            x, causes = now.x.copy(), now.causes.copy()
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
        """The least important cause of each joint, or one that moves all joints."""
        out: dict[int, Place] = {}
        for at in sorted(losses, key=lambda at: losses[at]):
            if losses[at] > _CLOSE or at in kept:
                continue
            if SHARED[at[0]]:
                return list(out.values()) or [at]
            out.setdefault(at[1], at)
        return list(out.values())

    def _without_one(
        self, now: Estimate, noise: Noise
    ) -> tuple[dict[Place, float], dict[Place, Array]]:
        """Loss and coordinates when one cause i goes back to the file's value f_i.

        The others adapt linearly: x' = x − C_i (x_i − f_i)/C_ii with covariance C.
        """
        problem, free = self.problem, now.free
        places = [tuple(p) for p in np.argwhere(free).tolist()]
        prior, spread = problem.prior.coordinates, problem.prior.spread
        matrix, _ = problem.normal(now, problem.slopes(now), noise)
        covariance = np.linalg.inv(matrix)
        points, widths = {}, {}
        for k, j in np.argwhere(now.causes).tolist():
            x, widths[k, j] = now.x.copy(), 0.0
            if free[k, j]:
                i = places.index((k, j))
                own = covariance[i] / covariance[i, i]
                most = 2 * problem.step[free]
                x[free] += np.clip(own * (prior[k, j] - x[k, j]), -most, most)
                widths[k, j] = 0.5 * np.log(spread[k, j] ** 2 / covariance[i, i])
            x[k, j] = prior[k, j]
            points[k, j] = problem.prior.moved(x).coordinates
        before, losses = problem.cost(now, noise).sum(), {}
        replays = problem.errors(list(points.values()))
        for at, errors in zip(points, replays, strict=True):
            others = free.copy()
            others[at] = False
            back = replace(now, x=points[at], free=others, errors=errors)
            after = problem.cost(back, noise).sum()
            losses[at] = float(after - before - widths[at] - COST)
        return losses, points
