"""Selection with choices: its cost from scratch, its bounds, and independence of the order of the input."""

import hashlib
from collections import Counter
from fractions import Fraction
from itertools import permutations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jrdb_avr.engine.generate import levelling
from jrdb_avr.engine.generate.asked import (
    Candidate,
    Question,
    answer_contexts,
    choice_contexts,
    moment_hash,
    offer_of,
    sequence_cap,
)
from jrdb_avr.engine.generate.choices import wrong_sets
from jrdb_avr.engine.generate.guessers import LabelCounts, guesser_shares
from jrdb_avr.engine.generate.levelling import find_twins, level_choices, make_selector, may_be_twins, select_level
from jrdb_avr.engine.generate.levels import Level
from jrdb_avr.engine.generate.near_duplicates import Taken
from jrdb_avr.engine.generate.selection import PROFILES, quota_of, select
from jrdb_avr.engine.report.hashes import hash_of
from jrdb_avr.schema.choice_labels import may_be_same
from jrdb_avr.schema.labels import PRESENCE_ANSWERS
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import FAMILIES

LABELS = ("walking", "standing", "sitting", "skating", "eating sth", "talking to someone", "holding sth")
SEQUENCES = ("s0", "s1", "s2")


def pick(values, *parts):
    return values[hash_of(*parts) % len(values)]


def candidate(number, template="change", asked=None, truth=None, described=None):
    sequence, track = pick(SEQUENCES, "s", number), hash_of("p", number) % 9
    truth = truth or pick(LABELS, "t", number)
    wrong = frozenset(x for x in LABELS if not may_be_same(x, truth) and hash_of(number, x) % 8)
    asked = asked or (60 + 45 * (hash_of("k", number) % 8),)
    contexts = choice_contexts(sequence, [pick(("tall", "male"), number)], pick((None, "left"), number), asked[-1])
    key = hashlib.sha256(str(number).encode()).hexdigest()
    return Candidate(key, template, sequence, track, described or str(number), asked, truth, wrong, contexts)


NUMBERS = {
    (sequence, frame): {x: hash_of(sequence, frame, x) % 4 for x in LABELS}
    for sequence in SEQUENCES
    for frame in range(60, 500, 45)
}
COUNTS = LabelCounts(NUMBERS)


def cost_from_scratch(questions):
    """The formula of the selection, read word by word."""
    shares = lambda one: {one.candidate.truth: -3, **dict.fromkeys(one.wrong, 1)}  # noqa: E731
    x, p, r, weights = Counter(), Counter(), Counter(), {}
    people, sequences, doing = Counter(), Counter(), 0
    for one in questions:
        at = one.candidate
        for name, weight in at.contexts:
            weights[name] = weight
            for label, share in shares(one).items():
                x[name, label] += share
        for label, other in permutations(shares(one), 2):
            p[label, other] += shares(one)[label]
        for ranking, rank in enumerate(COUNTS.ranks(at.sequence, at.asked[-1], at.truth, one.wrong)):
            r[ranking, rank] += 1
        people[at.sequence, at.track] += 1
        sequences[at.sequence] += 1
        doing += len(COUNTS.doing(at.sequence, at.asked[-1]) & set(one.wrong))
    n = len(questions)
    return (
        sum(weights[name] * number**2 for (name, _), number in x.items())
        + 20 * sum(number**2 for number in p.values())
        + sum(w * (4 * r[g, rank] - n) ** 2 for g, w in enumerate((3, 4, 4)) for rank in range(4))
        + sum(60 * m * (m - 1) // 2 for m in people.values())
        + sum(3 * m * (m - 1) // 2 for m in sequences.values())
        - 10 * doing
    )


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 1000)), max_size=12, unique_by=lambda one: one[0]))
@settings(deadline=None)
def test_the_increase_of_the_cost_is_that_of_the_cost_from_scratch(drawn):
    questions = []
    for number, choice in drawn:
        one = candidate(number)
        if triples := wrong_sets(one.wrong):
            questions.append(Question(one, triples[choice % len(triples)]))
    level = Level([one.candidate for one in questions], COUNTS)
    for place, question in enumerate(questions):
        before = cost_from_scratch(questions[:place])
        assert level.costs_of([question])[0] == cost_from_scratch(questions[: place + 1]) - before
        options = [Question(question.candidate, wrong) for wrong in wrong_sets(question.candidate.wrong)]
        cost, best = level.cheapest([question.candidate])
        assert cost + before == min(cost_from_scratch([*questions[:place], option]) for option in options)
        assert cost + before == cost_from_scratch([*questions[:place], best])
        level.add(question)
    # What is removed leaves no trace.
    for place in range(len(questions) - 1, -1, -1):
        level.add(questions[place], -1)
        before = cost_from_scratch(questions[:place])
        assert level.costs_of([questions[place]])[0] == cost_from_scratch(questions[: place + 1]) - before


def selected(candidates, quota=30):
    cap = sequence_cap("change", quota, len(SEQUENCES))
    return select_level(candidates, quota, COUNTS, Taken(Rules()), cap)[0]


def test_selection_depends_on_the_candidates_and_not_on_their_order():
    pool = [candidate(number) for number in range(150)]
    pool += [one for n in range(20, 23) for one in (twin(n, 60, "walking"), twin(n, 150, "sitting"))]
    assert find_twins(pool, Rules()) == find_twins(pool[::-1], Rules())
    questions = selected(pool)
    assert questions == selected(pool[::-1])
    choices = {}
    for one in questions:
        choices.setdefault(one.twin, []).append(one.choices)
    choices.pop(None)
    # Their choices are in the same order.
    assert len(choices) >= 3 and all(first == second for first, second in choices.values())
    assert level_choices(pool, COUNTS, Rules()) == level_choices(pool[::-1], COUNTS, Rules())


def shares_from_scratch(questions):
    """The right answers of the five guessers that bound the size of a template, read word by word."""
    data, within = Counter(), {sequence: Counter() for sequence in SEQUENCES}
    for (sequence, _), numbers in NUMBERS.items():
        data.update(numbers)
        within[sequence].update(numbers)

    def common(label, *counts):
        return *(some[label] for some in counts), [-ord(letter) for letter in label]

    def true_elsewhere(one, label, *beside):
        """How often a choice is true in other sequences, with ever more of the other choices beside it."""
        belief = Fraction(1, 4)
        for others in (set(), *beside):
            alike = [q for q in questions if q.candidate.sequence != one.candidate.sequence]
            alike = [q for q in alike if {label, *others} <= set(q.choices)]
            belief = (sum(q.candidate.truth == label for q in alike) + 4 * belief) / (len(alike) + 4)
        return belief

    guessers = {
        "data": lambda one, x: common(x, data),
        "sequence": lambda one, x: common(x, within[one.candidate.sequence], data),
        "label": true_elsewhere,
        "set": lambda one, x: true_elsewhere(one, x, set(one.choices)),
        "pair": lambda one, x: true_elsewhere(one, x, *({y} for y in sorted(one.choices) if y != x)),
    }
    right = dict.fromkeys(guessers, Fraction())
    for name, value in guessers.items():
        for one in questions:
            values = {x: value(one, x) for x in one.choices}
            best = [x for x in values if values[x] == max(values.values())]
            right[name] += Fraction(one.candidate.truth in best, len(best) * len(questions))
    return right


def test_selection_levels_choices_under_its_caps():
    pool = [candidate(number) for number in range(400)]
    questions = selected(pool, quota=60)
    assert len(questions) == 60
    arbitrary = [Question(x, wrong_sets(x.wrong)[0]) for x in pool[:60] if wrong_sets(x.wrong)]
    for some, most in ((questions, Fraction(34, 100)), (arbitrary, 1)):
        shares = shares_from_scratch(some)
        assert shares == {name: guesser_shares([offer_of(one, COUNTS) for one in some])[name] for name in shares}
        assert max(shares.values()) <= most
    # Without levelling most of the guessers would be above the bound.
    assert sum(share > Fraction(34, 100) for share in shares.values()) >= 3
    assert len({moment_hash(one.candidate) for one in questions}) == len(questions)
    of_sequence = Counter(one.candidate.sequence for one in questions)
    assert max(of_sequence.values()) <= sequence_cap("change", 60, 3) == 30
    for one in questions:
        assert one.candidate.truth in one.choices
        assert set(one.choices) - {one.candidate.truth} == set(one.wrong) <= one.candidate.wrong
    assert cost_from_scratch(questions) < cost_from_scratch(arbitrary) // 4


def twin(number, frame, truth):
    return candidate(1, asked=(frame,), truth=truth)._replace(
        key=hashlib.sha256(f"twin {number} {frame}".encode()).hexdigest(),
        wrong=frozenset(LABELS) - {truth},
        track=number,
    )


def test_twins_share_four_choices_and_differ_in_one_time_and_their_answers():
    rules = Rules()
    first, second = twin(1, 60, "walking"), twin(1, 105, "sitting")
    assert may_be_twins(first, second, rules)
    assert not may_be_twins(first, second._replace(asked=(90,)), rules)
    assert not may_be_twins(first, second._replace(wrong=frozenset({"standing", "skating"})), rules)
    assert not may_be_twins(first, second._replace(truth="walking"), rules)
    first, second = (one._replace(template="presence") for one in (first, second))
    for asked, twins in (((60, 276), True), ((136, 200), True), ((60, 275), False), ((136, 276), False)):
        assert may_be_twins(first._replace(asked=(60, 200)), second._replace(asked=asked), rules) == twins


def presence(number):
    sequence = pick(SEQUENCES, "s", number)
    t1 = 60 + hash_of("1", number) % 300
    asked = (t1, t1 + 45 + hash_of("2", number) % 300)
    answers = PRESENCE_ANSWERS + PRESENCE_ANSWERS[:1] * 3
    truth = pick(answers, "a", number)
    key = hashlib.sha256(str(number).encode()).hexdigest()
    contexts = answer_contexts(sequence, 900, 0, asked, [pick(("tall", "male"), number)])
    wrong = frozenset(PRESENCE_ANSWERS) - {truth}
    track = hash_of("d", number) % 9
    return Candidate(key, "presence", sequence, track, f"person {track}", asked, truth, wrong, contexts)


def test_fixed_answers_are_level_although_one_is_four_times_as_frequent():
    pool = [presence(number) for number in range(1500)]
    cap = sequence_cap("presence", 120, len(SEQUENCES))
    questions = select_level(pool, 120, COUNTS, Taken(Rules()), cap)[0]
    assert questions == select_level(pool[::-1], 120, COUNTS, Taken(Rules()), cap)[0]
    answers = Counter(one.candidate.truth for one in questions)
    assert 100 * max(answers.values()) <= 31 * len(questions)
    assert len(questions) > 100
    described = Counter((one.candidate.sequence, one.candidate.described) for one in questions)
    assert max(described.values()) <= 4
    assert max(Counter(one.candidate.sequence for one in questions).values()) <= sequence_cap("presence", 120, 3)


@pytest.mark.parametrize(
    ("reached", "distance", "presence"), [({"change": 300}, 660, 660), ({"change": 351}, 634, 635), ({}, 810, 810)]
)
def test_presence_takes_what_change_and_distance_leave(reached, distance, presence):
    quotas = PROFILES["paper"]
    assert quota_of("change", quotas, {}) == 350
    assert quota_of("distance", quotas, reached) == distance
    assert quota_of("presence", quotas, reached | {"distance": distance}) == presence
    assert quota_of("two_hop", quotas, reached) == 76


def test_later_action_takes_what_counts_and_consequences_leave_of_the_long_waits():
    quotas = PROFILES["paper"]
    assert quota_of("consequence", quotas, {"gap": 10}) == 10
    assert quota_of("later_action", quotas, {"gap": 7, "consequence": 1, "two_hop": 76}) == 22


def test_a_mix_reports_each_template_and_keeps_the_caps_of_people_in_all():
    pool = {
        "two_hop": [candidate(number, "two_hop") for number in range(80)],
        "change": [candidate(number) for number in range(80, 200)],
        "presence": [presence(number) for number in range(300)],
    }
    questions, rows = select(pool, COUNTS, Rules(), "paper")
    by_template = Counter(one.candidate.template for one in questions)
    assert [row["template"] for row in rows] == list(FAMILIES)
    assert by_template == {row["template"]: row["reached"] for row in rows if row["reached"]}
    assert all(row["shortage"] or row["reached"] == row["quota"] for row in rows if row["quota"])
    people = Counter((one.candidate.sequence, one.candidate.track) for one in questions)
    assert max(people.values()) <= Rules().max_per_person_in_all


@pytest.mark.parametrize("n", [None, 41])
def test_a_profile_without_quotas_keeps_near_duplicates_apart_and_lets_templates_take_turns(n):
    pool = {"two_hop": [candidate(number, "two_hop") for number in range(80)], "presence": [presence(5), presence(6)]}
    pool["start"] = [one._replace(template="start", wrong=frozenset(), contexts=()) for one in pool["two_hop"]]
    questions, rows = select(pool, COUNTS, Rules(), "train", n)
    assert n is None or len(questions) <= n
    taken = Taken(Rules())
    for one in questions:
        assert taken.admits(one.candidate)
        taken.add(one.candidate)
    by_template = Counter(one.candidate.template for one in questions)
    assert by_template["presence"] == 2 and by_template["two_hop"] > 5 < by_template["start"]
    assert all(row["quota"] is None and row["proven"] == len(pool.get(row["template"], ())) for row in rows)


@pytest.mark.parametrize("limit", [*range(0, 11), 50])
def test_as_many_twins_stay_as_the_bound_allows(limit, monkeypatch):
    pool = [one for n in range(20, 30) for one in (twin(n, 60, "walking"), twin(100 + n, 150, "sitting"))]
    pool = [one._replace(track=one.track % 100) for one in pool]
    selectors, made = [], make_selector

    def above_bound(offers):
        return "a guesser" if len(selectors[-1].pairs) > limit else None

    monkeypatch.setattr(levelling, "make_selector", lambda *rest: selectors.append(made(*rest)) or selectors[-1])
    monkeypatch.setattr(levelling, "above_bound", above_bound)
    questions = select_level(pool, 20, COUNTS, Taken(Rules()), 20)[0]
    assert sum(one.twin is not None for one in questions) == 2 * min(limit, 10)


@pytest.mark.parametrize(("quota", "cap", "paired"), [(10, 20, 10), (20, 7, 6)])
def test_twins_exceed_neither_the_size_of_a_template_nor_a_cap(quota, cap, paired):
    pairs = [(twin(n, 60, "walking"), twin(100 + n, 150, "sitting")._replace(track=n)) for n in range(20, 29)]
    pool = [one._replace(sequence="s0") for pair in pairs for one in pair]
    selector = make_selector(pool, COUNTS, Taken(Rules()), cap)
    selector.put_twins(find_twins(pool, Rules()), paired // 2 + quota // 20)
    assert len(selector.chosen) == 2 * len(selector.pairs) == paired
    questions = select_level(pool, quota, COUNTS, Taken(Rules()), cap)[0]
    assert len(questions) == min(quota, cap)
    assert [*Counter(one.twin for one in questions if one.twin).values()] == [2] * (paired // 2)


def test_the_quotas_are_the_numbers_of_the_paper():
    assert list(PROFILES["paper"].values()) == [67, 76, 222, 32, 51, 30, 1620]
    assert sum(PROFILES["paper"].values()) == 2098 and PROFILES["paper"].keys() == set(FAMILIES.values())


def test_starts_and_spans_fill_their_family_together():
    pool = {"start": [], "span": []}
    for number in range(60):
        name = "start" if number < 15 else "span"
        one = candidate(number, name)._replace(wrong=frozenset(), truth=str(number), contexts=((f"form {name}", 1),))
        pool[name].append(one._replace(track=number, event=f"start {number}"))
    questions, rows = select(pool, COUNTS, Rules(), "paper")
    reached = {row["template"]: row["reached"] for row in rows}
    assert reached["start"] == 15 and reached["span"] == min(45, 67 - 15)
    assert len(questions) == reached["start"] + reached["span"]
