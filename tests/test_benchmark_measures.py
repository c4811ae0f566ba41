"""Every measure of the benchmark against a count by hand."""

import math

import numpy as np
import pytest
from blind.measures import (
    MEASURES,
    Ratio,
    as_method,
    class_size,
    confusion,
    coverage,
    scored,
    shares,
    size,
)
from blind.score import Named
from test_benchmark import row

from hybrid.diagnosis.prior import Prior

BY_NAME = {m.name: m for m in MEASURES}
ABSTAIN = (
    "abstains, ≥ 1×",
    "the same: abstains",
    "no file describes it: abstains, ≥ 1×",
)


def coulomb(joint="j", effect="coulomb", alike=None):
    return Named(effect, (joint,), alike or (effect,))


def case(stratum, named=(), *, effect="coulomb", size=1.0, **more):
    return row(stratum, [(effect, ["j"], size)], list(named), **more)


def of(name, rows):
    return BY_NAME[name].of(rows)


# --- abstention -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "stratum"),
    [*zip(ABSTAIN, ("single", "withheld", "unknown"), strict=True)],
)
def test_only_an_answer_that_names_nothing_abstains(name, stratum):
    silent, speaks = case(stratum), case(stratum, [coulomb()])
    assert of(name, [silent]) == Ratio(1, 1)
    assert of(name, [speaks]) == Ratio(0, 1)
    assert of(name, [silent, silent, speaks]) == Ratio(2, 3)
    others = {"single", "withheld", "unknown", "none", "pair"} - {stratum}
    assert of(name, [case(other) for other in others]) == Ratio(0, 0)
    assert of(name, [case(stratum, size=0.5)]) == Ratio(0, 0)


def test_to_abstain_is_a_fault_where_the_effect_is_known_and_a_merit_where_not():
    wanted = {name: BY_NAME[name].wanted for name in ABSTAIN}
    assert [x[0] for x in wanted.values()] == ["≤", "≥", "≥"]
    assert BY_NAME["abstains, ≥ 1×"].target < 0.5
    assert all(BY_NAME[name].target > 0.5 for name in ABSTAIN[1:])


def test_effects_with_a_declared_equivalent_are_not_among_those_without():
    name = "the same, of effects to which none is declared equivalent"
    unlike = case("withheld", effect="backlash")
    alike = case("withheld", effect="viscous")
    assert of(name, [unlike, alike]) == Ratio(1, 1)
    wrong = case("withheld", [coulomb()], effect="backlash")
    assert of(name, [wrong]) == Ratio(0, 1)


def test_where_an_effect_is_withheld_an_equivalent_may_be_named():
    name = "effect withheld: abstains or names an equivalent, ≥ 1×"
    equivalent = case(
        "withheld", [coulomb(effect="thermal_friction")], effect="viscous"
    )
    stranger = case("withheld", [coulomb(effect="backlash")], effect="viscous")
    silent = case("withheld", effect="viscous")
    assert of(name, [equivalent, silent, stranger]) == Ratio(2, 3)
    assert of("the same: abstains", [equivalent, silent, stranger]) == Ratio(1, 3)


# --- right causes ---------------------------------------------------------------------


def test_a_cause_in_its_class_is_right_but_not_strictly():
    alike = case("single", [coulomb(effect="stribeck", alike=("stribeck", "coulomb"))])
    exact = case("single", [coulomb()])
    wrong = case("single", [coulomb("k")])
    rows = [alike, exact, wrong]
    assert of("right cause first, in its class, ≥ 1×", rows) == Ratio(2, 3)
    assert of("the same, ≥ 1×, strict", rows) == Ratio(1, 3)
    place = "joint localised, of those that name something, ≥ 1×"
    assert of(place, [*rows, case("single")]) == Ratio(2, 3)


def test_sizes_part_the_large_from_the_small():
    def rows(size):
        return [case("single", [coulomb()], size=size)]

    large, small = "right cause first, in its class, ≥ 1×", "right cause first, 0.3×"
    for size_, counts in (
        (0.84, (0, 0)),
        (0.85, (1, 0)),
        (0.6, (0, 1)),
        (0.61, (0, 0)),
    ):
        assert (of(large, rows(size_)).total, of(small, rows(size_)).total) == counts
    assert of(small, rows(0.0)).total == 0
    assert of(small, [case("pair", size=0.3)]).total == 0


def test_where_the_truth_shrinks_the_gap_is_counted_apart():
    name = "the same, where the truth shrinks the gap on unseen motions"
    known = case("single", [coulomb()], shrinkage={"share": 0.9})
    open_ = case("single", [coulomb()], shrinkage={"share": None})
    assert of(name, [known, open_, case("single", [coulomb()])]) == Ratio(1, 1)


def test_evidence_of_just_what_a_term_needs_shows():
    name = "the same, where the truth shows in the recordings"
    ahead = [Prior().cause - 0.1, Prior().cause, None]
    rows = [case("single", size=0.3, shrinkage={"ahead": x}) for x in ahead]
    assert [of(name, [r]).total for r in rows] == [0, 1, 1]


# --- false alarms and several effects -------------------------------------------------


def test_an_alarm_is_a_name_or_a_verdict_other_than_no_gap():
    none = [
        row("none", [], [], verdict="no_gap"),
        row("none", [], [], verdict="unexplained"),
        row("none", [], [coulomb()], verdict="explained"),
    ]
    assert of("false alarm, no effect at all", none) == Ratio(1, 3)
    assert of("the same: says that something is there", none) == Ratio(2, 3)
    assert BY_NAME["false alarm, no effect at all"].wanted == "≤ 1 %"


def several(stratum, count, named):
    effects = [("coulomb", [f"j{k}"], 1.0) for k in range(count)]
    return row(stratum, effects, [coulomb(j) for j in named])


def test_of_several_effects_all_must_be_found():
    pairs = [several("pair", 2, x) for x in (["j0", "j1"], ["j0"], ["j0", "j1", "x"])]
    assert of("two effects: both found, each ≥ 1×", pairs) == Ratio(2, 3)
    assert of("two effects: any false cause", pairs) == Ratio(1, 3)
    three = [several("triple", 3, x) for x in (["j0", "j1", "j2"], ["j0", "j1"], ["x"])]
    assert of("three effects: all found, each ≥ 1×", three) == Ratio(1, 3)
    assert of("three effects: any false cause", three) == Ratio(1, 3)


@pytest.mark.parametrize(
    ("stratum", "name"),
    [
        ("poor", "poor excitation: any false cause"),
        ("command", "effect of the command alone: any false cause"),
    ],
)
def test_false_causes_of_poor_recordings_are_counted_at_any_size(stratum, name):
    rows = [case(stratum, [coulomb("x")], size=0.1), case(stratum, [coulomb()])]
    assert of(name, rows) == Ratio(1, 2)


def test_physics_of_others_and_places_of_what_no_file_describes():
    other = [case("independent", [coulomb()]), case("independent", [coulomb("x")])]
    assert of("independent physics: right cause first, ≥ 1×", other) == Ratio(1, 2)
    assert of("independent physics, strict", other) == Ratio(1, 2)
    placed = [case(s, where=w) for s in ("withheld", "unknown") for w in (["j"], ["x"])]
    name = "its place, withheld or in no file"
    assert of(name, [*placed, case("unknown"), case("single", where=["j"])]) == Ratio(
        2, 4
    )


def test_what_only_a_diagnosis_can_say_is_marked():
    marked = {m.name for m in MEASURES if m.of_verdict}
    assert marked == {
        "the same, where the truth shows in the recordings",
        "the same: says that something is there",
        "its place, withheld or in no file",
    }


def test_most_that_is_allowed_bounds_faults_and_least_that_is_wanted_merits():
    for m in MEASURES:
        fault = any(x in m.name for x in ("false", "abstains, ≥ 1×"))
        fault &= not m.name.startswith("no file")
        if m.target is None:
            assert m.wanted == ""
        else:
            assert m.most is fault and (m.target <= 0.05) is fault
            assert 0 < m.target < 1
            assert m.wanted == f"{'≤' if fault else '≥'} {100 * m.target:.0f} %"


# --- the rest -------------------------------------------------------------------------


def test_size_is_that_of_the_smallest_effect_where_it_is_largest():
    assert (
        size({"truth": {"effects": [{"sizes": [0.2, 3.0]}, {"sizes": [1.5]}]}}) == 1.5
    )
    assert size({"truth": {"effects": [{"sizes": []}]}}) == 0.0
    assert size({"truth": {"effects": []}}) == 0.0


def test_cases_that_could_not_be_made_are_not_counted():
    rows = [case("single"), {"key": "b", "stratum": "single", "failed": "no motion"}]
    assert scored(rows) == rows[:1]
    assert of("abstains, ≥ 1×", rows) == Ratio(1, 1)


def test_a_ratio_of_nothing_is_no_number():
    assert math.isnan(Ratio(0, 0).value) and Ratio(0, 0).interval == (0.0, 1.0)
    assert Ratio(3, 4).value == 0.75


def test_ends_of_an_interval_are_shares_that_make_the_one_seen_just_likely():
    for hits, total in ((3, 4), (40, 100), (1, 30)):
        for end in Ratio(hits, total).interval:
            deviation = np.sqrt(end * (1 - end) / total)
            assert abs(hits / total - end) == pytest.approx(1.96 * deviation)
    assert Ratio(0, 5).interval[0] == 0.0 and Ratio(5, 5).interval[1] == 1.0


def test_coverage_sums_over_cases():
    rows = [{"covered": (1, 2)}, {"covered": (3, 3)}]
    assert coverage(rows) == Ratio(4, 5)
    assert coverage([]) == Ratio(0, 0)


def test_shares_are_those_of_large_effects_that_are_known():
    rows = [
        case("single", shrinkage={"share": 0.9}),
        case("single", shrinkage={"share": None}),
        case("withheld", shrinkage={"share": 0.5}),
        case("single", size=0.5, shrinkage={"share": 0.4}),
        case("single", motion={"share": 0.7}),
    ]
    assert shares(rows) == [0.9]
    assert shares(rows, of="motion") == [0.7]


def test_the_size_of_a_class_is_counted_where_something_is_named():
    wide = case("single", [coulomb(alike=("coulomb", "stribeck", "presliding"))])
    rows = [wide, case("single", [coulomb()]), case("single")]
    assert class_size(rows) == 2.0
    assert np.isnan(class_size([case("single")]))


def test_another_method_answers_with_its_own_score():
    answer = {**case("single", [coulomb()]), "baselines": {"m": {"named": [], "x": 1}}}
    (found,) = as_method([answer], "m")
    assert found["named"] == [] and found["x"] == 1 and answer["named"]
    assert of("abstains, ≥ 1×", [found]) == Ratio(1, 1)


def test_the_confusion_counts_single_large_effects_and_no_effects():
    rows = [
        case("single", [coulomb(effect="viscous"), coulomb()]),
        case("single", [], size=0.5),
        case("pair", [coulomb()]),
        row("none", [], []),
    ]
    assert confusion(rows) == {("coulomb", "viscous"): 1, ("nothing", "nothing"): 1}
    other = [case("independent", [coulomb()]), case("pair", [coulomb()])]
    assert confusion(other) == {("coulomb", "coulomb"): 1}
