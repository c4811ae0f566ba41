"""Streams of samples as a robot's network delivers them on a bad day."""

from collections.abc import Iterator

import numpy as np

from hybrid.online import Sample

FAULTS = ("nan", "inf", "dropped", "twice", "held", "late", "backward", "ahead", "off")


def damaged(t, q, tau, *, share=0.05, seed=0, faults=FAULTS) -> Iterator[Sample]:
    """A log sample by sample, of which a share is spoilt in one of many ways."""
    rng, waiting, last = np.random.default_rng(seed), [], None
    for k in range(len(t)):
        sample = Sample(float(t[k]), q[k], tau[k])
        fault = rng.choice(faults) if rng.random() < share else ""
        if fault == "late":
            waiting.append((k + rng.integers(1, 6), sample))
        elif fault == "held" and last is not None:
            yield Sample(sample.t, last.q, last.tau)
        elif fault != "dropped":
            if fault == "twice":
                yield sample
            last = _spoilt(sample, fault, rng) if fault else sample
            yield last
        for due, old in waiting:
            if due == k:
                yield old
        waiting = [(due, old) for due, old in waiting if due > k]


def _spoilt(sample, fault, rng):
    t, q, tau = sample.t, sample.q.copy(), sample.tau.copy()
    joint = rng.integers(len(q))
    if fault == "nan":
        q[joint] = np.nan
    elif fault == "inf":
        tau[joint] = rng.choice([-1, 1]) * np.inf
    elif fault == "backward":
        t -= rng.uniform(0.01, 5)
    elif fault == "ahead":
        t += rng.uniform(0.1, 4000)
    elif fault == "off":
        q[joint] += 3.0
    return Sample(t, q, tau)
