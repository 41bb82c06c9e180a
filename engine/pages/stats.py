"""The statistics of a benchmark as one picture: the tables of `stats` as small charts in an SVG file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate
from typing import Any, Final, NamedTuple

from jrdb_avr.engine.pages.page import render
from jrdb_avr.engine.report.formats import Rows
from jrdb_avr.queries.display import Tables
from jrdb_avr.schema.templates import FAMILIES

_PALETTE: Final = [f"c{number}" for number in range(12)]
"""Classes of the picture's style; the first seven are the families' in the order of the table `family`."""

_MEASURES: Final = {
    "time_gap_s": ("Time", "seconds from description to answer", 1.0),
    "apart_deg": ("Turn", "largest angle between needed boxes, degrees", 1.1),
    "hops": ("Hops", "relations in a row", 0.6),
    "people_in_scene": ("People", "in the scene that is described", 1.0),
    "crops": ("Looks", "fewest crops that show all needed boxes", 1.0),
}
_TIMES: Final = {
    "frame": ("Starts", "seconds from the description to the start"),
    "span": ("Spans", "seconds from the description to the start"),
    "frame and angle": ("Searches", "seconds from the description to the start"),
    "seconds": ("Gaps", "seconds between the two events"),
}
_MISTAKES: Final = ("hop.stop", "hop.skip", "pose at t0", "time.shift", "look-alike", "none")
_GUESSERS: Final = ("uniform", "most_frequent", "by_choice", "constant", "offset", "text_only", "learned")


class Bar(NamedTuple):
    """A piece of a row, in fractions of the row's length."""

    start: float
    length: float
    color: str
    label: str = ""


class PanelRow(NamedTuple):
    """A named line of a panel: bars, dots as (place, color, label), a stroke at `aim`, and a note at its end."""

    name: str
    note: str
    bars: Sequence[Bar] = ()
    dots: Sequence[tuple[float, str, str]] = ()
    aim: float | None = None
    missed: bool = False


class Panel(NamedTuple):
    """A chart with its title, of rows or of columns (name and share each); `mark` is a share to compare with."""

    title: str
    note: str
    weight: float = 1.0
    rows: Sequence[PanelRow] = ()
    ticks: Sequence[tuple[float, str]] = ()
    legend: Sequence[tuple[str, str]] = ()
    columns: Sequence[tuple[str, float]] = ()
    color: str = _PALETTE[0]
    mark: float | None = None


def stats_svg(tables: Tables) -> str:
    """The tables of `statistics` as an SVG document."""
    color = dict(zip((row["family"] for row in tables["family"]), _PALETTE, strict=False))
    used = sum(row["n"] > 0 for row in tables["sequence"])
    people = sum(row["people"] for row in tables["sequence"])
    return render(
        "stats.svg",
        title=f"{_sum(tables['family']):,} questions",
        about=f"about {people:,} people in {used} of {len(tables['sequence'])} sequences; "
        f"{len({row['template'] for row in tables['template']})} of {len(FAMILIES)} templates",
        lines=[
            [
                _counts("Families", "stroke: in the paper", tables["family"], ("family", "n", "paper"), color),
                _counts("Templates", "colored by family", tables["shortfall"], ("template", "questions"), color),
                _funnel(tables, color),
                _counts("Sequences", _without_occlusion(tables), _marked(tables), ("sequence", "n"), color),
            ],
            [
                _bins(title, note, [row for row in tables["distribution"] if row["what"] == what], "bin", weight)
                for what, (title, note, weight) in _MEASURES.items()
            ],
            [_answers(tables), _distractors(tables), _blind(tables)],
            [_positions(tables), *(_times(tables, asks, color) for asks in _TIMES)],
        ],
    )


def _marked(tables: Tables) -> Rows:
    """The rows of sequences, with an asterisk where boxes have no occlusion attributes."""
    return [{**row, "sequence": row["sequence"] + " *" * (row["occlusion"] is False)} for row in tables["sequence"]]


def _without_occlusion(tables: Tables) -> str:
    some = any(row["occlusion"] is False for row in tables["sequence"])
    return "questions; *: no occlusion attributes, every box counts as a clear view" if some else "questions"


def _counts(title: str, note: str, rows: Rows, columns: Sequence[str], color: Mapping[str, str]) -> Panel:
    """A bar per row; `columns`: the name, the count, and the count to compare with, if there is one."""
    name, n, *aims = columns
    most = max([1, *(row[column] for row in rows for column in columns[1:])])
    lines = [
        PanelRow(
            row[name],
            " of ".join(f"{row[column]:,}" for column in columns[1:]),
            [Bar(0, row[n] / most, color.get(row.get("family", ""), _PALETTE[0]))],
            aim=row[aims[0]] / most if aims else None,
        )
        for row in rows
    ]
    return Panel(title, f"{note}, n {sum(row[n] for row in rows):,}", rows=lines)


def _bins(title: str, note: str, rows: Rows, column: str, weight: float = 1.0, color: str = _PALETTE[0]) -> Panel:
    """The share of each bin, whose names stand in a column."""
    names = [row[column].strip("[)(").replace(", ", "-").replace("-inf", "+") for row in rows]
    shares = [row["share"] for row in rows]
    return Panel(title, f"{note}, n {_sum(rows):,}", weight, columns=list(zip(names, shares, strict=True)), color=color)


def _funnel(tables: Tables, color: Mapping[str, str]) -> Panel:
    """Candidates, proven ones and questions as dots over powers of ten."""
    power = math.ceil(math.log10(max([10, *(row["candidates"] for row in tables["shortfall"])])))
    rows = []
    for row in tables["shortfall"]:
        own = color[row["family"]]
        stages = (("candidates", "none"), ("proven", f"{own} pale"), ("questions", own))
        dots = [(math.log10(row[n]) / power, shade, f"{row[n]:,} {n}") for n, shade in stages if row[n]]
        rows.append(PanelRow(row["template"], "" if row["questions"] else "none", dots=dots))
    return Panel(
        "From candidates to questions",
        "per template, by powers of ten",
        weight=1.15,
        rows=rows,
        ticks=[(n / power, f"{10 ** (n % 3)}{('', 'k', 'M', 'G', 'T')[n // 3]}") for n in range(power + 1)],
        legend=[("candidates", "none"), ("proven", "ink pale"), ("questions", "ink")],
    )


def _times(tables: Tables, asks: str, color: Mapping[str, str]) -> Panel:
    rows = [row for row in tables["answer"] if row["asks"] == asks]
    own = color[FAMILIES[rows[0]["template"]]] if rows else _PALETTE[0]
    return _bins(*_TIMES[asks], rows, "answer", color=own)


def _positions(tables: Tables) -> Panel:
    rows, places = tables["position"], (1, 2, 3, 4)
    n = _sum(rows)
    columns = [(str(at), sum(row["n"] for row in rows if row["position"] == at) / max(1, n)) for at in places]
    return Panel("Place of the right choice", f"the line is a quarter, n {n:,}", 0.8, columns=columns, mark=0.25)


def _answers(tables: Tables) -> Panel:
    by_template = _by_template(row for row in tables["answer"] if row["asks"] == "choice")
    poses = [row["answer"] for name, own in by_template.items() if name not in ("presence", "distance") for row in own]
    order = sorted(set(poses), key=lambda answer: (-poses.count(answer), answer))
    color = {answer: _PALETTE[place % len(_PALETTE)] for place, answer in enumerate(order)}
    rows = []
    for name, own in by_template.items():
        own.sort(key=lambda row: (-row["n"], row["answer"]))
        # Answers that are no poses have shades of their own, so that no color stands for two things.
        parts = [(row["share"], color.get(row["answer"], f"s{n}"), row["answer"]) for n, row in enumerate(own)]
        rows.append(_stacked(name, own, parts))
    return Panel(
        "Right answers of choice questions", "share of each answer within a template, the commonest first", 1.6, rows
    )


def _distractors(tables: Tables) -> Panel:
    color = dict(zip(_MISTAKES, (*_PALETTE[:5], "none"), strict=True))
    rows = []
    for name, own in _by_template(tables["distractor"]).items():
        shares = {kind: sum(row["share"] for row in own if row["yielded_by"].startswith(kind)) for kind in _MISTAKES}
        rows.append(_stacked(name, own, [(share, color[kind], "") for kind, share in shares.items() if share]))
    legend = [("known false, no mistake yields it" if kind == "none" else kind, color[kind]) for kind in _MISTAKES]
    return Panel("Wrong choices", "share by the mistake that yields them", 1.2, rows, legend=legend)


def _stacked(name: str, rows: Rows, parts: Sequence[tuple[float, str, str]]) -> PanelRow:
    """A row of bars end to end: (share, color, label) each."""
    ends = accumulate(share for share, _, _ in parts)
    bars = [Bar(end - share, share, color, label) for end, (share, color, label) in zip(ends, parts, strict=True)]
    return PanelRow(name, f"n {_sum(rows):,}", bars)


def _blind(tables: Tables) -> Panel:
    """Guessers' scores as dots, the aim as a stroke."""
    color = dict(zip(_GUESSERS, _PALETTE, strict=False))
    rows = [
        PanelRow(
            row["form"],
            f"n {row['n']:,}",
            dots=[(row[name], color[name], f"{name}: {row[name]:.0%}") for name in _GUESSERS if row[name] is not None],
            aim=row["aim"],
            missed=row["within_aim"] is False,
        )
        for row in tables["blind"]
    ]
    return Panel(
        "Answering without looking",
        "right answers of guessers; stroke: the aim, n red above it",
        1.2,
        rows,
        ticks=[(step / 4, f"{25 * step} %") for step in range(5)],
        legend=[(name.replace("_", " "), color[name]) for name in _GUESSERS],
    )


def _by_template(rows: Iterable[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    found: dict[str, list[Mapping[str, Any]]] = {}
    for row in sorted(rows, key=lambda row: list(FAMILIES).index(row["template"])):
        found.setdefault(row["template"], []).append(row)
    return found


def _sum(rows: Iterable[Mapping[str, Any]]) -> int:
    return sum(row["n"] for row in rows)
