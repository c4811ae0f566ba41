"""Whatever a file calls an arm or a joint, it stays a name in every output."""

import ast
import html
import json
import re
import subprocess
import tempfile
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from arms import MODELS
from hypothesis import example, given, settings
from hypothesis import strategies as st
from simulated import quiet
from test_export import model_of

from hybrid.effects.viscous import Viscous
from hybrid.errors import RobotError
from hybrid.exports import FORMATS, export, read_manifest
from hybrid.identification import DynamicModel
from hybrid.names import (
    LONGEST,
    c_comment,
    c_identifier,
    file_stem,
    file_stems,
    markdown,
    name_fault,
    printable,
    xml_comment,
)
from hybrid.report import Section, markdown_table
from hybrid.report.fit import torque_figure
from hybrid.report.output import figure_bytes, render_page
from hybrid.report.table import Table
from hybrid.robot import Robot

PLANAR = Robot.load(MODELS / "planar.xml")
HOSTILE = [
    "../../../x", "/tmp/x", "..", ".", "-rf", "~", "C:\\x", "a/b", "con", "nul.txt",
    "*/ int evil(void) { return 1; } /*", "*/\\", "//", "??/", "a\\",
    '"; system("x"); //', "--><script>alert(1)</script>", "--->", "<b>&amp;", "]]>",
    "'", '"', "%s%n", "{0}{p}", "$\\frac{1}{0}", "$(touch x)", "`x`", "math", "stdio",
    "test", "all", "install", "int", "1", "_", "é", "机器人", "=1+1", "a|b",
    "[link](x)", "{{7*7}}", "x" * LONGEST,
]  # fmt: skip
NO_NAMES = ["", " ", "a\nb", "a\tb", "\x1b[31m", "\ud800", "\u202e", 3, "x" * 129]
NAMES = st.one_of(
    st.sampled_from(HOSTILE),
    st.text(min_size=1, max_size=LONGEST),
    st.tuples(st.text(max_size=9), st.sampled_from(HOSTILE)).map("".join),
).filter(lambda name: not name_fault(name))


def named(arm: str, joint: str) -> Robot:
    chain = replace(PLANAR.chain, joints=(joint, f"{joint[: LONGEST - 2]}_2"))
    return replace(PLANAR, name=arm, chain=chain, path="")


def model(arm: str, joint: str) -> DynamicModel:
    rubbing, sure = [Viscous((0,), {"coefficient": 1.5})], 1e-8 * np.eye(20)
    return model_of(named(arm, joint), rubbing, covariance=sure)


@pytest.fixture(autouse=True, scope="module")
def few_draws():
    """Ranges of few draws: what matters here is what they are called."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_module("hybrid.exports.simulator.snippets"), "_DRAWS", 8)
        yield


def exported(found: DynamicModel, kind: str):
    """The files of an export, none of which lies elsewhere."""
    with tempfile.TemporaryDirectory() as outer:
        out = Path(outer) / "deep" / "out"
        quiet(export, found, out, format=kind)
        everything = [p.relative_to(outer) for p in Path(outer).rglob("*")]
        assert all(p.is_relative_to("deep") for p in everything)
        assert all(p.is_relative_to("deep/out") for p in everything if p.suffix)
        assert read_manifest(out)["robot"] == found.robot.name
        for path in sorted(out.iterdir()):
            assert re.fullmatch(r"[\w.-]+", path.name)
            assert len(path.name.encode()) < 255
            yield path


# Those for other simulators are below.
@pytest.mark.parametrize("kind", sorted({*FORMATS} - {"isaaclab", "ranges"}))
@settings(max_examples=3)
@given(arm=NAMES, joint=NAMES)
@example(arm="../../../x", joint="a/../b")
@example(arm="/tmp/evil", joint="*/ x /*")
def test_every_format_stays_in_its_folder(kind, arm, joint):
    assert len(list(exported(model(arm, joint), kind))) > 1


@settings(max_examples=2)
@given(arm=NAMES, joint=NAMES)
@example(arm='"""; evil()', joint="'] + evil() + ['")
@example(arm="../../../x", joint="a/../b")
@example(arm="/tmp/evil", joint="*/ x /*")
def test_python_for_other_simulators_has_no_code_of_a_name(arm, joint):
    assert calls(arm, joint) == calls(PLAIN, "joint")


@cache
def calls(arm, joint):
    """How many calls each Python file for another simulator has."""
    return [
        sum(isinstance(x, ast.Call) for x in ast.walk(ast.parse(path.read_text())))
        for kind in ("isaaclab", "ranges")
        for path in exported(model(arm, joint), kind)
        if path.suffix == ".py"
    ]


def skeleton(text: str) -> str:
    """C without comments and strings, as the compiler gets to see it."""
    return re.sub(r'/\*.*?\*/|"[^"\n]*"', "", text, flags=re.DOTALL)


PLAIN = "robot"


@cache
def plain_header():
    files = exported(model(PLAIN, "joint"), "c")
    return next(x.read_text("utf-8") for x in files if x.suffix == ".h")


@settings(max_examples=6)
@given(arm=NAMES, joint=NAMES)
@example(arm="x", joint="*/ int evil(void) { return 1; } /*")
@example(arm='"; } int evil(void) {', joint="*/\\")
@example(arm="math", joint="??/")
@example(arm="test", joint="//")
def test_c_compiles_and_has_no_code_of_a_name(arm, joint):
    p = c_identifier(arm)
    for path in exported(model(arm, joint), "c"):
        if path.name == f"{p}.h":
            header = path.read_text("utf-8")
            flags = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-I", str(path.parent)]
            command = ["cc", "-std=c99", *flags, "-fsyntax-only", "example.c"]
            done = subprocess.run(command, cwd=path.parent, capture_output=True)
            assert done.returncode == 0, done.stderr.decode()
    renamed = re.sub(rf"\b{p}_", f"{PLAIN}_", skeleton(header))
    renamed = re.sub(rf"\b{p.upper()}_", f"{PLAIN.upper()}_", renamed)
    assert renamed == skeleton(plain_header())


@pytest.mark.parametrize(("kind", "suffix"), [("urdf", ".urdf"), ("mjcf", ".xml")])
@settings(max_examples=8)
@given(arm=NAMES, joint=NAMES)
@example(arm="--><x/>", joint='"/><evil a="')
def test_xml_reads_back_with_the_same_names(kind, suffix, arm, joint):
    found = model(arm, joint)
    for path in exported(found, kind):
        if path.suffix == suffix:
            root = ElementTree.parse(path).getroot()
            tags = [x for x in root.iter("joint") if x.get("type") or len(x)]
            joints = [x.get("name") for x in tags]
            again, _ = quiet(Robot.load, path)
            assert again.joints == found.robot.joints
            if kind == "urdf":
                assert root.get("name") == again.name == arm
                assert joints[:2] == list(found.robot.joints)
            else:
                assert mujoco.MjModel.from_xml_path(str(path)).njnt == 2


@settings(max_examples=15)
@given(arm=NAMES, joint=NAMES)
def test_json_reads_back_with_the_same_names(arm, joint):
    for path in exported(model(arm, joint), "json"):
        if path.name == "model.json":
            again = DynamicModel.load(path).robot
            assert (again.name, again.joints[0]) == (arm, joint)
            assert json.loads(path.read_text("utf-8"))["robot"]["name"] == arm


class Texts(HTMLParser):
    """Tags and texts of a page."""

    def __init__(self):
        super().__init__()
        self.tags, self.texts = [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)

    def handle_data(self, data):
        self.texts.append(data)


def parsed(page: str) -> Texts:
    found = Texts()
    found.feed(page)
    return found


@settings(max_examples=15)
@given(name=NAMES)
@example(name="<script>alert(1)</script>")
def test_html_shows_the_name_and_nothing_of_it_becomes_a_tag(name):
    def page(name):
        table = Table(("", name), ((name, "1"),), caption=name)
        sections = [Section(name, text=name, table=table)]
        content = {"title": name, "lead": name, "sections": sections}
        return parsed(render_page("page.html", provenance=None, **content))

    assert page(name).tags == page("plain").tags
    assert "".join(page(name).texts).count(name) >= 3


@settings(max_examples=1)
@given(name=NAMES)
@example(name="$\\frac{1}{0}")
@example(name="$a$ $b")
@example(name="机器人")
def test_a_figure_shows_any_name(name):
    x = np.linspace(-1, 1, 9)
    figure = torque_figure(x, x[:, None], {"": x[:, None]}, (name,))
    svg = figure_bytes(figure).decode("utf-8")
    comments = re.findall(r"<!-- (.*?) -->", svg)  # matplotlib names every text in one
    assert ElementTree.fromstring(svg) is not None
    assert any(html.unescape(x).strip() == name.strip() for x in comments) or (
        "--" in name
    )


@given(name=NAMES)
def test_a_cell_of_markdown_is_one_cell_and_no_element(name):
    (row,) = markdown_table(Table(("a", "b"), ((name, "1"),))).splitlines()[2:]
    plain = re.sub(r"\\.", "·", row)
    assert plain.count("|") == 3
    assert not re.search(r"<[A-Za-z/!?]", plain)


@given(name=st.text())
def test_spellings_are_what_their_kind_of_output_takes(name):
    assert re.fullmatch(r"[a-z][a-z0-9_]*", c_identifier(name))
    assert re.fullmatch(r"[\w][\w.-]*", file_stem(name))
    assert not file_stem(name).endswith(".") and len(file_stem(name).encode()) <= 200
    assert "*/" not in c_comment(name) and "\\" not in c_comment(name)
    assert "--" not in xml_comment(name) and not xml_comment(name).endswith("-")
    assert printable(name).isprintable() and printable(markdown(name)).isprintable()


def test_ordinary_names_stay_as_they_are():
    for name in ("coman_like", "ur10", "wrist_1", "KR300-A.v2"):
        assert file_stem(name) == name
        assert c_comment(name) == xml_comment(name) == printable(name) == name
    assert c_identifier("KR300-A") == "kr300_a"
    assert c_identifier("math") == "arm_math" and file_stem("con") == "con_"


@pytest.mark.parametrize(
    "name", ["", "a\nb", "a\tb", "\x1b[31m", "\ud800", "\u202e", 3]
)
def test_what_is_no_name_is_refused(name):
    with pytest.raises(RobotError, match="printable characters") as error:
        replace(PLANAR.chain, joints=(name, "elbow"))
    assert "\n" not in str(error.value) and str(error.value).isprintable()


def test_a_comment_at_the_top_of_a_simulator_ends_where_it_should():
    for name in HOSTILE:
        text = f"<a><!-- {xml_comment(name)} --></a>"
        assert len(ElementTree.fromstring(text)) == 0


@given(names=st.lists(NAMES, unique=True, max_size=12))
def test_files_of_different_names_differ_on_disks_without_capitals(names):
    stems = file_stems([*names, "a/1", "A_1", "a_1", "a_1_3"])
    assert len({x.casefold() for x in stems.values()}) == len(stems)
