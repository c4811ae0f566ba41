"""Show a fleet: ranked list, heat map, timelines, and gauges for Prometheus."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from hybrid.files import atomic_path
from hybrid.fleets import Fleet, State
from hybrid.fleets.changes import MONTH, Change
from hybrid.fleets.series import day_text
from hybrid.names import figure_text, file_stems
from hybrid.report.output import Section, write_page
from hybrid.report.style import BLUE, GREY, PALE, RED, Figure, new_figure, panels
from hybrid.report.table import Table
from hybrid.shown import counted
from hybrid.statistics import HALF_WIDTH

_MOST_ROWS = 40  # arms of the heat map and of the list
_MOST_PAGES = 100  # arms with a page of their own
_MOST_TIMELINES = 8  # in the report
_NAMED = 3  # arms in the heading
_TIMELINE = (
    "Deviation from the baseline, with 95 % intervals. Upright line: when a change "
    "began; band: 95 % interval of that; dotted: limits."
)
_CHANGED = "Diagnosed against the baseline"
_DIAGNOSIS = "What hybrid diagnose --baseline says has changed since."
_MOST = 6.0  # standard deviations between arms, of the darkest colour
_NEVER = 36500  # days
_ESCAPES = str.maketrans({"\n": " ", '"': r"\"", "\\": r"\\"})  # of Prometheus


def change_sentence(state: State, change: Change) -> str:
    """Size of a change with its interval, its date, and the date of the alarm."""
    half = HALF_WIDTH * change.std
    if change.kind == "trend":
        size = (
            f"{MONTH * change.size:+.3g} ± {MONTH * half:.2g} {state.unit} a month "
            f"since {day_text(change.day)}"
        )
    else:
        size = f"{change.size:+.3g} ± {half:.2g} {state.unit} on {day_text(change.day)}"
    if change.latest > change.earliest:
        size += f" ({day_text(change.earliest)} to {day_text(change.latest)})"
    return f"{size}, known {day_text(change.alarm)}"


def forecast_text(state: State) -> str:
    """When a parameter will pass its limit; empty without a limit."""
    if not np.isfinite(state.limit):
        return ""
    median, early, late = state.crossing
    if median == 0.0:
        return "passed"
    if not state.changes or not median < _NEVER:
        return "not foreseen"
    last = state.days[-1]
    end = day_text(last + late) if late < _NEVER else "never"
    return f"{day_text(last + median)} ({day_text(last + early)} to {end})"


def alarms_table(fleet: Fleet) -> Table:
    """Changes of all arms, highest score first."""
    rows = [
        (
            x.arm, x.joint, x.parameter.replace("_", " "), f"{x.score:.1f}",
            forecast_text(x), x.confounded,
            "; ".join(change_sentence(x, change) for change in x.changes),
        )
        for x in fleet.alarms[:_MOST_ROWS]
    ]  # fmt: skip
    header = ("arm", "joint", "parameter", "score", "limit passed", "confounded with")
    return Table((*header, "what changed"), tuple(rows), words=True)


def unlike_table(fleet: Fleet) -> Table:
    """Arms that differ from the others, with the parameter."""
    rows = [
        (
            x.arm, x.joint, x.parameter.replace("_", " "),
            f"{x.baseline + x.level.value:.4g} ± "
            f"{HALF_WIDTH * x.level.std:.2g} {x.unit}",
            f"{_median_of_others(fleet, x):.4g} {x.unit}",
        )
        for x in fleet.states if x.unlike
    ]  # fmt: skip
    header = ("arm", "joint", "parameter", "value", "median of others")
    return Table(header, tuple(rows))


def _median_of_others(fleet: Fleet, state: State) -> float:
    key = state.group, state.joint, state.parameter
    others = [
        x.pooled for x in fleet.states
        if (x.group, x.joint, x.parameter) == key and x.arm != state.arm
    ]  # fmt: skip
    return float(np.median(others)) if others else np.nan


def diagnoses_table(fleet: Fleet, arm: str = "") -> Table:
    """Diagnoses against the baseline: all of one arm, or the last of each arm."""
    last = {name: (name, period) for name, period in fleet.diagnoses}.values()
    rows = []
    for key in [x for x in fleet.diagnoses if x[0] == arm] if arm else last:
        verdict, *findings = fleet.diagnoses[key]
        reasons = " ".join(x["reason"] for x in findings)
        rows.append((*key, verdict["reason"].replace("_", " "), reasons))
    header = ("arm", "period", "verdict", "what was found")
    return Table(header, tuple(rows), words=True)


def fleet_tables(fleet: Fleet) -> dict[str, Table]:
    """All tables of a fleet by name."""
    return {
        "alarms": alarms_table(fleet),
        "unlike": unlike_table(fleet),
        "refused": refused_table(fleet),
        "diagnoses": diagnoses_table(fleet),
    }


def refused_table(fleet: Fleet) -> Table:
    """Periods without a result, with the reason."""
    rows = [(x["arm"], x["period"], x["status"], x["reason"]) for x in fleet.refused]
    return Table(("arm", "period", "status", "why"), tuple(rows), words=True)


def _ranked(fleet: Fleet) -> dict[str, float]:
    """Largest score of every arm, those unlike the others first."""
    scores, unlike = dict[str, float](), {x.arm for x in fleet.states if x.unlike}
    for x in fleet.states:
        scores[x.arm] = max(scores.get(x.arm, 0.0), x.score)
    order = sorted(scores, key=lambda x: (x not in unlike, -scores[x], x))
    return {arm: scores[arm] for arm in order}


def arms_table(fleet: Fleet) -> Table:
    """The arms of the heat map, with the number of their periods and of changes."""
    counts = Counter(x.arm for x in fleet.alarms for _ in x.changes)
    periods = Counter(arm for arm, _ in {(x["arm"], x["period"]) for x in fleet.rows})
    rows = [
        (arm, str(periods[arm]), str(counts[arm]), f"{score:.1f}" if score else "–")
        for arm, score in islice(_ranked(fleet).items(), _MOST_ROWS)
    ]
    return Table(("arm", "periods", "changes", "largest score"), tuple(rows))


def heat_figure(fleet: Fleet) -> Figure:
    """Draw the deviation of each arm from the median arm; dots are changes."""
    from scipy.stats import median_abs_deviation

    columns = list(dict.fromkeys((x.joint, x.parameter) for x in fleet.states))
    arms = list(_ranked(fleet))[:_MOST_ROWS]
    values = np.full((len(arms), len(columns)), np.nan)
    dots = []
    for k, column in enumerate(columns):
        own = [x for x in fleet.states if (x.joint, x.parameter) == column]
        level = np.array([x.level.value for x in own])
        std = median_abs_deviation(level, scale="normal")
        std = max(std, float(np.median([x.level.std for x in own])), 1e-12)
        for x, deviation in zip(own, (level - np.median(level)) / std, strict=True):
            if x.arm in arms:
                values[arms.index(x.arm), k] = deviation
                dots += [(k, arms.index(x.arm))] if x.changes else []
    figure = new_figure(1.9 + 0.17 * len(arms))
    axes = figure.subplots()
    image = axes.imshow(values, cmap="RdBu_r", vmin=-_MOST, vmax=_MOST, aspect="auto")
    if dots:
        axes.plot(*np.array(dots).T, "o", color="black", mec="white", markersize=5)
    names = [
        figure_text(f"{joint} {name.partition('.')[0].replace('_', ' ')}")
        for joint, name in columns
    ]
    axes.set_xticks(range(len(columns)), names, rotation=60, ha="right", fontsize=7)
    axes.set_yticks(range(len(arms)), [figure_text(x) for x in arms], fontsize=7)
    axes.tick_params(length=0)
    bar = figure.colorbar(image, ax=axes, shrink=0.6)
    bar.set_label("σ from the median", fontsize=7)
    bar.ax.tick_params(labelsize=7)
    return figure


def timeline_figure(states: Sequence[State]) -> Figure:
    """Draw parameters over time, with their changes and limits."""
    start = min(float(x.days[0]) for x in states)
    titles = [f"{x.arm}: {x.joint}, {x.parameter.replace('_', ' ')}" for x in states]
    label = f"days since {day_text(start)}"
    figure, cells = panels(titles, height=1.35, label=label, size=8)
    for (axes,), x in zip(cells, states, strict=True):
        days = x.days - start
        axes.errorbar(days, x.values, HALF_WIDTH * x.std, fmt=".", color=BLUE,
                      ecolor=PALE, markersize=4, linewidth=0.8)  # fmt: skip
        for change in x.changes:
            axes.axvspan(change.earliest - start, change.latest - start,
                         color=RED, alpha=0.12, linewidth=0)  # fmt: skip
            axes.axvline(change.day - start, color=RED, linewidth=1.0)
        if np.isfinite(x.limit):
            for side in (-x.limit, x.limit):
                axes.axhline(side, color=GREY, linewidth=0.8, linestyle=":")
        axes.margins(x=0.05)
        axes.set_ylabel(figure_text(f"[{x.unit}]" if x.unit else "[–]"))
    return figure


def lead_sentence(fleet: Fleet) -> str:
    """The result in a sentence."""
    arms = {x["arm"] for x in fleet.rows}
    changed = {x.arm for x in fleet.alarms}
    unlike = {x.arm for x in fleet.states if x.unlike}
    return (
        f"{counted(len(arms), 'arm')} over {fleet.arm_months:,.0f} arm-months: "
        f"{len(changed):,} changed, {len(unlike):,} unlike the others, "
        f"{counted(len(fleet.refused), 'period')} without a result."
    )


def write_fleet_pages(
    folder: Path, fleet: Fleet, *, provenance: Mapping[str, Any]
) -> Path:
    """Write ``report.html``, a page for each arm that it names, and ``fleet.prom``."""
    ranked = islice(_ranked(fleet), _MOST_ROWS)
    unlike = (x.arm for x in fleet.states if x.unlike)
    diagnosed = (arm for arm, _ in fleet.diagnoses)
    changed = list(dict.fromkeys(x.arm for x in fleet.alarms))
    named = dict.fromkeys([*changed, *unlike, *diagnosed, *ranked])
    stems = file_stems(list(named)[:_MOST_PAGES])
    pages = {arm: f"arms/{stem}.html" for arm, stem in stems.items()}
    (folder / "arms").mkdir(parents=True, exist_ok=True)
    for arm, page in pages.items():
        own = [x for x in fleet.states if x.arm == arm]
        lead = " ".join(
            f"{x.joint}, {x.parameter}: {change_sentence(x, c)}."
            for x in own for c in x.changes
        )  # fmt: skip
        parts = list(_arm_sections(fleet, arm, own))
        write_page(folder / page, arm, parts, lead=lead, provenance=provenance)
    path, lead = folder / "report.html", lead_sentence(fleet)
    sections = list(_fleet_sections(fleet, pages))
    more = f" and {len(changed) - _NAMED} more" if len(changed) > _NAMED else ""
    title = f"Fleet: {', '.join(changed[:_NAMED]) or 'no arm'}{more} changed"
    write_page(path, title, sections, lead=lead, provenance=provenance)
    with atomic_path(folder / "fleet.prom") as temporary:
        temporary.write_text(prometheus_text(fleet), encoding="utf-8")
    return path


def _arm_sections(fleet: Fleet, arm: str, own: Sequence[State]) -> Iterator[Section]:
    diagnoses = diagnoses_table(fleet, arm)
    if diagnoses.rows:
        yield Section(_CHANGED, _DIAGNOSIS, table=diagnoses)
    if own:
        yield Section("Over time", figure=timeline_figure(own), caption=_TIMELINE)


def _fleet_sections(fleet: Fleet, pages: Mapping[str, str]) -> Iterator[Section]:
    text = (
        f"False alarms that noise raises: {fleet.false_alarms:g} in 100 arm-months. A "
        "score is the size of a change over its standard deviation."
    )
    tables = {name: _linked(x, pages) for name, x in fleet_tables(fleet).items()}
    if tables["alarms"].rows:
        yield Section("What changed", text, table=tables["alarms"])
    else:
        yield Section("What changed", f"Nothing. {text}")
    if fleet.states:
        caption = "How far each arm stands from the fleet; dots are changes."
        yield Section("The fleet", figure=heat_figure(fleet), caption=caption)
    if fleet.alarms:
        figure = timeline_figure(fleet.alarms[:_MOST_TIMELINES])
        yield Section("The surest changes", figure=figure, caption=_TIMELINE)
    last = f"The last period of each arm. {_DIAGNOSIS}"
    for name, title, text in (
        ("diagnoses", _CHANGED, last),
        ("unlike", "Unlike the others", ""),
        ("refused", "Without a result", ""),
    ):
        if tables[name].rows:
            yield Section(title, text, table=tables[name])
    if fleet.states:
        yield Section("The arms", table=_linked(arms_table(fleet), pages))
    if fleet.shared:
        text = "\n\n".join(f"{x[:1].upper()}{x[1:]}." for x in fleet.shared)
        yield Section("What all arms share", text)


def _linked(table: Table, pages: Mapping[str, str]) -> Table:
    """The table with a link to the page of each arm in its first column."""
    link, filled = Markup('<a href="{}">{}</a>'), table.filled()
    rows = [
        (link.format(pages[arm], arm) if arm in pages else arm, *rest)
        for arm, *rest in filled.rows
    ]
    return replace(filled, rows=tuple(rows))


def prometheus_text(fleet: Fleet) -> str:
    """Gauges in the text format of Prometheus."""

    def labels(**named: str) -> str:
        return ",".join(f'{k}="{v.translate(_ESCAPES)}"' for k, v in named.items())

    states = [
        (x, labels(arm=x.arm, joint=x.joint, parameter=x.parameter))
        for x in fleet.states
    ]
    refused = Counter(x["arm"] for x in fleet.refused)
    arms = dict.fromkeys(x["arm"] for x in fleet.rows)
    gauges = {
        "value": [(who, x.baseline + x.level.value) for x, who in states],
        "value_std": [(who, x.level.std) for x, who in states],
        "changed_score": [(who, x.score) for x, who in states],
        "unlike": [(who, float(x.unlike)) for x, who in states],
        "limit_days": [(w, x.crossing[0]) for x, w in states if np.isfinite(x.limit)],
        "refused_periods": [(labels(arm=x), float(refused[x])) for x in arms],
    }
    lines = []
    for name, found in gauges.items():
        lines.append(f"# TYPE hybrid_fleet_{name} gauge")
        lines += [
            f"hybrid_fleet_{name}{{{who}}} " + f"{x:.9g}".replace("inf", "+Inf")
            for who, x in found
        ]
    return "\n".join(lines) + "\n"
