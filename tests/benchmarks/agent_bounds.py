"""Figures of the reference agent's benchmark: shares with paired differences, and the bounds that they should meet.

Differences are paired by question, and the noise seeds averaged within a question; intervals are bootstrap ones at 95 %
over questions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from jrdb_avr.engine.report.bootstrap import Interval, intervals, mean_ratio
from jrdb_avr.engine.report.directions import direction_lines
from jrdb_avr.engine.report.paper import ABLATION
from jrdb_avr.engine.run.methods import default_policy

SCORES: Final = ("answer", "evidence", "combined")

AGENT, CONTROL = "agent", "agent-no-world"
NO_WORLD, REACT = "agent-no-world model", "react"
PASSIVE, PASSIVE_NO_WORLD = "agent-passive", "agent-passive-no-world"


@dataclass(frozen=True)
class Measured:
    """What one method did in one setting, over all its noise seeds.

    scores: by question, shares of answer, evidence and combined; the other pairs are counts, (part, whole) each.
    pairs: pairs of readings that are rightly of one person, that are taken for one, and that are of one.
    """

    scores: Mapping[str, tuple[float, float, float]]
    certain: tuple[int, int]
    choices: tuple[int, int]
    calls: float
    tokens: float
    pairs: tuple[int, int, int] | None = None

    def share(self, name: str) -> float:
        """The share of one score."""
        place = SCORES.index(name)
        return float(np.mean([own[place] for own in self.scores.values()]))

    @property
    def hallucination(self) -> float:
        """The hallucination rate: the share of right answers whose box is wrong; NaN where no answer is right."""
        answer = self.share("answer")
        return 1 - self.share("combined") / answer if answer else float("nan")

    @property
    def f1(self) -> float | None:
        """F1 of association, over pairs of readings."""
        return 2 * self.pairs[0] / max(self.pairs[1] + self.pairs[2], 1) if self.pairs else None


Cells = Mapping[tuple[str, str], Measured]
"""Measured by setting and method."""

Kind = Literal["not below", "above by", "at most half", "certain", "answered"]


@dataclass(frozen=True)
class Bound:
    """One line of what the agent should show.

    kind: of the paired difference to `other`, that its interval holds 0 or lies above, or that it is at least `least`
    with an interval above 0; that hallucination is at most half of the other's; or that a share of the method's own is
    at least `least`.
    """

    setting: str
    method: str
    kind: Kind
    other: str = ""
    score: str = "combined"
    least: float = 0.0


BOUNDS: Final = (
    *(Bound("perfect", AGENT, "not below", other, score) for other in (NO_WORLD, REACT) for score in SCORES),
    *(Bound("noise-0.1", AGENT, "above by", other, least=0.10) for other in (NO_WORLD, REACT)),
    *(Bound("noise-0.1", AGENT, "not below", other, "answer") for other in (NO_WORLD, REACT)),
    *(Bound("noise-0.1", AGENT, "at most half", other, "hallucination") for other in (NO_WORLD, REACT)),
    *(Bound("correlated", AGENT, "above by", other, least=0.08) for other in (NO_WORLD, REACT)),
    Bound("noise-0.1", AGENT, "above by", CONTROL, least=0.08),
    *(
        Bound(setting, PASSIVE, "not below", PASSIVE_NO_WORLD, score)
        for setting in ("perfect", "noise-0.1")
        for score in SCORES
    ),
    *(Bound(setting, PASSIVE, "answered", score="choices", least=0.95) for setting in ("perfect", "noise-0.1")),
    Bound("noise-0.1", AGENT, "certain", least=0.90),
    *(Bound("ids-off", AGENT, "not below", other) for other in (NO_WORLD, CONTROL)),
)


def differences(one: Measured, other: Measured) -> dict[str, Interval]:
    """Paired differences of the scores; under "hallucination" that to half of the other's."""
    both = [name for name in one.scores if name in other.scores]
    ours, theirs = (np.array([own.scores[name] for name in both]) for own in (one, other))
    count = np.ones((len(both), 1))
    found = intervals(np.hstack([ours - theirs, count]), [mean_ratio((column, 3)) for column in range(3)])
    # Right answers with wrong evidence, and right answers.
    columns = np.stack([ours[:, 0] - ours[:, 2], ours[:, 0], theirs[:, 0] - theirs[:, 2], theirs[:, 0]], axis=1)
    half = intervals(columns, [lambda totals: mean_ratio((0, 1))(totals) - mean_ratio((2, 3))(totals) / 2])
    return dict(zip((*SCORES, "hallucination"), [*found, *half], strict=True))


def judge(bound: Bound, cells: Cells) -> tuple[str, bool] | None:
    """The measured value in words, and whether the bound holds; None where a method was not measured."""
    one, other = cells.get((bound.setting, bound.method)), cells.get((bound.setting, bound.other))
    if one is None or (bound.other and other is None):
        return None
    if other is None:
        part, whole = one.certain if bound.kind == "certain" else one.choices
        return f"{100 * part / max(whole, 1):.1f} % ({part} of {whole})", part >= bound.least * max(whole, 1)
    value = differences(one, other)[bound.score]
    if value.value is None or value.low is None or value.high is None:
        return "undefined", False
    words = f"{100 * value.value:+.1f} [{100 * value.low:+.1f}, {100 * value.high:+.1f}]"
    if bound.kind == "above by":
        return words, value.value >= bound.least and value.low > 0
    return words, value.value <= 0 if bound.kind == "at most half" else value.high >= 0


def print_figures(cells: Cells) -> None:
    """Print a line for each method and setting."""
    print(
        f"{'setting':<11}{'method':<24}{'n':>5}{'answer':>8}{'evid.':>7}{'comb.':>7}{'hall.':>7}"
        f"{'certain: comb.':>16}{'choices':>9}{'calls':>7}{'tokens':>8}{'F1':>7}"
    )
    for (setting, method), own in cells.items():
        right, certain = own.certain
        answered, choices = own.choices
        shares = "".join(f"{100 * own.share(name):>{width}.1f}" for name, width in zip(SCORES, (8, 7, 7), strict=True))
        print(
            f"{setting:<11}{method:<24}{len(own.scores):>5}{shares}{100 * own.hallucination:>7.1f}"
            f"{f'{100 * right / certain:.0f} % of {certain}' if certain else '':>16}"
            f"{100 * answered / max(choices, 1):>8.1f}%{own.calls:>7.1f}{own.tokens:>8.0f}"
            f"{'' if own.f1 is None else f'{own.f1:.3f}':>7}"
        )


def print_bounds(cells: Cells) -> None:
    """Print each bound that was measured, the value, and whether it holds."""
    words = {"above by": "at least {:+.0f}, interval above 0", "not below": "interval holds 0 or lies above"}
    words |= {"at most half": "less half of the other's: at most 0", "answered": "at least {:.0f} % answered"}
    words |= {"certain": "at least {:.0f} % where certain"}
    for bound in BOUNDS:
        found = judge(bound, cells)
        if found is None:
            continue
        what = f"{bound.method}{f' - {bound.other}' if bound.other else ''}, {bound.score}"
        value, verdict = found[0], "holds" if found[1] else "DOES NOT HOLD"
        print(f"{bound.setting:<11}{what:<58}{words[bound.kind].format(100 * bound.least):<38}{value:<24}{verdict}")


def print_ablation(cells: Cells, setting: str) -> None:
    """Print active observation by world model by policy beside the paper's figures, and which directions agree."""
    rows = []
    print(f"{setting}, synthetic: answer / evidence / combined / hallucination; the paper's")
    for (_, method), own in ((cell, own) for cell, own in cells.items() if cell[0] == setting):
        name, _, policy = method.partition(" ")
        if name not in ABLATION:
            continue
        shares = {score: 100 * own.share(score) for score in SCORES} | {"hallucination": 100 * own.hallucination}
        paper = ABLATION[name]
        row = {"active": "off" if "passive" in name else "on", "world_model": "off" if "no-world" in name else "on"}
        row |= {"policy": policy or default_policy(name), "model": setting, "setting": "", "label": "synthetic"}
        rows.append(row | shares)
        print(
            f"{method:<24}{' / '.join(f'{value:.1f}' for value in shares.values()):<28}"
            f"{paper.answer:.1f} / {paper.evidence:.1f} / {paper.combined:.1f} / {paper.hallucination:.1f}"
        )
    for line in direction_lines(rows):
        print(line)
