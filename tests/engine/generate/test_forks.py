"""Fork-join in random small worlds: every candidate and the rule that refuses it, against brute force over the dicts.

Whom a description fits and where a single step leads is read from the graph, which others check; windows, groups,
joins and every proof are worked out here, person by person.
"""

import itertools
import random
from collections import Counter

import pytest
from keyframe_layers import searched
from loaded_stores import memory_store
from worlds import person

from jrdb_avr.engine.generate import fork_join
from jrdb_avr.engine.generate.candidates import PASSED, RULES, VALUES
from jrdb_avr.engine.generate.relations import RELATION_BITS, RELATIONS
from jrdb_avr.engine.generate.search import find_candidates
from jrdb_avr.queries.keyframes import SPAN
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import TEMPLATES

SEQUENCE = "yard-2020-01-01_0"
GROUP = "in the same group as"
WINDOWS = {
    f"within {n} degrees to the {s} of (robot view)": (n, s) for n in (30, 45, 60, 90) for s in ("left", "right")
}
BUSY = ("reading", "typing", "pushing", "eating sth", "writing")
"""What the first people do, so that there are descriptions without a pose."""
ANCHORS = """MATCH (n:Name)-[d:Describes]->(:Moment) WHERE n.id >= $low AND n.id < $high AND d.anchor
RETURN n.id - $low AS name ORDER BY name"""
STEPS = """MATCH (a:Moment)-[s:Step]->(b:Moment) WHERE a.id >= $low AND a.id < $high
RETURN a.frame / 15 AS t, a.track AS who, s.relation AS relation, b.track AS whom, b.nowhere AS nowhere
ORDER BY t, who, relation"""
OPEN = """MATCH (a:Moment) WHERE a.id >= $low AND a.id < $high AND a.open > 0
RETURN a.frame / 15 AS t, a.track AS who, a.open AS bits ORDER BY t, who"""
EMPTY, SEVERAL, UNKNOWN = "empty", "several", "unknown"
NO, YES, MAYBE = 0, 1, 2


def crowd(rng):
    """{second: {track: (column, pose or None, cluster or None, certain, height)}} of people who move a little."""
    people = {track: [rng.uniform(0, 3760), rng.choice("wts"), rng.choice((1, 2, 3))] for track in range(1, 9)}
    seconds = {}
    for second in range(9):
        seconds[second] = {}
        for track, state in people.items():
            state[0] = (state[0] + rng.uniform(-60, 60)) % 3760
            state[1] = rng.choice("wts") if rng.random() < 0.2 else state[1]
            state[2] = rng.choice((1, 2, 3, 4, 5)) if rng.random() < 0.1 else state[2]
            if rng.random() < 0.04:
                continue
            pose = state[1] if rng.random() < 0.95 else None
            cluster = state[2] if rng.random() < 0.97 else None
            height = 20 if rng.random() < 0.04 else 150
            seconds[second][track] = (round(state[0], 1), pose, cluster, rng.random() < 0.93, height)
    return seconds


def root_of(seconds):
    poses = {"w": {"walking": 1}, "t": {"standing": 1}, "s": {"sitting": 1}, None: {"standing": 3}}
    frames = {}
    for second, people in seconds.items():
        rows = frames.setdefault(15 * second, [])
        for track, (column, pose, cluster, certain, height) in people.items():
            group = None if cluster is None else (cluster, 1 if certain else 3)
            actions = poses[pose] | ({BUSY[track - 1]: 1} if track <= len(BUSY) else {})
            rows.append(person(track, (column - 25, 100, 50, height), actions, group))
    return {SEQUENCE: {"2d": frames}}


class Brute:
    """The program and its proofs, over the dicts."""

    def __init__(self, seconds, step, fits):
        self.seconds, self.step, self.fits = seconds, step, fits

    def fact(self, t, label, source, other):
        here, there = self.seconds[t][source], self.seconds[t][other]
        if label == GROUP:
            if here[2] is None or there[2] is None:
                return MAYBE
            return NO if here[2] != there[2] else YES if here[3] and there[3] else MAYBE
        degrees, side = WINDOWS[label]
        turn = (there[0] - here[0] if side == "right" else here[0] - there[0]) * 360 / 3760 % 360
        if turn <= 1 or turn >= 359 or abs(turn - degrees) <= 1:
            return MAYBE
        return YES if turn < degrees else NO

    def who(self, t, wanted, apart):
        """(those who could, those who certainly do) have all of these relations."""
        facts = {x: [self.fact(t, label, b, x) for label, b in wanted if x != b] for x in self.seconds[t]}
        facts = {x: has for x, has in facts.items() if x not in apart and len(has) == len(wanted)}
        return {x for x, has in facts.items() if NO not in has}, {x for x, has in facts.items() if set(has) == {YES}}

    def joined(self, t, wanted, apart):
        could, sure = self.who(t, wanted, apart)
        if len(could) == len(sure) == 1:
            return could.pop()
        return SEVERAL if len(sure) >= 2 else UNKNOWN if could else EMPTY

    def pose(self, t, who):
        """What is read of somebody, or why nothing is."""
        return (self.seconds[t][who][1] or UNKNOWN) if isinstance(who, int) else who

    def program(self, description, labels, t):
        """What the whole program reads at a second."""
        a = self.fits(description, t)
        if not isinstance(a, int):
            return a
        b, c = self.step(t, a, labels[0]), self.step(t, a, labels[1])
        if EMPTY in (b, c) or (b == c and isinstance(b, int)):
            return EMPTY
        for why in (SEVERAL, UNKNOWN):
            if why in (b, c):
                return why
        return self.pose(t, self.joined(t, ((labels[2], b), (labels[3], c)), {a, b, c}))

    def refused_by(self, description, labels, t, a, b, c, d):
        """The first rule after `stated` that refuses."""
        answer = self.pose(t, d)
        wrong = {self.pose(t, a)}
        if wrong & {answer, UNKNOWN} or {self.pose(t, b), self.pose(t, c)} <= {answer, UNKNOWN}:
            return "hop.stop"
        r3, r4 = labels[2:]
        skipped = {self.pose(t, self.joined(t, ((r3, a), (r4, c)), {a, c}))}
        skipped |= {self.pose(t, self.joined(t, ((r3, b), (r4, a)), {a, b}))}
        alone = [self.who(t, (one,), {a, b, c})[1] for one in ((r3, b), (r4, c))]
        if skipped & {answer, UNKNOWN} or min(map(len, alone)) < 2:
            return "hop.skip"
        moved = [self.program(description, labels, s) for s in (t - 3, t + 3) if s in self.seconds]
        if set(moved) <= {answer, UNKNOWN}:
            return "time.shift"
        read = [self.program(description, labels, s) for s in self.seconds if s != t]
        told = {pose for pose in read if pose in ("w", "t", "s")}
        return "time.drop" if told == {answer} else None

    def candidates(self, description, a, t, leading):
        for r1, r2 in itertools.permutations(sorted(leading), 2):
            b, c = self.step(t, a, r1), self.step(t, a, r2)
            if r1 > r2 or not isinstance(b, int) or not isinstance(c, int) or b == c:
                continue
            for r3, r4 in itertools.product((GROUP, *WINDOWS), repeat=2):
                d = self.joined(t, ((r3, b), (r4, c)), {a, b, c})
                counts = [len(self.who(t, (one,), {a, b, c})[0]) for one in ((r3, b), (r4, c))]
                if isinstance(d, int) and min(counts) >= 2 and self.pose(t, d) != UNKNOWN:
                    yield (r1, r2, r3, r4), b, c, d


def test_a_sum_of_bits_holds_every_relation():
    """One more than 63 relations would lose the last ones without a word."""
    assert [int(bits).bit_length() for bits in RELATION_BITS] == list(range(1, len(RELATIONS) + 1))
    assert 0 < int(RELATION_BITS.sum()) == 2 ** len(RELATIONS) - 1


def compare(seed, folder):
    """Check one world; returns how many candidates each rule refuses."""
    seconds = crowd(random.Random(seed))
    template = next(t for t in TEMPLATES.values() if t.name == "fork_join")
    with searched(memory_store(folder, root_of(seconds)), SEQUENCE, Rules()) as context:
        rows = find_candidates(context, template)
        ids = {"low": context.low, "high": context.low + SPAN}
        anchors, led, left = (context.graph.query(text, ids).to_pylist() for text in (ANCHORS, STEPS, OPEN))
    anchors, left = {row["name"] for row in anchors}, {(row["t"], row["who"]): row["bits"] for row in left}
    scene, names = context.scene, context.descriptions

    place_of = {label: place for place, label in enumerate(RELATIONS)}

    def track(moment):
        nowhere = {-1: EMPTY, -2: SEVERAL, -3: UNKNOWN}
        return nowhere.get(moment) or int(scene.tracks[moment // len(scene.keyframes)])

    def second(moment):
        return int(scene.keyframes[moment % len(scene.keyframes)]) // 15

    outcomes = {"empty": EMPTY, "ambiguous": SEVERAL, "unknown": UNKNOWN}
    leads = {(row["t"], row["who"], row["relation"]): row["whom"] or outcomes[row["nowhere"]] for row in led}

    def step(t, a, label):
        return leads.get((t, a, label)) or (UNKNOWN if left.get((t, a), 0) >> place_of[label] & 1 else EMPTY)

    number = names.texts[1]
    place = {int(frame) // 15: i for i, frame in enumerate(scene.keyframes)}
    brute = Brute(
        seconds,
        step,
        lambda description, t: track(int(names.fits[description, place[t]])),
    )
    leading = {label for _, _, label in leads}
    expected = {}
    for name in range(len(names.moment)):
        t, a = second(names.moment[name]), track(names.moment[name])
        if not names.general[name]:
            continue
        for labels, b, c, d in brute.candidates(number[name], a, t, leading):
            column, pose = seconds[t][d][0], {"w": "walking", "t": "standing", "s": "sitting"}[seconds[t][d][1]]
            if name not in anchors:
                rule = "anchor"
            elif min(seconds[t][who][4] for who in (a, b, c, d)) < 40:
                rule = "evidence"
            elif 1640 <= column <= 2120:
                rule = "view.ahead"
            elif any(condition.action == pose for condition in names.of(name)):
                rule = "stated"
            else:
                rule = brute.refused_by(number[name], labels, t, a, b, c, d)
            expected[name, *labels, b, c, d] = (rule, pose)
    found = {}
    for i in range(len(rows)):
        rule = None if rows.rule[i] == PASSED else RULES[rows.rule[i]]
        labels = [RELATIONS[rows.relations[r][i]] for r in template.relations]
        who = [track(int(rows.people[node][i])) for node in "bcd"]
        found[int(rows.name[i]), *labels, *who] = (rule, VALUES[rows.answer[i]])
    assert found == expected
    return Counter(rule for rule, _ in found.values())


@pytest.mark.parametrize("seeds", [(0, 1, 2, 156), pytest.param(range(3, 16), marks=pytest.mark.slow)])
def test_candidates_and_refusals_are_those_of_brute_force(tmp_path, seeds):
    counts = sum((compare(seed, tmp_path / str(seed)) for seed in seeds), Counter())
    assert {None, "evidence", "view.ahead", "hop.stop", "hop.skip", "time.shift", "time.drop"} <= set(counts)


def test_blocks_of_forks_give_what_all_together_give(tmp_path, monkeypatch):
    monkeypatch.setattr(fork_join, "_BLOCK", 5)
    assert compare(3, tmp_path).total() > 5
