"""Draw the picture of docs/definitions.md: `python docs/draw_definitions.py > docs/definitions.svg`.

The four panels show the covered share of a box, sectors, hops, and the shift of a time. Angles and lengths of time come
from the default rules, so that the picture follows them.
"""

from __future__ import annotations

import math
import sys
from html import escape

from jrdb_avr.schema.rules import LoadRules, Rules

RULES, LOAD = Rules(), LoadRules()
INK, GREY, TRUE, UNKNOWN, NEARER = "#1f2933", "#52606d", "#2f855a", "#d69e2e", "#2b6cb0"
STYLE = (
    'text{font-family:system-ui,-apple-system,"Segoe UI",Roboto,sans-serif;font-size:13px;fill:#1f2933}'
    ".title{font-size:15px;font-weight:600}.small{font-size:12px;fill:#52606d}"
)


def text(x: float, y: float, words: str, kind: str = "", anchor: str = "start") -> str:
    """Return a line of text."""
    return f'<text x="{x:g}" y="{y:g}" class="{kind}" text-anchor="{anchor}">{escape(words)}</text>'


def box(x: float, y: float, width: float, height: float, colour: str, fill: str = "none") -> str:
    """Return a rectangle with an outline."""
    size = f'x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}"'
    return f'<rect {size} fill="{fill}" stroke="{colour}" stroke-width="2"/>'


def line(x1: float, y1: float, x2: float, y2: float, colour: str = INK, arrow: bool = False, dash: str = "") -> str:
    """Return a straight line."""
    more = ' marker-end="url(#arrow)"' if arrow else ""
    more += f' stroke-dasharray="{dash}"' if dash else ""
    ends = f'x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}"'
    return f'<line {ends} stroke="{colour}" stroke-width="2"{more}/>'


def person(x: float, y: float, name: str, colour: str = INK) -> str:
    """Return a person seen from above: a circle with a name."""
    circle = f'<circle cx="{x:g}" cy="{y:g}" r="14" fill="#fff" stroke="{colour}" stroke-width="2"/>'
    return circle + text(x, y + 5, name, anchor="middle")


def wedge(x: float, y: float, radius: float, first: float, last: float, colour: str, opacity: float) -> str:
    """Return a sector of a circle between two angles, in degrees clockwise from straight up."""
    ends = [(x + radius * math.sin(math.radians(a)), y - radius * math.cos(math.radians(a))) for a in (first, last)]
    (x1, y1), (x2, y2) = ends
    large = int(last - first > 180)
    path = f"M{x:.1f} {y:.1f}L{x1:.1f} {y1:.1f}A{radius:g} {radius:g} 0 {large} 1 {x2:.1f} {y2:.1f}Z"
    return f'<path d="{path}" fill="{colour}" fill-opacity="{opacity:g}"/>'


def draw_covered_share() -> str:
    """Return the panel about nearer boxes."""
    parts = [text(0, 0, "Covered share of box A", "title")]
    parts += ['<rect x="100" y="90" width="50" height="100" fill="url(#hatch)"/>']
    parts += [box(60, 40, 90, 150, INK), box(100, 90, 110, 130, NEARER)]
    parts += [text(66, 60, "A"), text(190, 110, "B")]
    parts += [line(20, 190, 250, 190, GREY, dash="4 4"), line(20, 220, 250, 220, GREY, dash="4 4")]
    parts += [text(256, 194, "bottom of A", "small"), text(256, 224, "bottom of B, more than", "small")]
    parts += [text(256, 239, "2 px lower: B is nearer", "small")]
    share = 50 * 100 / (90 * 150)
    verdict = "less than" if share < LOAD.max_covered else "not less than"
    parts += [text(0, 270, f"hatched area / area of A = {share:.2f},")]
    parts += [text(0, 288, f"{verdict} {LOAD.max_covered:g}: nearer boxes leave A in clear view.")]
    parts += [text(0, 306, f"From {LOAD.min_covered:g} on A would be covered, between the two uncertain.")]
    return "".join(parts)


def draw_sector() -> str:
    """Return the panel about directions around the robot."""
    x, y, radius = 150, 150, 110
    limit, edge = LOAD.sector_true_deg, LOAD.sector_false_deg
    parts = [text(0, 0, "“Ahead of the robot”", "title")]
    parts += [wedge(x, y, radius, -edge, -limit, UNKNOWN, 0.35), wedge(x, y, radius, limit, edge, UNKNOWN, 0.35)]
    parts += [wedge(x, y, radius, -limit, limit, TRUE, 0.45), wedge(x, y, radius, edge, 360 - edge, GREY, 0.12)]
    parts += [box(x - 12, y - 12, 24, 24, INK, "#fff"), text(x, y + 32, "robot", "small", "middle")]
    parts += [text(x, 70, "true", anchor="middle"), text(x - 72, 116, "unknown", anchor="middle")]
    parts += [text(x + 72, 116, "unknown", anchor="middle"), text(x, y + 75, "false", anchor="middle")]
    parts += [text(x + 76, 52, f"{limit:g}°", "small"), text(x + radius + 4, y + 4, f"{edge:g}°", "small")]
    parts += [text(0, 288, "A person in the unknown part can neither be")]
    parts += [text(0, 306, "described as “ahead” nor be told apart by it.")]
    return "".join(parts)


def draw_hops() -> str:
    """Return the panel about a question with two hops."""
    parts = [text(0, 0, "Two hops: anchor A, then B, then C", "title")]
    parts += [person(50, 110, "A"), person(180, 60, "B"), person(300, 130, "C", TRUE), person(170, 190, "D", GREY)]
    parts += [line(65, 103, 162, 67, arrow=True), line(194, 67, 283, 120, arrow=True)]
    parts += [text(20, 60, "the only seated"), text(20, 77, "woman")]
    parts += [text(78, 120, "talks with", "small"), text(262, 42, "the first person", "small")]
    parts += [text(262, 58, "to B's right, as the", "small"), text(262, 74, "robot sees it, at", "small")]
    parts += [text(262, 90, f"most {LOAD.neighbor_max_deg:g}° away", "small")]
    parts += [text(196, 195, "fits no relation", "small")]
    parts += [text(0, 252, "hop.stop: read B, or A, instead of C")]
    parts += [text(0, 270, "hop.skip: go from A straight to A's right")]
    parts += [text(0, 288, "Each must give another answer, fit several")]
    parts += [text(0, 306, "people, or fit nobody.")]
    return "".join(parts)


def draw_shift() -> str:
    """Return the panel about the shift of a time."""
    shift, scale, start = RULES.shift_s, 22.0, 20.0
    asked = 8.0
    parts = [text(0, 0, "Shift of the time asked", "title")]
    labels = [(0.0, 6.5, "standing", "#e2e8f0"), (6.5, 9.5, "walking", "#9ae6b4"), (9.5, 14.0, "sitting", "#e2e8f0")]
    for first, last, label, fill in labels:
        parts += [box(start + first * scale, 110, (last - first) * scale, 34, INK, fill)]
        parts += [text(start + (first + last) / 2 * scale, 132, label, anchor="middle")]
    for time, name, colour in (
        (asked - shift, f"t1 − {shift:g} s", NEARER),
        (asked, "t1", TRUE),
        (asked + shift, f"t1 + {shift:g} s", NEARER),
    ):
        at = start + time * scale
        parts += [line(at, 66, at, 106, colour, arrow=True), text(at, 56, name, anchor="middle")]
    parts += [line(start, 180, start + 14 * scale, 180, GREY, arrow=True), text(start, 200, "time", "small")]
    parts += [text(0, 252, "The person walks at t1, and certainly does not")]
    parts += [text(0, 270, f"{shift:g} seconds before and after. One of the two is")]
    parts += [text(0, 288, "enough: so the answer depends on the time that")]
    parts += [text(0, 306, "the question states.")]
    return "".join(parts)


def draw() -> str:
    """Return the whole picture as SVG."""
    panels = [draw_covered_share(), draw_sector(), draw_hops(), draw_shift()]
    placed = [
        f'<g transform="translate({30 + 430 * (number % 2)} {40 + 350 * (number // 2)})">{panel}</g>'
        for number, panel in enumerate(panels)
    ]
    arrow = '<marker id="arrow" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="6" markerHeight="6" orient="auto">'
    hatch = '<pattern id="hatch" width="7" height="7" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">'
    return "\n".join(
        [
            '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 860 720" role="img" aria-labelledby="t">',
            '<title id="t">Covered share, sectors, hops and the shift of a time</title>',
            f"<style>{STYLE}</style><defs>{arrow}<path d='M0 0L8 4L0 8Z'/></marker>",
            f"{hatch}<rect width='3' height='7' fill='{NEARER}' fill-opacity='0.5'/></pattern></defs>",
            '<rect width="860" height="720" fill="#fff"/>',
            *placed,
            "</svg>",
        ]
    )


if __name__ == "__main__":
    sys.stdout.write(draw() + "\n")
