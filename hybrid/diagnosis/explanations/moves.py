"""Single steps of a search: a cause is added, exchanged or removed."""

from collections.abc import Sequence

import numpy as np

from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.proposals import Proposals
from hybrid.progress import Progress

LEAST_GAIN = 0.5  # nat, least improvement of the score by a step


class Moves(Proposals):
    """An explanation that changes step by step.

    Attributes:
        causes: The present explanation.
    """

    causes: list[Cause]
    _certain: list[Cause]  # causes that stay
    _progress: Progress
    _checked: dict[Cause, tuple[frozenset[object], tuple[float, bytes] | None]]

    def _doubtful(self) -> list[Cause]:
        """Causes that may be exchanged or removed."""
        return [c for c in self.causes if c not in self._certain]

    def _take(self, causes: list[Cause]) -> bool:
        """Take causes instead of the present ones if they explain the gap better.

        Both the score and the held-out loss have to be better. What the others make
        superfluous is removed.
        """
        better = self.score(causes) > self.score(self.causes) + LEAST_GAIN
        if not (better and self.is_cross_validated(causes)):
            return False
        self.causes = causes
        self._remove()
        return True

    def is_cross_validated(self, causes: Sequence[Cause]) -> bool:
        """Whether some causes have a smaller held-out loss than the present ones.

        An equal one does if they are simpler. An exchange has no odds against it, so
        that a small fall may be chance: it has to exceed its standard error over the
        folds. An event that explains its time is not foretold by other folds.

        Source: Breiman et al. 1984, Classification and Regression Trees, section 3.4.3,
        doi 10.1201/9781315139470 (rule of one standard error).
        """
        new = [c for c in causes if c not in self.causes]
        if new and all(self.is_isolated(c, causes) for c in new):
            return True
        falls = self.held_out_losses(self.causes) - self.held_out_losses(causes)
        fall, least = falls.sum(axis=0), np.zeros(2)
        if len(self.columns(causes)) < len(self.columns(self.causes)):
            least -= LEAST_GAIN
        elif len(causes) == len(self.causes):
            least = falls.std(axis=0) * np.sqrt(len(falls))
        return bool(np.all(fall > least))

    def _add(self) -> bool:
        """Add the best proposal; return whether the score has risen."""
        base = self.columns(self.causes)
        self.pool.add_ripples(base)
        self.pool.add_contacts(base)
        now = self.score(self.causes)
        for found in self.proposals(self.causes):
            if found.worth <= LEAST_GAIN:
                break
            if self._take([*self.causes, found.cause]):
                kind, joints = found.place
                joint = self.gap.robot.joints[joints[-1]]
                self._progress(f"cause {len(self.causes)}: {kind} at {joint}", None)
                return self.score(self.causes) > now + LEAST_GAIN
        return False

    def _remove(self) -> None:
        """Remove causes whose evidence is below their odds and errors of other laws."""
        while doubtful := self._doubtful():
            now = self.score(self.causes)
            rest = [[x for x in self.causes if x is not c] for c in doubtful]
            pairs = zip(doubtful, rest, strict=True)
            worth = now - np.array([self.score(x) for x in rest])
            spare = worth - np.array([self._rough_errors(x, c) for c, x in pairs])
            weakest = int(np.argmin(spare))
            if spare[weakest] >= 0.0:
                return
            self.causes = rest[weakest]

    def _rough_errors(self, causes: Sequence[Cause], other: Cause) -> float:
        """Evidence for a cause that may come from errors of rough laws, [nat].

        Those of an unknown law count against a known cause only if the law is rougher.
        """
        known = other.candidate is not None
        least = [other.rough if known and not c.candidate else 0.0 for c in causes]
        rough = [c for c, x in zip(causes, least, strict=True) if c.rough > x]
        if not rough:
            return 0.0
        whole = self.score(causes)
        less = [self.score([x for x in causes if x is not c]) for c in rough]
        pairs = zip(rough, less, strict=True)
        return max(c.rough**2 * (whole - x) for c, x in pairs)

    def _exchange(self, cause: Cause) -> bool:
        """Exchange a cause for the best one in its place, or remove it."""
        rest = [c for c in self.causes if c is not cause]
        now, alone = self.score(self.causes), self.score(rest)
        found = [x for x in self.proposals(self.causes, own=cause) if x.cause != cause]
        near = [x for x in found[:2] if alone + x.worth > now - self.prior.cause]
        for x in near:
            if self._take(self._with_shapes_refitted(rest, x.cause)):
                return True
        if alone > now:
            self.causes = rest
            return True
        settings = self._settings if near else None
        self._checked[cause] = self._neighbours(cause), settings
        return False

    def _is_checked(self, cause: Cause) -> bool:
        """Whether no other cause can take the place of one, as far as is known.

        That depends on the causes at its joints. Noise and the error of the file decide
        between causes that explain nearly the same.
        """
        causes, settings = self._checked.get(cause, (None, None))
        same = causes == self._neighbours(cause)
        return same and settings in (None, self._settings)

    def _neighbours(self, cause: Cause) -> frozenset[object]:
        """Causes at a cause's joints, and which ones may take its place."""
        own = set(cause.place[1])
        near = (c for c in self.causes if own.intersection(c.place[1]))
        return frozenset([self.library_only, *near])

    @property
    def _settings(self) -> tuple[float, bytes]:
        """The error of the file, and the noise."""
        return self.file_error, self.evidence.noise.tobytes()

    def _with_shapes_refitted(self, causes: list[Cause], new: Cause) -> list[Cause]:
        """Some causes and a new one, to which the shapes of its neighbours adapt.

        An event acts at all joints: its time does not depend on laws at one of them.
        """
        found = [*causes, new]
        for c in (x for x in causes if not x.is_event):
            near = {*c.place[1]} & {*new.place[1]} and c not in self._certain
            if near and c.candidate is not None and c.candidate.effect.shapes:
                rest = [x for x in found if x is not c]
                adapted = self.refine(self.columns(rest), c.candidate)[0]
                found = max(found, [*rest, self.cause(adapted)], key=self.score)
        return found
