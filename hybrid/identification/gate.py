"""The test that every new term must pass: it lowers the held-out error of a joint.

The squared residuals of the predicted torque are compared block by block, with and
without the term, so that noise common to both cancels. The term is accepted if the mean
gain over the blocks exceeds its own uncertainty.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.special import ndtri

from hybrid.arrays import Array, Mask
from hybrid.effects import Effect
from hybrid.identification.solution import Solution

Terms = Mapping[int, list[Effect]]  # the effects of each joint

_CHANCE = 0.025  # probability that noise alone passes


def lowers(before: Array, after: Array, *, tried: int = 1) -> Mask:
    """Whether the held-out squares of each joint fall significantly, shape (n,).

    They are those of each block without a term and with it, shape (B, n), [N²·m²]; it
    is the best of as many as were ``tried``.
    """
    gain = before - after
    error = np.sqrt(((gain - gain.mean(axis=0)) ** 2).sum(axis=0))
    return np.asarray(gain.sum(axis=0) > -ndtri(_CHANCE / tried) * error)


def with_accepted(
    start: Solution,
    options: Sequence[Terms],
    fitted: Callable[[Terms], Solution],
    *,
    tried: int = 1,
) -> Solution:
    """The start with the first option that lowers the error, at each joint.

    What a term is worth depends on the terms of the other joints. So a refused one is
    judged again beside those that were accepted.

    Args:
        start: The solution without new terms.
        options: New terms, those to try first in front.
        fitted: Function from new terms to the solution with them.
        tried: Number of terms of which each is the best.
    """
    best, accepted = start, dict[int, list[Effect]]()
    for option in options:
        pending = {j: x for j, x in option.items() if j not in accepted}
        together = fitted({**accepted, **pending}) if pending else best
        while True:
            gains = lowers(best.squares, together.squares, tried=tried)
            new = {j: x for j, x in pending.items() if gains[j]}
            if not new:
                break
            accepted |= new
            pending = {j: x for j, x in pending.items() if j not in new}
            best = fitted(accepted) if pending else together
    return best
