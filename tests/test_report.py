"""Pages, figures and tables of results."""

import base64
import json
import re
from dataclasses import dataclass
from html.parser import HTMLParser
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

import hybrid
from hybrid import report
from hybrid.errors import HybridError
from hybrid.report.fit import torque_figure

STAGES = ("LS", "WLS", "IRLS", "+ friction", "+ remainder")
JOINTS = ("shoulder", "elbow", "wrist")


# The fields that a report reads, and no more: it must not need a fit.
@dataclass(frozen=True)
class Row:
    name: str
    rms: np.ndarray
    relative: np.ndarray

    @property
    def mean(self) -> float:
        return float(self.rms.mean())


@dataclass(frozen=True)
class Validation:
    robot: str = "two-link arm"
    joints: tuple[str, ...] = JOINTS
    units: tuple[str, ...] = ("N·m",) * 3
    rows: tuple[Row, ...] = ()
    noise_floor: np.ndarray | None = None
    sources: tuple[str, ...] = ("a.csv",)
    samples: int = 12_000
    seconds: float = 60.0


def validation(**changes) -> Validation:
    rms = np.array([8.0, 4.0, 0.5])
    shares = (1.0, 0.98, 0.95, 0.5, 0.25)
    rows = tuple(
        Row(name, rms * share, 0.2 * share * np.ones(3))
        for name, share in zip(STAGES, shares, strict=True)
    )
    return Validation(**({"rows": rows, "noise_floor": 0.2 * rms} | changes))


def torques(n: int = 3, samples: int = 200):
    t = np.linspace(0, 2, samples)
    measured = np.sin(np.outer(t, 1 + np.arange(n)))
    return t, measured, {"LS": 0.8 * measured, "full": 0.99 * measured}


def drawing():
    return torque_figure(*torques(1), JOINTS[:1])


class Loads(HTMLParser):
    """Everything a page would fetch, and whether its tags close."""

    def __init__(self):
        super().__init__()
        self.loads, self.open = [], []

    def handle_starttag(self, tag, attributes):
        self.loads += [v for k, v in attributes if k in ("src", "href", "srcset")]
        if tag not in ("meta", "img", "br", "link"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_table_compares_every_stage_with_the_best_linear_fit():
    table = report.table_from_validation(validation())
    assert table.header == ("", *JOINTS, "mean", "vs IRLS")
    assert [row[0] for row in table.rows] == [*STAGES, "noise floor"]
    assert table.rows[0][1:] == ("8.00", "4.000", "0.500", "4.167", "+5.3 %")
    assert table.rows[2][-1] == "–" and table.rows[4][-1] == "−73.7 %"
    assert "N·m" in table.caption


def test_table_without_a_noise_floor_has_only_stages():
    table = report.table_from_validation(validation(noise_floor=None))
    assert [row[0] for row in table.rows] == list(STAGES)
    assert table.rows[-1][-1] == "−73.7 %"


def test_markdown_table_keeps_its_columns():
    strange = validation(joints=("a|b", "elbow", "wrist"))
    lines = report.markdown_table(report.table_from_validation(strange)).splitlines()
    assert r"a\|b" in lines[0]
    assert {len(re.findall(r"(?<!\\)\|", line)) for line in lines} == {7}


def test_terminal_table_takes_no_name_for_markup():
    out = StringIO()
    strange = validation(joints=("[red]a", "elbow", "wrist"))
    Console(file=out, width=120).print(
        report.terminal_table(report.table_from_validation(strange))
    )
    assert "[red]a" in out.getvalue()
    assert "−73.7 %" in out.getvalue()


@pytest.mark.parametrize("n", [1, 2, 3, 6, 7])
def test_torque_figure_has_torque_and_residual_of_each_joint(n):
    t, measured, predicted = torques(n)
    joints = [f"joint {j}" for j in range(n)]
    figure = torque_figure(t, measured, predicted, joints)
    assert len(figure.axes) == 2 * n
    residual = figure.axes[1].lines[0].get_ydata()
    np.testing.assert_allclose(residual, 0.2 * measured[:, 0])


def test_torque_figure_refuses_what_it_cannot_draw():
    t, measured, predicted = torques()
    with pytest.raises(HybridError, match="full has shape"):
        torque_figure(t, measured, {"full": predicted["full"][:, :2]}, JOINTS)
    with pytest.raises(HybridError, match="valid are 1 to 3"):
        torque_figure(t, measured, dict.fromkeys("abcd", measured), JOINTS)


@pytest.mark.parametrize(
    ("suffix", "start"), [(".svg", b"<?xml"), (".png", b"\x89PNG")]
)
def test_figure_files_depend_on_the_data_only(tmp_path, suffix, start):
    first, second = tmp_path / f"1{suffix}", tmp_path / f"2{suffix}"
    for path in (first, second):
        report.save_figure(drawing(), path)
    assert first.read_bytes().startswith(start)
    assert first.read_bytes() == second.read_bytes()


def test_a_figure_of_no_known_kind_writes_nothing(tmp_path):
    with pytest.raises(HybridError, match="valid are svg, png, pdf"):
        report.save_figure(drawing(), tmp_path / "rms.bmp")
    assert list(tmp_path.iterdir()) == []


def test_results_are_json_with_null_for_what_is_not_a_number(tmp_path):
    path = tmp_path / "results.json"
    report.write_results(path, {"rms": np.array([1.5, np.nan]), "n": np.int64(3)})
    assert json.loads(path.read_text("utf-8")) == {"rms": [1.5, None], "n": 3}


def test_page_is_one_file_that_loads_nothing(tmp_path):
    path = tmp_path / "index.html"
    result = validation()
    sections = [
        report.Section(
            "Errors",
            "First.\n\nSecond.",
            table=report.table_from_validation(result),
            figure=drawing(),
            caption="Errors per joint.",
            command="make demo",
        )
    ]
    report.write_page(
        path, "Result", sections, lead="Good.", provenance=report.provenance(seed=3)
    )
    page = path.read_text("utf-8")
    assert not re.search(r"https?://|//[a-z]|@import|<script|<link", page)
    loads = Loads()
    loads.feed(page)
    assert loads.open == []
    (image,) = loads.loads
    prefix = "data:image/svg+xml;base64,"
    assert image.startswith(prefix)
    assert b"<svg" in base64.b64decode(image.removeprefix(prefix))
    for text in ("−73.7 %", "<p>First.</p>", "Errors per joint.", "make demo", "seed"):
        assert text in page


def test_page_escapes_names(tmp_path):
    evil = '<img src="x" onerror="alert(1)">'
    result = validation(joints=(evil, "elbow", "wrist"), robot=evil)
    sections = [
        report.Section(
            evil,
            evil,
            table=report.table_from_validation(result),
            figure=drawing(),
            caption=evil,
            command=evil,
        )
    ]
    report.write_page(
        tmp_path / "x.html", evil, sections, lead=evil, provenance={evil: evil}
    )
    page = (tmp_path / "x.html").read_text(encoding="utf-8")
    assert evil not in page
    assert page.count("<img") == 1


def test_a_page_that_fails_leaves_the_old_one(tmp_path):
    path = tmp_path / "index.html"
    path.write_text("old")

    class Broken:
        def savefig(self, *args, **options):
            raise RuntimeError("no ink")

    with pytest.raises(RuntimeError, match="no ink"):
        report.write_page(path, "Result", [report.Section("Broken", figure=Broken())])
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_foot_of_a_page_leaves_out_what_is_empty(tmp_path):
    made = {"seed": 0, "inputs": []}
    report.write_page(tmp_path / "x.html", "x", [], provenance=made)
    page = (tmp_path / "x.html").read_text(encoding="utf-8")
    assert "seed" in page and "inputs" not in page


def test_provenance_names_versions_and_what_it_was_given():
    found = report.provenance(seed=7, data="sha256:00")
    assert found["seed"] == 7
    assert found["hybrid"] == hybrid.__version__
    assert {"numpy", "mujoco", "scipy"} <= set(found["packages"])
    assert "pytest" not in found["packages"]
    assert found == report.provenance(seed=7, data="sha256:00")
