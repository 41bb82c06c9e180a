"""Small worlds written as text: what generation must give, refuse (and by which rule), and never consider."""

import json
import re
from collections import Counter

import pytest
from environment import TESTS
from keyframe_layers import ANY_VIEW as RULES
from keyframe_layers import all_proofs, forms_in, make_prover, proposals, search_one, searched
from loaded_stores import memory_store
from oracle_candidates import People
from random_worlds import SEQUENCE, build
from worlds import write_root

from jrdb_avr.engine.generate.describe import describe
from jrdb_avr.schema.relations import FIRST_LEFT, FIRST_RIGHT, SAME_GROUP
from jrdb_avr.schema.templates import TEMPLATES

LETTERS = {FIRST_LEFT: "L", FIRST_RIGHT: "R", SAME_GROUP: "G", "conversation": "C"}
LETTERS |= {
    f"within {n} degrees to the {side} of (robot view)": f"{side[0].upper()}{n}"
    for side in ("left", "right")
    for n in (30, 45, 60, 90)
}


def read_worlds(file):
    """{title: lines} of a fixture file."""
    worlds, title = {}, None
    for line in (TESTS / "fixtures" / file).read_text().splitlines():
        if line.startswith("== "):
            title = line[3:]
            assert title not in worlds
            worlds[title] = []
        elif line.strip() and not line.startswith("#"):
            worlds[title].append(line)
    return worlds


def judge(store, claimed):
    """({(template, track, seconds, action): {answer: rule or None}}, {(track, second): description}).

    Only that is looked at which the world claims something of: {name of a template: tracks of its targets}.
    """
    found, described = {}, {}
    with searched(store, SEQUENCE, RULES) as search:
        prover = make_prover(search)
        for template in forms_in(store, SEQUENCE):
            for one in proposals(search, template) if template.query in claimed else ():
                if one.target not in claimed[template.query]:
                    continue
                when = tuple(one.frames[name] // 15 for name in template.stated)
                rule = None if prover.prove(one) is not None else refusal(search, one, prover)
                place = (
                    template.query,
                    one.target,
                    when,
                    walk(one) if template.edges else None,
                    named(one, search.segments),
                )
                # Two descriptions may lead to one question; what one of them proves is proven.
                rules = found.setdefault(place, {})
                rules[answer_of(one)] = rule and rules.get(answer_of(one), rule)
        facts = search.facts
        for frame, people in facts.people.items():
            for who in people:
                for conditions, general in describe(facts, SEQUENCE, who, frame, RULES).items():
                    if general:
                        words = (c.action or c.interaction or c.value for c in conditions)
                        described[who, frame // 15] = ", ".join(map(str, words))
    return found, described


def kept(store):
    """{(template, target): questions} without near-duplicates and those above the cap."""
    _, candidates = search_one(store, SEQUENCE, RULES)
    return Counter((one.template, one.track) for one in candidates)


def refusal(search, one, prover):
    """The rule that refused a proposal, with what those of its perturbed programs answer that prove nothing."""
    (rule,) = prover.counts
    prover.counts.clear()
    if rule.partition(".")[0] not in ("hop", "time") or rule == "time.drop":
        return rule
    failed = [proof for proof in all_proofs(search, one) if proof.kind == rule and not proof.holds]
    return f"{rule} {', '.join(' '.join((proof.variant.removesuffix(' s'), proof.outcome)) for proof in failed)}"


def answer_of(one):
    """A proposal's answer as the fixture writes it."""
    if one.template.answer is None:
        return one.answer
    if one.template.spec.mode == "number":
        return f"{json.loads(one.answer)['value']:g}"
    return " ".join(str(frame) for frame in one.read)


def named(one, segments):
    """The actions whose start is asked for, or the relation of those counted."""
    if one.template.counts:
        return one.relations[0]
    if one.template.answer is None or not one.segments:
        return None
    return " then ".join(segment["action"] for segment in one.segments)


def walk(one):
    """The people of a proposal with the letters of relations between them: "1 L 2 G 3", "1 L 2 L60 4, 1 G 3 G 4"."""
    edges = dict(zip(one.template.edges, one.relations, strict=True))
    roads = []
    for edge in [edge for edge in edges if edge[0] == "a"]:
        words = [one.people["a"]]
        while edge is not None:
            words += [LETTERS.get(edges[edge], edges[edge]), one.people[edge[1]]]
            edge = next((other for other in edges if other[0] == edge[1]), None)
        roads.append(" ".join(map(str, words)))
    return ", ".join(roads)


def is_true(verb, value, rules):
    """Whether a claim agrees with the rules that refuse a question with each answer."""
    if verb == "gives":
        return rules.get(value, "not proposed") is None
    # A generator does not propose what its own row refuses.
    return not rules or (verb == "refuses" and None not in rules.values() and value in rules.values())


CLAIM = re.compile(
    r"(gives|refuses|lacks) (\w+) (\d+) at ([\d ]+?)(?: by (\d[\d LRGC,]*\d))?(?: ([a-z][a-z ]*))?(?:: (.+))?"
)


WORLDS, WORDS = read_worlds("questions.txt"), read_worlds("words.txt")


@pytest.mark.parametrize("title", WORDS)
def test_the_oracle_describes_as_the_worlds_of_words_say(title, tmp_path):
    oracle = People(write_root(tmp_path, build(WORDS[title])), SEQUENCE, judged=False)
    for line in WORDS[title]:
        if match := re.fullmatch(r"describes (\d+) at (\d+): (.+)", line):
            conditions = oracle.description(15 * int(match[2]), int(match[1])) or [(None, "nothing")]
            assert ", ".join(str(value) for _, value in conditions) == match[3], line


@pytest.mark.parametrize("title", WORLDS | WORDS)
def test_world(title, tmp_path):
    lines = (WORLDS | WORDS)[title]
    store = memory_store(tmp_path, build(lines), visibility="any")
    claimed = {}
    for match in filter(None, map(CLAIM.fullmatch, lines)):
        claimed.setdefault(match[2], []).append(int(match[3]))
    assert claimed.keys() <= {template.query for template in TEMPLATES.values()}
    found, described = judge(store, claimed)
    claims = 0
    if any(line.startswith("keeps ") for line in lines):
        questions = kept(store)
    for line in lines:
        if re.match(r"\d+ \||images |lost ", line):
            continue
        claims += 1
        if match := re.fullmatch(r"describes (\d+) at (\d+): (.+)", line):
            assert described.get((int(match[1]), int(match[2])), "nothing") == match[3], line
            continue
        if match := re.fullmatch(r"keeps (\d+) of (\w+) (\d+)", line):
            assert questions[match[2], int(match[3])] == int(match[1]), line
            continue
        match = CLAIM.fullmatch(line)
        assert match, f"cannot read: {line}"
        verb, template, track, when, path, action, value = match.groups()
        place = (template, int(track), tuple(map(int, when.split())), path, action)
        assert is_true(verb, value, found.get(place, {})), (line, found.get(place))
    assert claims
