"""The picture of a benchmark: the tables of `stats` as small charts on one page."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from jrdb_avr.engine.pages.stats_charts import (
    BLUE,
    FAINT,
    INK,
    RED,
    RULE,
    SMALL,
    Canvas,
    Color,
    Panel,
    Part,
    bars,
    columns,
    legend,
    names_width,
    stacks,
)
from jrdb_avr.queries.store import write_bytes
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.method import Image
from jrdb_avr.schema.wording import FAMILIES

Tables = Mapping[str, Sequence[Mapping[str, Any]]]

_WIDTH, _EDGE, _GAP = 1920, 28, 16
_HEAD: Final = 92
_HEIGHTS: Final = (380, 250, 380, 250)
"""Heights of the rows of panels; the first grows with the number of sequences."""

_COLORS: Final[dict[str, Color]] = {
    "action_boundary": (62, 116, 166),
    "unique_anchor": (128, 138, 150),
    "chain_2hop": (222, 138, 54),
    "chain_3hop": (196, 88, 60),
    "chain_fork_join": (146, 66, 96),
    "chain_hybrid": (70, 140, 110),
    "long_range": (118, 98, 160),
}

_PALE: Final[tuple[Color, ...]] = (
    *((62, 116, 166), (222, 138, 54), (70, 140, 110), (196, 88, 60), (118, 98, 160), (196, 164, 60)),
    *((90, 160, 180), (170, 120, 100), (146, 66, 96), (128, 138, 150), (150, 170, 90), (90, 100, 120)),
)
_NONE: Final[Color] = (222, 225, 228)
_SLATES: Final[tuple[Color, ...]] = ((84, 100, 122), (126, 140, 158), (168, 179, 192), (204, 211, 219))
"""For answers that are no poses, so that no color stands for two things."""


def write_portrait(path: Path, tables: Tables) -> None:
    """Write the picture of the tables of `stats.statistics` as PNG. Raises StoreError where that is not possible."""
    import cv2

    done, data = cv2.imencode(".png", cv2.cvtColor(draw(tables), cv2.COLOR_RGB2BGR))
    if not done:
        raise StoreError(f"cannot draw {path}; give a shorter table")
    write_bytes(path, data.tobytes())


def draw(tables: Tables) -> Image:
    """The page, RGB."""
    heights = (max(_HEIGHTS[0], 90 + 17 * len(tables["sequence"])), *_HEIGHTS[1:])
    canvas = Canvas(_WIDTH, _HEAD + sum(heights) + _GAP * len(heights) + _EDGE - _GAP)
    n = sum(row["n"] for row in tables["family"])
    canvas.text((_EDGE, 48), f"{n:,} questions", size=30, bold=True)
    asked = sum(row["n"] > 0 for row in tables["sequence"])
    people = sum(row["people"] for row in tables["sequence"])
    canvas.text(
        (_EDGE, 74),
        f"about {people:,} people in {asked} of {len(tables['sequence'])} sequences; "
        f"{len({row['template'] for row in tables['template']})} of {len(FAMILIES)} templates",
        FAINT,
        15,
    )
    rows: tuple[Sequence[tuple[Callable[[Panel, Tables], None], float]], ...] = (
        ((_families, 1.0), (_templates, 1.0), (_funnel, 1.15), (_sequences, 1.25)),
        (
            _measured("time_gap_s"),
            _measured("apart_deg"),
            _measured("hops"),
            _measured("people_in_scene"),
            _measured("crops"),
        ),
        ((_answers, 1.6), (_distractors, 1.2), (_blind, 1.2)),
        ((_positions, 0.8), *((_timed(asks), 1.0) for asks in ("frame", "span", "frame and angle", "seconds"))),
    )
    y = float(_HEAD)
    for row, height in zip(rows, heights, strict=True):
        room = _WIDTH - 2 * _EDGE - _GAP * (len(row) - 1)
        x, whole = float(_EDGE), sum(weight for _, weight in row)
        for draw_panel, weight in row:
            width = room * weight / whole
            draw_panel(Panel(canvas, x, y, width, height), tables)
            x += width + _GAP
        y += height + _GAP
    return canvas.image


def _families(panel: Panel, tables: Tables) -> None:
    rows = tables["family"]
    panel.head("Families", f"questions; the upright stroke is the paper's number, n {_sum(rows):,}")
    names = [row["family"] for row in rows]
    bars(panel, names, [row["n"] for row in rows], [_COLORS[name] for name in names], [row["paper"] for row in rows])


def _templates(panel: Panel, tables: Tables) -> None:
    rows = tables["shortfall"]
    panel.head("Templates", f"questions, in the color of the family, n {sum(row['questions'] for row in rows):,}")
    colors = [_COLORS[row["family"]] for row in rows]
    bars(panel, [row["template"] for row in rows], [row["questions"] for row in rows], colors)


def _sequences(panel: Panel, tables: Tables) -> None:
    rows = tables["sequence"]
    panel.head("Sequences", f"questions, n {_sum(rows):,}")
    bars(panel, [row["sequence"] for row in rows], [row["n"] for row in rows], [BLUE] * len(rows))


def _funnel(panel: Panel, tables: Tables) -> None:
    """Candidates, proven ones and questions as dots over powers of ten."""
    rows = tables["shortfall"]
    panel.head("From candidates to questions", "candidates, proven and questions of each template, by powers of ten")
    canvas = panel.canvas
    names = [row["template"] for row in rows]
    room = names_width(canvas, names, panel.width / 3)
    start, end = panel.left + room, panel.right - 34
    power = max(1, math.ceil(math.log10(max([10, *(row["candidates"] for row in rows)]))))
    scale = (end - start) / power
    middles = panel.rows(names, room, below=46)
    floor = middles[-1] + 13
    for step in range(power + 1):
        canvas.box(start + step * scale, panel.top, 1, floor - panel.top, RULE)
        canvas.text((start + step * scale, floor + 14), _ten(step), FAINT, SMALL, align="center")
    for middle, row in zip(middles, rows, strict=True):
        color = _COLORS[row["family"]]
        places = [
            (start + math.log10(row[what]) * scale, shade)
            for what, shade in (("candidates", _NONE), ("proven", _lighter(color)), ("questions", color))
            if row[what]
        ]
        if not places:
            canvas.text((start + 4, middle + 4), "no candidate", FAINT, SMALL)
            continue
        canvas.box(
            min(x for x, _ in places), middle - 1, max(x for x, _ in places) - min(x for x, _ in places), 2, _NONE
        )
        for x, shade in places:
            canvas.dot(x, middle, 5, shade)
        if not row["questions"]:
            canvas.text((panel.right, middle + 4), "none", FAINT, SMALL, align="right")
    entries = [("candidates", _NONE), ("proven", _lighter(INK)), ("questions", INK)]
    legend(panel, entries, floor + 38)


def _measured(what: str) -> tuple[Callable[[Panel, Tables], None], float]:
    titles = {
        "time_gap_s": ("Time", "seconds from description to answer"),
        "apart_deg": ("Turn", "largest angle between needed boxes, degrees"),
        "hops": ("Hops", "relations to follow"),
        "people_in_scene": ("People", "in the scene that is described"),
        "crops": ("Looks", "fewest crops that show all needed boxes"),
    }

    def draw_panel(panel: Panel, tables: Tables) -> None:
        rows = [row for row in tables["distribution"] if row["what"] == what]
        title, note = titles[what]
        panel.head(title, f"{note}, n {_sum(rows):,}")
        columns(
            panel, [row["bin"].strip("[)(").replace(", ", "-") for row in rows], [row["share"] for row in rows], BLUE
        )

    return draw_panel, {"hops": 0.6, "apart_deg": 1.1, "time_gap_s": 1.0}.get(what, 1.0)


def _answers(panel: Panel, tables: Tables) -> None:
    rows = [row for row in tables["answer"] if row["asks"] == "choice"]
    panel.head("Right answers of choice questions", "share of each answer within a template, the commonest first")
    names = sorted({row["template"] for row in rows}, key=list(FAMILIES).index)
    poses = [row["answer"] for row in rows if row["template"] not in ("presence", "distance")]
    order = sorted(set(poses), key=lambda answer: (-poses.count(answer), answer))
    hue = {answer: _PALE[place % len(_PALE)] for place, answer in enumerate(order)}
    lines = []
    for name in names:
        own = sorted((row for row in rows if row["template"] == name), key=lambda row: (-row["n"], row["answer"]))
        lines.append(
            [
                Part(row["answer"], row["share"], hue.get(row["answer"]) or _SLATES[place])
                for place, row in enumerate(own)
            ]
        )
    stacks(panel, names, lines, [_sum([row for row in rows if row["template"] == name]) for name in names])


def _distractors(panel: Panel, tables: Tables) -> None:
    rows = tables["distractor"]
    panel.head("Wrong choices", "share by the mistake that yields them")
    names = sorted({row["template"] for row in rows}, key=list(FAMILIES).index)
    kinds = ("hop.stop", "hop.skip", "pose at t0", "time.shift", "look-alike", "none")
    hue = dict(zip(kinds, (*_PALE[:5], _NONE), strict=True))
    lines, counts = [], []
    for name in names:
        own = [row for row in rows if row["template"] == name]
        shares = {kind: sum(row["share"] for row in own if row["yielded_by"].startswith(kind)) for kind in kinds}
        lines.append([Part("", share, hue[kind]) for kind, share in shares.items() if share])
        counts.append(_sum(own))
    stacks(panel, names, lines, counts, below=46)
    legend(
        panel,
        [("known false, no mistake yields it" if kind == "none" else kind, hue[kind]) for kind in kinds],
        panel.bottom - 14,
    )


def _blind(panel: Panel, tables: Tables) -> None:
    """Guessers' scores as dots, the aim as a stroke."""
    rows = tables["blind"]
    panel.head(
        "Answering without looking", "right answers of blind guessers; upright stroke: the aim; n is red where above it"
    )
    canvas = panel.canvas
    names = [row["template"] + ("" if row["asks"] != "count" else " (count)") for row in rows]
    room = names_width(canvas, names, panel.width / 3)
    start, end = panel.left + room, panel.right - 52
    middles = panel.rows(names, room, below=46)
    floor = (middles[-1] if middles else panel.top) + 13
    for step in range(5):
        x = start + (end - start) * step / 4
        canvas.box(x, panel.top, 1, floor - panel.top, RULE)
        canvas.text((x, floor + 14), f"{25 * step} %", FAINT, SMALL, align="center")
    hue = dict(zip(("uniform", "most_frequent", "constant", "offset", "text_only"), _PALE, strict=False))
    for middle, row in zip(middles, rows, strict=True):
        for guesser, color in hue.items():
            if row[guesser] is not None:
                canvas.dot(start + (end - start) * row[guesser], middle, 4.5, color)
        if row["aim"] is not None:
            canvas.box(start + (end - start) * row["aim"] - 1, middle - 8, 2, 16, INK)
        canvas.text((end + 8, middle + 4), f"n {row['n']:,}", RED if row["within_aim"] is False else FAINT, SMALL)
    legend(panel, [(name.replace("_", " "), color) for name, color in hue.items()], floor + 38)


def _positions(panel: Panel, tables: Tables) -> None:
    rows = tables["position"]
    n = _sum(rows)
    panel.head("Place of the right choice", f"the line is a quarter, n {n:,}")
    places = [1, 2, 3, 4]
    shares = [sum(row["n"] for row in rows if row["position"] == place) / max(1, n) for place in places]
    columns(panel, [str(place) for place in places], shares, BLUE, mark=0.25)


def _timed(asks: str) -> Callable[[Panel, Tables], None]:
    titles = {
        "frame": ("Starts", "seconds from the description to the start"),
        "span": ("Spans", "seconds from the description to the start"),
        "frame and angle": ("Searches", "seconds from the description to the start"),
        "seconds": ("Gaps", "seconds between the two events"),
    }

    def draw_panel(panel: Panel, tables: Tables) -> None:
        rows = [row for row in tables["answer"] if row["asks"] == asks]
        title, note = titles[asks]
        panel.head(title, f"{note}, n {_sum(rows):,}")
        names = [row["answer"].strip("[)").replace(", ", "-").replace("-inf", "+") for row in rows]
        color = _COLORS[FAMILIES[rows[0]["template"]]] if rows else BLUE
        columns(panel, names, [row["share"] for row in rows], color)

    return draw_panel


def _sum(rows: Sequence[Mapping[str, Any]]) -> int:
    return sum(row["n"] for row in rows)


def _ten(step: int) -> str:
    """A power of ten in few letters."""
    return f"{10 ** (step % 3)}{('', 'k', 'M', 'G', 'T')[step // 3]}"


def _lighter(color: Color) -> Color:
    red, green, blue = (round(part + (255 - part) * 0.5) for part in color)
    return red, green, blue
