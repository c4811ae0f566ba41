"""What is counted over the answers of many experiments."""

import numpy as np
import pytest
from pooled_evidence import answers, known_from_unknown, measures, risk


def finding(effect, joint="elbow", probability=0.9, others=()):
    return {
        "effect": effect, "joints": [joint], "class": [effect, *others],
        "probability": probability,
    }  # fmt: skip


def run(kind, *named, size=1.7, verdict="explained"):
    return {
        "true": [[kind, "elbow"]], "joints": ["elbow"], "named": list(named),
        "verdict": verdict, "sizes": [size],
    }  # fmt: skip


def pooled(*runs, usual=False):
    return [x for r in runs for x in answers(r, usual)]


def share(found, name):
    (ratio,) = (x for said, x in measures(found) if said == name)
    return ratio.hits, ratio.total


def test_a_cause_counts_at_its_joint_and_in_its_class():
    found = pooled(
        run("coulomb", finding("stribeck", others=["coulomb"])),
        run("coulomb", finding("coulomb", "wrist")),
        run("coulomb", finding("viscous")),
        run("coulomb", verdict="unexplained", size=0.4),
    )
    assert share(found, "cause first, in class") == (1, 4)
    assert share(found, "the same, as large") == (1, 3)


def test_friction_of_a_file_without_any_is_no_false_cause():
    named = finding("coulomb"), finding("delay")
    (bare,) = pooled(run("delay", *named), usual=True)
    assert bare.first and len(bare.named) == 1
    (own,) = pooled(run("coulomb", *named), usual=True)
    assert own.first and len(own.named) == 2  # the true one stays


def test_silence_about_a_withheld_effect_is_a_miss_if_the_effect_is_large():
    quiet = run("delay", verdict="no_gap"), run("delay", verdict="no_gap", size=0.4)
    told = run("delay", verdict="unexplained"), run("delay", finding("actuator_lag"))
    found = pooled(*({"withheld": x, "added": x} for x in (*quiet, *told)))
    name = "withheld, a gap is told or as large: abstains or equivalent"
    assert share(found, name) == (2, 3)
    assert share(found, "the same, strictly") == (1, 3)


def test_an_interval_holds_a_value_between_its_ends():
    found = pooled(
        run("coulomb", finding("coulomb"))
        | {"intervals": [["coulomb", "level", 1.0, 0.9, 1.1]]},
        run("viscous", finding("viscous"))
        | {"intervals": [["viscous", "coefficient", 2.0, 0.9, 1.1]]},
        run("delay", finding("delay")),
    )
    assert share(found, "95 % interval of a parameter holds its value") == (1, 2)


def test_risk_is_of_the_most_certain_answers():
    found = pooled(
        run("coulomb", finding("coulomb", probability=0.99)),
        run("coulomb", finding("viscous", probability=0.6)),
        run("coulomb", finding("coulomb", probability=0.8)),
        run("coulomb", verdict="unexplained"),
    )
    coverage, wrong = risk(found)
    assert coverage == pytest.approx([0.25, 0.5, 0.75])
    assert wrong == pytest.approx([0.0, 0.0, 1 / 3])


def test_a_withheld_cause_that_gets_a_less_probable_name_is_told_from_a_known_one():
    pairs = [
        {"added": run("coulomb", finding("coulomb", probability=p)),
         "withheld": run("coulomb", finding("thermal_friction", probability=q))}
        for p, q in ((0.99, 0.7), (0.95, 0.6))
    ]  # fmt: skip
    found = pooled(*pairs)
    assert known_from_unknown(found) == 1.0
    assert np.isfinite(found[0].size) and found[0].withheld
