"""The mutation campaign changes what it says, and only that."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("cosmic_ray", reason="an optional extra")
sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import mutation
from patch import patch_of
from tiers import tiers

SIGNALS = ("hybrid/signals",)


def test_a_seed_draws_the_same_mutants_and_fewer_are_the_first_of_more():
    many, few, other = (
        [m.key for m in mutation.drawn(seed, count, SIGNALS)]
        for seed, count in ((0, 30), (0, 10), (5, 30))
    )
    assert len(set(many)) == 30
    assert few == many[:10]
    assert many != other


def test_every_mutant_changes_the_line_that_it_names():
    for mutant in mutation.drawn(0, 25, SIGNALS):
        before = (mutation.ROOT / mutant.path).read_text().splitlines()
        after = mutant.source().splitlines()
        changed = [x for x, y in zip(before, after, strict=True) if x != y]
        assert len(changed) == 1
        assert changed[0].strip() == mutant.place.split("\0")[0]


def test_nothing_of_an_annotation_is_changed():
    """`float | None` is `float & None` to nobody, as nothing evaluates it."""
    found = mutation.mutants("hybrid/signals/motion.py")
    assert not [m for m in found if "BitOr" in m.operator]


def test_a_patch_changes_the_function_and_its_undoing_changes_it_back():
    from hybrid.signals.filters import Sampler

    def mutants():
        path = "hybrid/signals/filters.py"
        for mutant in mutation.mutants(path):
            if "int(rate / (5.0 * cutoff)" in mutant.place and "Div_Mul" in (
                mutant.operator
            ):
                return mutant
        raise AssertionError("no such line")

    mutant = mutants()
    source = (mutation.ROOT / mutant.path).read_text()
    patch = patch_of(source, mutant)
    assert patch.names == ("Sampler", "for_rate")
    function = Sampler.__dict__["for_rate"].__func__
    before, known = function.__code__, Sampler.for_rate(1000.0, 20.0).factor
    try:
        patch.apply()
        assert known == 10 and Sampler.for_rate(1000.0, 20.0).factor == 100_000
    finally:
        function.__code__ = before
    assert Sampler.for_rate(1000.0, 20.0).factor == known


def test_a_constant_is_no_function():
    (mutant, *_) = [
        m for m in mutation.mutants("hybrid/signals/filters.py") if "_PART =" in m.place
    ]
    source = (mutation.ROOT / mutant.path).read_text()
    assert patch_of(source, mutant) is None


def test_what_survives_meets_the_slow_tests_and_those_of_its_folder_once():
    first, second = tiers("hybrid/calibration/solve.py")
    quick, slow = (
        f"tests/test_calibrate.py::test_{x}"
        for x in ("calibrate_is_public", "errors_stay_within_a_fifth[0.0]")
    )
    assert first.holds(quick) and not first.holds(slow)
    assert second.holds(slow) and not second.holds(quick)
    near = tiers("hybrid/online/intake.py")[1]
    beside = tiers("hybrid/regression/prior.py")
    assert beside[0].files == ("tests/test_ladder.py",)
    assert "tests/test_cross_products.py" in beside[1].files
    assert beside[1].holds("tests/test_cross_products.py::test_anything")
    assert not beside[1].holds("tests/test_ladder.py::test_anything")
    assert "tests/test_ladder.py" not in near.files
