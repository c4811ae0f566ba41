"""Which learner is the default, by a rule; shared by ``compensators.py``."""

from __future__ import annotations

import numpy as np
from compensator_learners import COLUMNS, LEARNERS
from scipy.stats import binom

INCUMBENT, SURE = "mixture, full", 0.025
CHOICE = """\
Rule: the default is the mixture of the paper, unless another learner that sees one
instant gives unseen torque a higher likelihood in {needed} of {cases} cases or more,
which by chance happens in fewer than {sure:.1%}. The likelihood (nat) counts error and
the honesty of the interval together. (Joints of one run are not quite independent, so
that chance may do a little more.) By this rule the default is: {chosen}.

By error alone it would be the perceptron, whose error is smaller in {fewer} of {cases}
cases; but its likelihood is higher in {better} only: where it errs, it is too sure. It
trains ten times as long, and runs twice as long. C, ONNX and TorchScript take it as
well as the mixture; only a mixture can be updated with new samples. More components
than the data support make a mixture worse."""


def choice(values: np.ndarray) -> str:
    """The rule, and what follows from values of shape (cases, learners, columns)."""
    names, nat = list(LEARNERS), values[:, :, COLUMNS.index("nat")]
    first, cases = names.index(INCUMBENT), len(values)
    wins = (nat > nat[:, [first]]).sum(axis=0)
    needed = int(binom.isf(SURE, cases, 0.5)) + 1
    able = [
        k
        for k, (_, history) in enumerate(LEARNERS.values())
        if wins[k] >= needed and history == 1
    ]
    chosen = max(able, key=lambda k: np.median(nat[:, k]), default=first)
    k = names.index("perceptron")
    fewer = int((values[:, k, 0] < values[:, first, 0]).sum())
    return CHOICE.format(
        cases=cases, needed=needed, sure=SURE, chosen=names[chosen], fewer=fewer,
        better=wins[k],
    )  # fmt: skip
