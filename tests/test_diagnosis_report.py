"""The report of a diagnosis: what it says is true, and the page works alone."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from diagnosed import RIPPLE, faultless, planar
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hybrid.diagnosis.answer.diagnosis import (
    Advice,
    Finding,
    Region,
    Shrink,
    Unseen,
    Value,
)
from hybrid.diagnosis.answer.words import (
    LEAST_FINDINGS,
    MOST_LINES,
    headline,
    number,
    range_name,
    region_name,
    shrink_sentence,
    value_cells,
    verdict_lines,
    verdict_sentence,
)
from hybrid.report.diagnosis import _gap_rows, render_diagnosis, write_diagnosis
from hybrid.report.diagnosis_data import (
    MOST_POINTS,
    _roughness,
    evidence_matrix,
    joint_curves,
    thin,
)

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
SLOW = Region("elbow", "speed", 0.0, 0.1, "rad/s", 0.42, (0.35, 0.48))
WHOLE = Region("elbow", "link", 0.0, 1.0, "torque to motion", 0.6, (0.5, 0.7))


def told(result, **changes):
    """A result whose diagnosis says something else."""
    return replace(result, diagnosis=replace(result.diagnosis, **changes))


def plain(page: str) -> str:
    """The words of a page without its markup, its script and its data."""
    body = re.sub(r"<(script|style)\b.*?</\1>", " ", page, flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]*>", " ", body).split())


@pytest.fixture(scope="module")
def page() -> str:
    return render_diagnosis(planar())


class TestPage:
    def test_it_comes_with_the_same_in_json(self, tmp_path):
        write_diagnosis(planar(), tmp_path / "new")
        found = {path.name for path in (tmp_path / "new").iterdir()}
        assert found == {"report.html", "diagnosis.json"}
        content = json.loads((tmp_path / "new" / "diagnosis.json").read_text("utf-8"))
        assert content.pop("provenance")["packages"]["numpy"] == np.__version__
        expected = planar().diagnosis.as_dict()
        expected.pop("provenance")
        assert content == json.loads(json.dumps(expected))

    def test_it_names_nothing_outside_itself(self, page):
        known = r"www\.w3\.org|github\.com/leeoniya/uPlot"  # a namespace, a comment
        assert not re.search(rf"https?://(?!{known})|src=|@import|url\(", page)
        assert "default-src 'none'" in page

    def test_it_tells_of_every_finding_in_words_and_in_numbers(self, page):
        words = plain(page)
        for f in planar().diagnosis.findings:
            assert f.sentence in words and f.remedy in words
            for value in f.parameters:
                assert all(cell in words for cell in value_cells(value))
            assert f"{f.share:.0%} of what is explained" in words

    def test_what_cannot_be_told_apart_is_said_openly(self):
        first, *rest = planar().diagnosis.findings
        alike = replace(first, alternatives=(first.effect, "spring", "torque_offset"))
        words = plain(render_diagnosis(told(planar(), findings=(alike, *rest))))
        assert "Cannot be told from spring or torque offset by these" in words
        assert "at shoulder (or spring or torque offset):" in words

    def test_what_stays_unexplained_is_said_openly(self):
        found = replace(planar().account, ceiling=np.zeros(2), depends=("time", "load"))
        result = told(planar(), unexplained=0.5, verdict="partly_explained")
        words = plain(render_diagnosis(replace(result, account=found)))
        assert "unexplained 50%" in words
        assert "no known effect is its cause" in words
        assert "shoulder time" in words and "elbow load" in words

    def test_where_may_be_known_or_not(self):
        unknown = plain(render_diagnosis(told(planar(), where=())))
        assert "No condition was found" in unknown
        words = plain(render_diagnosis(told(planar(), where=(WHOLE, SLOW))))
        assert "elbow, all of it from torque to motion 60%" in words
        assert "elbow, speed 0 to 0.1 rad/s 42%" in words

    def test_motion_advice_warnings_and_limits_are_shown_where_there_are_some(self):
        first, *rest = planar().diagnosis.findings
        motion = Shrink(0.012, 0.003, 0.75, (-0.01, 0.8), 0.5, "rad")
        moved = replace(first, shrink={**first.shrink, "motion": motion})
        advice = Advice("a velocity ladder", ("stribeck", "coulomb"), 14.2, "next.csv")
        words = plain(
            render_diagnosis(
                told(
                    planar(),
                    findings=(moved, *rest),
                    advice=(advice,),
                    warnings=("the clock jumps",),
                    not_excited=("elbow above 3 rad/s",),
                )
            )
        )
        assert "motion gap over 0.5 s 0.012 → 0.003 rad, 75% less" in words
        assert "interval −1 to 80%" in words
        assert "A velocity ladder. It tells Stribeck friction from Coulomb " in words
        assert "difference: 14 times the noise. Motion: next.csv" in words
        assert "the clock jumps" in words and "elbow above 3 rad/s" in words

    def test_it_says_what_the_held_out_motion_was_used_for(self, page):
        words = plain(page)
        assert "nothing was fitted to it; it only decided which causes stay" in words
        assert "no step" not in words

    @pytest.mark.parametrize(
        ("x", "digits", "text"),
        [
            (1274.0, 3, "1270"), (99.7, 2, "100"), (-123456.0, 3, "−123000"),
            (0.00123, 3, "0.00123"), (29.24, 3, "29.2"), (2e6, 3, "2e+06"),
        ],
    )  # fmt: skip
    def test_a_number_of_usual_size_has_no_exponent(self, x, digits, text):
        assert number(x, digits) == text

    @pytest.mark.parametrize(("error", "usual"), [(0.02, True), (0.05, False)])
    def test_only_small_errors_of_the_file_are_called_usual(self, error, usual):
        words = plain(render_diagnosis(told(planar(), background=error)))
        assert ("Errors of this size are usual" in words) == usual
        assert ("usually nearer to the arm" in words) != usual

    def test_large_errors_of_the_file_are_named_beside_the_causes(self):
        """They were a third of the gap of a real wrist, and only a note said so."""
        for error, named in ((0.02, False), (0.05, True)):
            found = replace(planar().diagnosis, background=error)
            for text in (headline(found), verdict_sentence(found)):
                assert ("other link masses and inertias" in text) == named
            words = plain(render_diagnosis(told(planar(), background=error)))
            assert ("were corrected as well, by about 5%" in words) == named

    def test_a_gap_that_grows_is_said_to_be_more(self):
        grown = Shrink(0.01, 0.033, -2.3, (-5.9, 0.4), 0.5, "rad")
        words = shrink_sentence("motion", grown).replace("\u00a0", " ")
        assert words.endswith("0.033 rad, 230% more (95% interval −40 to 590%)")

    def test_without_a_gap_nothing_is_blamed(self):
        result = faultless()
        assert result.diagnosis.verdict == "no_gap"
        words = plain(render_diagnosis(result))
        assert "No gap" in words and "Nothing: the simulator fits the robot." in words
        assert "Remedy" not in words

    def test_poor_motion_is_no_effect_that_was_tried_in_vain(self):
        words = plain(render_diagnosis(told(faultless(), verdict="not_excited")))
        assert "Move the arm more" in words and "No effect was named" not in words

    def test_the_first_screen_links_the_repaired_simulator(self, page):
        assert "<a href" in page and "Done in" not in page
        words = plain(render_diagnosis(planar(), "sim_fixed.xml"))
        assert "Done in sim_fixed.xml" in words.split("What to run next")[0]

    def test_unnamed_effects_are_said_only_where_there_are_some(self):
        unseen = planar().diagnosis.unseen
        assert unseen and "unnamed" not in plain(render_diagnosis(planar()))
        more = replace(unseen, named=tuple(2 * x for x in unseen.after))
        assert "unnamed effects included" in plain(
            render_diagnosis(told(planar(), unseen=more))
        )

    def test_without_a_cause_none_is_named(self):
        unknown = told(planar(), findings=(), verdict="unexplained", unexplained=1.0)
        words = plain(render_diagnosis(unknown))
        assert (
            "no known effect is its cause" in words and "No effect was named" in words
        )
        assert "unexplained 100%" in words and "Remedy" not in words

    def test_a_name_cannot_break_out_of_the_page(self):
        nasty = "</script><img src=x onerror=alert()>&"
        joints = (nasty, "elbow")
        page = render_diagnosis(told(planar(), robot=nasty, joints=joints))
        assert nasty not in page and "&lt;/script&gt;&lt;img src=x" in page

    def test_the_foot_names_each_file_with_its_hash(self):
        files = [{"file": "arm.xml", "sha256": "a" * 64}]
        words = plain(render_diagnosis(told(planar(), provenance={"inputs": files})))
        assert f"inputs arm.xml {'a' * 64}" in words

    def test_there_are_as_many_colours_as_findings(self):
        page = render_diagnosis(told(planar(), findings=many(12)))
        assert len(set(re.findall(r"--own:(oklch\([^)]*\))", page))) == 12


class TestCurves:
    """What is drawn, on held-out samples."""

    def test_the_fitted_law_is_the_true_one(self):
        curves = joint_curves(planar(), 0)
        (cloud,) = curves["clouds"]
        q = np.array(curves["over"]["position"]["x"])
        sine, cosine, turns = (RIPPLE.values[k] for k in ("sine", "cosine", "periods"))
        true = sine * np.sin(turns * q) + cosine * np.cos(turns * q)
        error = np.array(cloud["law"]) - true
        assert cloud["effect"] == "torque_ripple"
        assert np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(true**2))

    def test_what_is_left_beside_a_law_is_noise(self):
        for i, name in enumerate(("torque_ripple", "stribeck")):
            curves = joint_curves(planar(), i)
            (cloud,) = curves["clouds"]
            left = np.array(cloud["y"]) - np.array(cloud["law"])
            assert cloud["effect"] == name
            assert np.std(left) == pytest.approx(curves["noise"], rel=0.1)

    def test_a_law_is_first_shown_over_what_it_is_a_function_of(self):
        for i, name in enumerate(("position", "speed")):
            assert joint_curves(planar(), i)["clouds"][0]["order"][0] == name

    def test_the_gap_falls_to_its_noise(self):
        said = planar().diagnosis.unseen.after
        for row, left in zip(_gap_rows(planar())[0], said, strict=True):
            assert row["after"] == left  # as in the terminal and the JSON
            assert row["noise"] == pytest.approx(row["after"], rel=0.1)
            assert row["today"] > 2 * row["after"]
            assert row["torque"] > row["today"]

    def test_no_curve_is_long(self):
        for i in range(2):
            curves = joint_curves(planar(), i)
            clouds = [cloud["y"] for cloud in curves["clouds"]]
            assert all(len(y) <= MOST_POINTS for y in clouds)
            _, *lines = curves["time"]
            assert all(len(y) - y.count(None) <= 2 * MOST_POINTS for y in lines)

    @given(
        arrays(float, st.integers(0, 300), elements=st.integers(-999, 999)),
        st.integers(4, 40),
    )
    def test_thinning_keeps_order_and_peaks(self, y, most):
        t = np.arange(len(y)) / 8
        other = np.cos(y)
        ts, *curves = thin(t, [y, other], np.arange(len(y)), most)
        assert len(ts) <= max(2 * most, 4)
        assert ts == sorted(ts)
        for thinned, whole in zip(curves, (y, other), strict=True):
            ends = np.array(
                [f(x) for f in (min, max) for x in (thinned, whole) if len(x)]
            )
            np.testing.assert_allclose(ends[::2], ends[1::2], rtol=1e-3)

    def test_a_line_breaks_where_samples_are_left_out(self):
        rows = np.array([0, 1, 5, 6])
        t, y = thin(rows / 4, [np.ones(4)], rows)
        assert t == [0.0, 0.25, 1.25, 1.25, 1.5]
        assert y == [1.0, 1.0, None, 1.0, 1.0]


class TestEvidence:
    def test_the_named_cells_are_the_findings(self):
        matrix = evidence_matrix(planar())
        named = {(e, c.joints) for e, cells in matrix.rows for c in cells if c.named}
        assert named == {("torque_ripple", "shoulder"), ("stribeck", "elbow")}
        assert {matrix.rows[0][0], matrix.rows[1][0]} == {"torque_ripple", "stribeck"}

    def test_an_imitation_has_evidence_alone_and_none_beside_the_cause(self):
        rows = dict(evidence_matrix(planar()).rows)
        like = rows["nonlinear_viscous"][1]
        assert like.joints == "elbow" and like.alone > 1  # ten to one
        assert like.beside < 0.1 * like.alone

    def test_every_row_is_as_wide_as_the_arm(self):
        for _, cells in evidence_matrix(planar()).rows:
            assert sum(cell.width for cell in cells) == 2

    def test_more_evidence_is_darker(self):
        matrix = evidence_matrix(planar())
        alone = sorted(cell.alone for _, cells in matrix.rows for cell in cells)
        shades = [matrix.shade(x) for x in alone]
        assert shades == sorted(shades) and shades[0] == 0.0 < shades[-1] <= 60.0


def many(count: int) -> tuple[Finding, ...]:
    """Findings at several joints."""
    shrink = {"torque": Shrink(1.0, 0.5, 0.5, (0.4, 0.6))}
    return tuple(
        Finding("coulomb", (f"joint_{k}",), ("coulomb", "spring"), 1 / count, (),
                shrink, "", "")
        for k in range(count)
    )  # fmt: skip


class TestVerdict:
    @given(
        st.integers(0, 12), st.integers(0, 5), st.booleans(), st.booleans(),
        st.sampled_from(["explained", "partly_explained", "unexplained", "no_gap"]),
    )  # fmt: skip
    def test_it_has_few_lines_and_never_less_than_three_findings(
        self, causes, cares, where, next_, verdict
    ):
        diagnosis = replace(
            planar().diagnosis,
            findings=many(causes),
            verdict=verdict,
            warnings=("w",) * cares,
            doubts=("d",) * cares,
            not_excited=("x",) * cares,
            where=(WHOLE, SLOW) if where else (),
            advice=(Advice("run it slowly", ("a", "b"), 3.0),) if next_ else (),
        )
        lines = verdict_lines(diagnosis)
        assert len(lines) <= MOST_LINES + LEAST_FINDINGS == 13
        assert ("Next: run it slowly, to tell a from b" in lines) is next_
        shown = sum(bool(re.match(r"\d+\. ", line)) for line in lines)
        hidden = [int(m[1]) for x in lines if (m := re.match(r"… and (\d+) more", x))]
        assert shown + sum(hidden) == causes
        assert shown >= min(causes, 3)

    def test_it_says_what_where_and_how_far(self):
        lines = verdict_lines(planar().diagnosis)
        assert lines[0] == headline(planar().diagnosis)
        assert lines[1].startswith("Explained: 2 effects account for over 99% of")
        assert lines[2].startswith("RMS gap in N·m: shoulder 1.")
        assert lines[4].startswith("On held-out motion, in N·m: repaired, shoulder 1.")
        assert lines[5].startswith("1. Torque ripple at shoulder: ")
        assert "% less (95% interval " in lines[6]

    @pytest.mark.parametrize(
        ("named", "where"),
        [((0.1, 2.0), "nearly all of the gap at 1 of 2 joints"),
         ((0.9, 2.0), "the gap at no joint in full"),
         ((0.1, 0.2), "nearly all of the gap at 2 of 2 joints")],
    )  # fmt: skip
    def test_part_of_a_gap_is_said_by_its_joints_on_held_out_motion(self, named, where):
        """Not by a share in units of noise, to which small joints add as much."""
        gaps = Unseen((1.0, 2.0), named, named, named, (0.1, 0.2), named)
        found = replace(
            planar().diagnosis,
            verdict="partly_explained",
            unexplained=0.97,
            unseen=gaps,
        )
        assert verdict_lines(found)[1] == (
            f"Partly explained: {where}; of the rest no cause is certain."
        )

    def test_doubts_come_before_all_details(self):
        found = replace(planar().diagnosis, doubts=("the file is of another arm",))
        assert verdict_lines(found)[2] == "Doubts: the file is of another arm"
        page = plain(render_diagnosis(replace(planar(), diagnosis=found)))
        doubt = page.index("Doubts: the file is of another arm.")
        assert doubt < page.index("The gap of each joint")

    @pytest.mark.parametrize(
        ("chance", "words"),
        [(0.873, ", 87% probable"), (0.999, ", over 99% probable"), (np.nan, "")],
    )
    def test_how_probable_a_finding_is_can_be_read(self, chance, words):
        (finding,) = many(1)
        finding = replace(finding, probability=chance)
        text = "\n".join(
            verdict_lines(replace(planar().diagnosis, findings=(finding,)))
        )
        assert f"of what is explained{words};" in text

    def test_it_says_which_joint_has_no_cause_and_where_least_squares_is_better(self):
        """A user can have the least squares without us."""
        (finding,) = many(1)
        own = replace(finding, joints=("shoulder",))
        unseen = Unseen(
            (4.0, 2.0), (1.2, 1.9), (0.9, 2.1), (1.0, 1.0), (0.8, 0.5), (1.2, 1.9)
        )
        found = replace(planar().diagnosis, findings=(own,), unseen=unseen)
        text = "\n".join(verdict_lines(found))
        assert "shoulder 4 → 1.2; no known cause at elbow 1.9;" in text
        assert "least squares alone leaves less at shoulder 0.9" in text
        # An effect without a certain name lowers the gap of a joint without a finding.
        better = replace(unseen, after=(1.2, 0.5), named=(1.2, 1.3))
        text = "\n".join(verdict_lines(replace(found, unseen=better)))
        assert "shoulder 4 → 1.2; no known cause at elbow 1.3;" in text
        words = plain(render_diagnosis(replace(planar(), diagnosis=found)))
        assert "No known cause at elbow 1.9 [N·m]." in words
        assert "Least squares alone leaves less at shoulder 0.9 [N·m]." in words

    def test_the_headline_names_effects_joints_and_what_is_left(self):
        found = planar().diagnosis
        text = headline(found)
        assert text == (
            "Torque ripple at shoulder, Stribeck friction at elbow; noise is left"
        )
        several = replace(many(1)[0], joints=("a", "b", "c"))
        some = replace(found, findings=(several, *many(3)), unexplained=0.31)
        left = Unseen(
            (4.0, 2.0), (1.2, 1.9), (0.9, 2.1), (1.0, 1.0), (0.8, 0.5), (1.2, 1.9)
        )
        where = headline(replace(some, unseen=left)).replace("\u00a0", " ")
        assert where.endswith("; most is left at elbow: 1.9 of 2 N·m, noise 0.5")
        less = replace(left, after=(1.2, 0.5), named=(1.2, 1.3))
        where = headline(replace(some, unseen=less))
        assert where.endswith(
            "elbow: 1.3 of 2\u00a0N·m, the written simulator leaves 0.5, noise 0.5"
        )
        where = headline(replace(some, unseen=replace(left, named=(1.2, 2.1))))
        where = where.replace("\u00a0", " ")
        assert where.endswith(
            "elbow: none of 2 N·m has a certain cause, the written simulator leaves "
            "1.9, noise 0.5"
        )
        kept = replace(left, after=(1.2, 2.1), named=(1.2, 2.1))
        where = headline(replace(some, unseen=kept)).replace("\u00a0", " ")
        assert where.endswith("elbow: none of 2 N·m has a certain cause, noise 0.5")
        some = replace(some, unseen=None)
        assert headline(some).startswith("Coulomb friction at 3 joints, Coulomb ")
        assert headline(some).endswith(" and 1 more effect; 31% of the gap is left")
        other = headline(replace(some, unlike="links do not fit"))
        assert other.startswith("Not the file of this arm: links do not fit; Coulomb")
        nothing = replace(found, findings=(), verdict="unexplained", unexplained=1.0)
        assert headline(nothing) == "No known cause of the gap at shoulder and elbow"

    def test_a_gap_by_usual_errors_of_the_file_is_stated(self):
        sound = replace(
            planar().diagnosis, findings=(), verdict="no_gap", unexplained=0.0,
            rms=(0.05, 0.06), noise_floor=(0.05, 0.0123),
        )  # fmt: skip
        text = headline(sound)
        assert text.startswith("The simulator fits the robot within the usual errors ")
        assert text.endswith("at elbow: 0.06\u00a0N·m, noise 0.0123")
        quiet = replace(sound, noise_floor=(0.05, 0.06))
        assert headline(quiet) == "The simulator fits the robot"

    def test_it_says_what_cannot_be_told_apart(self):
        text = "\n".join(verdict_lines(replace(planar().diagnosis, findings=many(1))))
        assert (
            "1. Coulomb friction at joint_0" in text and "may as well be spring" in text
        )

    @pytest.mark.parametrize(
        ("region", "words"),
        [
            (SLOW, "0 to 0.1\xa0rad/s"),
            (WHOLE, "torque to motion"),
            (replace(SLOW, variable="direction", low=-1.0, high=0.0), "moving down"),
            (replace(SLOW, variable="direction", low=0.0, high=1.0), "moving up"),
        ],
    )
    def test_regions_have_plain_names(self, region, words):
        assert range_name(region) == words
        assert region_name(region).startswith("elbow, ")

    @given(st.floats(-1e4, 1e4, allow_subnormal=False), st.floats(1e-6, 1e3))
    def test_a_rounded_value_stays_in_its_rounded_interval(self, value, half):
        cells = value_cells(Value("j", "x", value, "N·m", (value - half, value + half)))
        mid, ends, unit = (c.replace("−", "-") for c in cells)
        low, high = map(float, ends.split(" to "))
        assert low <= float(mid) <= high and unit == "N·m"
        assert abs(float(mid) - value) <= 0.06 * half + 1e-9 * abs(value) + 1e-9

    def test_a_shape_that_was_searched_for_has_no_interval(self):
        cells = value_cells(Value("j", "x", 0.0123456, "s", (0.0123456, 0.0123456)))
        assert cells == ("0.01235", "–", "s")

    def test_what_is_not_determined_is_said_to_be_so(self):
        value = Value("j", "Ixx", 0.0, "kg·m²", (-1.0, 1.0), determined=False)
        assert value_cells(value)[1] == "−1.0 to 1.0, not determined"


# Picks every joint, zooms by key, hides a curve, turns the arm, changes the matrix.
ACTIONS = """
const out = { errors: [], joints: [] };
addEventListener("error", (event) => out.errors.push(event.message));
const click = (selector) => document.querySelector(selector).click();
const visible = () => [...document.querySelectorAll(".joint:not([hidden])")];
const press = (node, key) =>
  node.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
const number = document.querySelectorAll(".picker [data-pick]").length;
for (let k = 0; k < number; k++) {
  click(`.picker [data-pick="${k}"]`);
  out.joints.push([visible().length, visible()[0].querySelector("h3").textContent,
    visible()[0].querySelectorAll("canvas").length]);
}
const framed = visible()[0].querySelector(".plot"), chart = plots[number - 1][0];
const span = () => chart.scales.x.max - chart.scales.x.min;
const settled = () => new Promise((done) => setTimeout(done, 50));
const drawn = ({ ctx }) =>
  new Set(ctx.getImageData(0, 0, ctx.canvas.width, ctx.canvas.height).data).size;
async function act() {
  await settled();
  const before = span();
  press(framed, "+"); await settled();
  out.zoomed = span() / before;
  press(framed, "0"); await settled();
  out.whole = span() / before;
  out.drawn = drawn(chart);
  const name = framed.querySelector("[role=button]");
  press(name, "Enter"); await settled();
  out.hidden = [name.getAttribute("aria-pressed"), chart.series[1].show];
  const svg = document.getElementById("arm"), picture = svg.innerHTML;
  out.circles = svg.querySelectorAll("circle").length;
  press(svg, "ArrowLeft");
  out.turned = svg.innerHTML !== picture;
  press(svg, "ArrowRight");
  out.turnedBack = svg.innerHTML === picture;
  svg.dispatchEvent(new PointerEvent("pointermove", { buttons: 1, movementX: 30 }));
  out.dragged = svg.innerHTML !== picture;
  out.ground = getComputedStyle(document.body).backgroundColor;
  dispatchEvent(new Event("beforeprint"));
  const joint = [...document.querySelectorAll(".joint")];
  out.printed = joint.every((x) => !x.hidden && x.querySelector("canvas"));
  out.paper = getComputedStyle(document.body).backgroundColor;
  dispatchEvent(new Event("afterprint"));
  out.back = visible().map((x) => joint.indexOf(x));
  out.width = document.documentElement.scrollWidth - innerWidth;
  out.requests = performance.getEntriesByType("resource").length;
  out.images = document.images.length;
  document.body.innerHTML = "";
  document.body.append(JSON.stringify(out));
}
act();
"""


@pytest.fixture(scope="module")
def browser() -> str:
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip(f"no browser found; tried {', '.join(BROWSERS)}")
    return found


def opened(browser, folder, page, size, scheme) -> tuple[dict, list[str]]:
    """What a page did in a browser, and the lines of its console."""
    path = folder / f"{size}.html"
    path.write_text(
        page.replace("</body>", f"<script>{ACTIONS}</script></body>"), "utf-8"
    )
    done = subprocess.run(
        [browser, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom",
         "--enable-logging=stderr", f"--window-size={size}", "--no-first-run",
         "--virtual-time-budget=10000", f"--user-data-dir={folder / 'profile'}",
         f"--blink-settings=preferredColorScheme={scheme}", path.as_uri()],
        capture_output=True, timeout=120,
    )  # fmt: skip
    dom, log = done.stdout.decode(), done.stderr.decode(errors="replace")
    body = re.search(r"<body[^>]*>(\{.*\})\s*</body>", dom, flags=re.DOTALL)
    assert body, dom[-500:] + log
    return json.loads(unescape(body[1])), [
        x for x in log.splitlines() if "CONSOLE" in x
    ]


@pytest.mark.parametrize(
    ("size", "scheme", "ground"),
    [("1200,900", 1, "rgb(255, 255, 255)"), ("500,800", 0, "rgb(26, 26, 26)")],
    ids=["light desk", "dark phone"],
)
def test_the_page_works_in_a_browser(browser, page, tmp_path, size, scheme, ground):
    found, console = opened(browser, tmp_path, page, size, scheme)
    assert console == [] and found["errors"] == []
    assert found["requests"] == 0
    # A picture over time, and four of a law.
    assert found["joints"] == [
        [1, "shoulder: gap over time", 5],
        [1, "elbow: gap over time", 5],
    ]
    assert found["zoomed"] == pytest.approx(0.6) and found["whole"] == 1
    assert found["drawn"] > 2  # shades: nothing drawn has one
    assert found["hidden"] == ["false", False]
    assert found["circles"] == 2 and found["turned"] and found["turnedBack"]
    assert found["dragged"]
    assert found["ground"] == ground and found["paper"] == "rgb(255, 255, 255)"
    assert found["printed"] and found["back"] == [1]
    assert found["width"] <= 0, "the page is wider than its window"


@pytest.mark.parametrize("count", [0, 1, 5])
def test_a_joint_without_samples_is_a_function_of_nothing(count):
    assert _roughness(np.arange(count), np.full(count, 2.0)) == 1.0


def test_the_name_of_a_joint_does_nothing_in_a_browser(browser, tmp_path):
    result, nasty = planar(), "</script><img src=x onerror=alert()>"
    robot, joints = result.gap.robot, (nasty, "elbow")
    named = replace(robot, chain=replace(robot.chain, joints=joints))
    evil = replace(told(result, joints=joints), gap=replace(result.gap, robot=named))
    page = render_diagnosis(evil)
    found, console = opened(browser, tmp_path, page, "1200,900", 1)
    assert console == [] and found["errors"] == []
    assert found["images"] == 0
    assert found["joints"][0][1] == f"{nasty}: gap over time"
