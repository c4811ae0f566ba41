"""The mutation campaign changes what it says, and only that."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("cosmic_ray", reason="an optional extra")
sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import mutation
from patch import patch_of
from witnesses import Witnesses

SIGNALS = ("hybrid/signals",)
FACTOR = "int(rate / (_SAMPLES_PER_PERIOD * cutoff)"  # in a line of the filters


def test_a_seed_draws_the_same_mutants_and_fewer_are_the_first_of_more():
    many, few, other = (
        [m.key for m in mutation.drawn(seed, count, SIGNALS)]
        for seed, count in ((0, 16), (0, 8), (5, 16))
    )
    assert len(set(many)) == 16
    assert few == many[:8]
    assert many != other


def test_every_mutant_changes_the_line_that_it_names():
    for mutant in mutation.drawn(0, 16, SIGNALS):
        before = (mutation.ROOT / mutant.path).read_text().splitlines()
        after = mutant.source().splitlines()
        changed = [x for x, y in zip(before, after, strict=True) if x != y]
        assert len(changed) == 1
        assert changed[0].strip() == mutant.place.split("\0")[0]


def test_a_change_that_cannot_be_made_is_not_drawn():
    """It failed: Cosmic Ray replaces no `mujoco.FatalError` among others."""
    path = "hybrid/robot/mujoco_model.py"
    assert "OSError, mujoco.FatalError)" in (mutation.ROOT / path).read_text()
    every = [m for m in mutation.mutants(path) if m.operator == "ExceptionReplacer"]
    drawn = [m for m in every if mutation._compiles(m)]
    assert 0 < len(drawn) < len(every)
    assert all("CosmicRayTestingException" in m.source() for m in drawn)


def test_nothing_of_an_annotation_is_changed():
    """`float | None` is `float & None` to nobody, as nothing evaluates it."""
    found = mutation.mutants("hybrid/signals/motion.py")
    assert not [m for m in found if "BitOr" in m.operator]


def test_a_patch_changes_the_function_and_its_undoing_changes_it_back():
    from hybrid.signals.filters import Sampler

    def mutants():
        path = "hybrid/signals/filters.py"
        for mutant in mutation.mutants(path):
            if FACTOR in mutant.place and "Div_Mul" in mutant.operator:
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
        assert known == 14 and Sampler.for_rate(1000.0, 20.0).factor == 70_000
    finally:
        function.__code__ = before
    assert Sampler.for_rate(1000.0, 20.0).factor == known


def test_a_constant_is_no_function():
    (mutant, *_) = [
        m
        for m in mutation.mutants("hybrid/signals/filters.py")
        if "_SHORT =" in m.place
    ]
    source = (mutation.ROOT / mutant.path).read_text()
    assert patch_of(source, mutant) is None


def _mutant(text, path="hybrid/signals/filters.py"):
    return next(m for m in mutation.mutants(path) if text in m.place)


def _witnesses(costs, path, *words, needs=None):
    """Tests that all execute the lines with one of the words."""
    needs = needs or {x: [] for x in costs}
    names = mutation.places((mutation.ROOT / path).read_text())
    lines = {x: list(needs) for x in names if any(w in x for w in words)}
    files = {x.partition("::")[0]: "hash" for x in needs}
    return Witnesses(costs, {path: lines}, files, needs)


def test_a_mutant_meets_the_cheapest_tests_that_execute_its_line():
    """What they share counts once, and not for those that do without it."""
    mutant = _mutant(FACTOR)
    costs = {"a::dear": 8.0, "a::cheap": 0.5, "b::x": 1.0, "b::y": 1.0, "fixture": 5.0}
    needs = {x: ["fixture"] * (x[0] == "b") for x in costs if x != "fixture"}
    word = FACTOR
    found = _witnesses(costs, mutant.path, word, needs=needs)
    assert found.of(mutant) == ("a::cheap", "b::x", "b::y")
    assert found.price(("b::x", "b::y")) == 1.0 + 1.0 + 5.0
    assert found.price(("a::cheap",)) == 0.5
    assert not _witnesses(costs, mutant.path, "no such line", needs=needs).of(mutant)
    alone = _witnesses({"c::x": 30.0}, mutant.path, word)
    assert alone.of(mutant) == ("c::x",)


def test_a_constant_meets_the_tests_that_execute_a_line_which_names_it():
    mutant, costs = _mutant("_SHORT ="), {"a::b": 1.0}
    assert _witnesses(costs, mutant.path, "< _SHORT").of(mutant) == ("a::b",)
    assert not _witnesses(costs, mutant.path, "int(rate /").of(mutant)


def test_a_constant_that_its_module_never_names_meets_tests_of_those_that_do():
    prior = _mutant("file_factor: float", "hybrid/diagnosis/prior.py")
    path, costs = "hybrid/diagnosis/explanations/posterior.py", {"a::b": 1.0}
    assert _witnesses(costs, path, "file_factor").of(prior) == ("a::b",)
    assert not _witnesses(costs, path, "no such line").of(prior)


def test_a_test_file_that_is_watched_anew_replaces_what_it_executed_before():
    path = "hybrid/signals/filters.py"
    old = _witnesses({"a::x": 1.0, "b::x": 1.0}, path, "_SHORT")
    new = _witnesses({"a::y": 2.0, "f": 3.0}, path, "_SHORT", needs={"a::y": ["f"]})
    both = old.updated(new)
    assert both.costs == {"b::x": 1.0, "a::y": 2.0, "f": 3.0}
    assert both.needs == {"b::x": [], "a::y": ["f"]}
    assert all(set(x) == {"a::y", "b::x"} for x in both.lines[path].values())
