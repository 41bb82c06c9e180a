"""Selection against plain Python: greedy pair by pair, counted answers, any order of the rows."""

import hashlib
import itertools
import random
from collections import Counter
from itertools import pairwise, product

import pyarrow as pa
import pytest
from environment import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from jrdb_avr.engine.generate.bins import answer_bin, wait_bin
from jrdb_avr.engine.generate.selection import PROFILES, select
from jrdb_avr.schema.plan import Condition, canonical
from jrdb_avr.schema.rules import Rules, training_rules
from jrdb_avr.schema.tables import QUESTIONS
from jrdb_avr.schema.templates import FAMILIES, TEMPLATES, Slots

RULES = Rules()

SCHEMA = pa.schema(
    [
        *(QUESTIONS["questions"].field(name) for name in ("sequence", "family", "template")),
        *(QUESTIONS["answers"].field(name) for name in ("target_track", "plan", "answer")),
        ("key", pa.string()),
        ("form", pa.string()),
        ("event", pa.string()),
        ("answer_text", pa.string()),
        ("read_frames", pa.list_(pa.int32())),
        ("stated", pa.list_(pa.string())),
        ("times", pa.list_(pa.int32())),
        ("sets", pa.list_(pa.string())),
        ("carried", pa.string()),
    ]
)

WORDS = ("walking", "typing")

PLANS = {
    name: canonical(row.build(Slots((Condition(action="sitting", at="t0"),), dict.fromkeys(row.stated, 0), WORDS)))
    for name, row in TEMPLATES.items()
    if not row.uses
}


def candidate(i, template, answer, *, sequence="s", track=None, read=(0,), form=None, event=None, **more):
    """A row of the pool; without a track it is of somebody of its own."""
    stated, times, key = (more.get(name, default) for name, default in (("stated", ()), ("times", (0,)), ("key", None)))
    return {
        "sequence": sequence,
        "family": FAMILIES[template],
        "template": template,
        "target_track": int(hashlib.sha256(str(i).encode()).hexdigest()[:7], 16) if track is None else track,
        "form": form or template,
        "event": event,
        "plan": PLANS[form or template],
        "answer": answer,
        "answer_text": answer,
        "key": key or hashlib.sha256(str(i).encode()).hexdigest(),
        "read_frames": list(read),
        "stated": list(stated),
        "times": list(times),
        "carried": f"row {i}",
    }


def table(rows):
    return pa.Table.from_pylist(rows, schema=SCHEMA)


def names(result):
    return [row["carried"] for row in result.to_pylist()]


CROWD = st.lists(
    st.tuples(
        st.sampled_from(["start", "span", "change", "presence"]),
        st.integers(0, 2),
        st.integers(0, 300),
        st.sampled_from("wxyz"),
        st.sampled_from(["start 1", "start 2"]),
    ),
    max_size=150,
)


def crowd(drawn):
    rows = []
    for i, (template, track, read, answer, event) in enumerate(drawn):
        timed = template in ("start", "span")
        text = {"start": f'{{"frame":{read}}}', "span": f'{{"start_frame":{read},"end_frame":{read + 60}}}'}
        more = {"event": event} if timed else {}
        frames = (read, read + 90) if template in ("span", "presence") else (read,)
        rows.append(candidate(i, template, text.get(template, answer), track=track, read=frames, **more))
    return rows


def alike(one, other):
    """Whether two questions are of one person, and of one event or, in a template, read at nearly the same times."""
    if one["target_track"] != other["target_track"]:
        return False
    if one["event"] and one["event"] == other["event"]:
        return True
    near = 75 if one["template"] == "presence" else 30
    times = zip(one["read_frames"], other["read_frames"], strict=False)
    return one["template"] == other["template"] and all(abs(x - y) <= near for x, y in times)


@given(CROWD, st.integers(1, 4), st.integers(1, 6), st.sampled_from(["all", "paper"]))
@settings(deadline=None)
def test_no_person_has_too_many_questions_nor_two_that_are_alike(drawn, cap, cap_in_all, profile):
    rules = Rules(max_per_person=cap, max_per_person_in_all=cap_in_all)
    kept = select(table(crowd(drawn)), rules, profile, 0).table.to_pylist()
    people = Counter(row["target_track"] for row in kept)
    assert max(people.values(), default=0) <= cap_in_all
    assert max(Counter((row["target_track"], row["template"]) for row in kept).values(), default=0) <= cap
    events = [(row["target_track"], row["event"]) for row in kept if row["event"]]
    assert len(events) == len(set(events))
    assert not any(alike(one, other) for one, other in itertools.combinations(kept, 2))


@given(CROWD, st.sampled_from([None, 2, 9, 60]))
@settings(deadline=None)
def test_a_training_set_leaves_out_only_what_is_alike(drawn, n):
    rows = crowd(drawn)
    kept = select(table(rows), training_rules(Rules(max_per_person=1)), "train", 0, n).table.to_pylist()
    assert not any(alike(one, other) for one, other in itertools.combinations(kept, 2))
    chosen = {row["carried"] for row in kept}
    left = [row for row in rows if row["carried"] not in chosen]
    assert len(kept) == n or all(any(alike(one, other) for other in kept) for one in left)
    assert n is None or len(kept) <= n


def test_a_training_set_takes_turns_over_templates_and_answers():
    rows = choices({"w": 60, "x": 20, "y": 20}, "change") + choices({"w": 60, "x": 4}, "presence")
    kept = select(table(rows), training_rules(Rules()), "train", 0, 60).table.to_pylist()
    counts = Counter((row["template"], row["answer"]) for row in kept)
    assert counts == {("change", answer): 10 for answer in "wxy"} | {("presence", "w"): 26, ("presence", "x"): 4}
    assert select(table(rows), training_rules(Rules()), "train", 0).table.num_rows == len(rows)


def test_a_person_is_in_no_more_questions_of_all_templates_than_the_cap():
    rows = [
        candidate(f"{template} {answer}", template, answer, track=1, read=(place * 200,))
        for template in ("change", "distance")
        for place, answer in enumerate("wxy")
    ]
    for cap, most in ((24, 6), (3, 3)):
        assert select(table(rows), Rules(max_per_person_in_all=cap), "all", 0).table.num_rows == most


def test_questions_that_are_near_at_one_time_only_are_both_chosen():
    reads = {"neither time": (100, 300), "both times": (100, 600), "only at the first time": (400, 600)}
    rows = [candidate(answer, "presence", answer, track=1, read=read) for answer, read in reads.items()]
    assert select(table(rows), RULES, "all", 0).table.num_rows == 3


def test_a_start_and_a_span_of_one_segment_are_not_both_chosen():
    texts = {"start": '{"frame":100}', "span": '{"start_frame":100,"end_frame":160}'}
    rows = [candidate(name, name, text, track=1, event="start 7") for name, text in texts.items()]
    assert select(table(rows), RULES, "all", 0).table.num_rows == 1
    rows[0]["event"] = "start 8"
    assert select(table(rows), RULES, "all", 0).table.num_rows == 2


def test_no_rows():
    report = select(table([]), RULES, "all", 0).report
    assert len({row["template"] for row in report}) == len(report) == 12
    assert {(row["candidates"], row["aim"], row["kept"]) for row in report} == {(0, None, 0)}


# -- balance ------------------------------------------------------------------------------------------------------


def choices(counts, template="change", stated=(), times=(0, 60), start=0):
    rows = []
    for answer, count in counts.items():
        for i in range(count):
            rows.append(
                candidate(
                    f"{template} {stated} {times} {answer} {start + i}", template, answer, stated=stated, times=times
                )
            )
    return rows


def shares(rows, template):
    counts = Counter(row["answer"] for row in rows if row["template"] == template)
    return {answer: count / sum(counts.values()) for answer, count in counts.items()}


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["change", "presence", "distance"]),
            st.sampled_from(["w", "x", "y", "z"]),
            st.sampled_from([(), ("reading",), ("reading", "typing")]),
            st.sampled_from([60, 100, 300]),
        ),
        max_size=120,
    ),
    st.sampled_from(["all", "paper"]),
)
@settings(deadline=None)
def test_no_answer_takes_more_than_its_share(drawn, profile):
    rows = [candidate(i, t, a, stated=s, times=(0, wait)) for i, (t, a, s, wait) in enumerate(drawn)]
    selection = select(table(rows), RULES, profile, 3)
    kept = selection.table.to_pylist()
    assert {row["carried"] for row in kept} <= {row["carried"] for row in rows}
    assert len(kept) == len(set(names(selection.table)))
    for template in ("change", "presence", "distance"):
        assert max(shares(kept, template).values(), default=0) <= 0.34
    random.Random(0).shuffle(rows)
    again = select(table(rows), RULES, profile, 3)
    assert again.table.equals(selection.table) and again.report == selection.report


def test_answers_are_levelled_within_the_stated_words_where_others_are_left(monkeypatch):
    rows = choices({"w": 90, "x": 30, "y": 30, "z": 30}, stated=("reading",))
    rows += choices({"w": 30, "x": 90, "y": 30, "z": 30}, stated=("typing",))
    monkeypatch.setitem(PROFILES, "few", {"unique_anchor": 160})
    kept = select(table(rows), RULES, "few", 0).table.to_pylist()
    for word in ("reading", "typing"):
        counts = Counter(row["answer"] for row in kept if row["stated"] == [word])
        assert len(counts) == 4 and len(set(counts.values())) == 1
    # Words are a preference: they leave nothing out.
    assert select(table(rows), RULES, "all", 0).table.num_rows == len(rows)


def test_words_that_go_with_one_answer_are_pooled():
    rows = [
        row for answer, word in (("w", "a"), ("x", "b"), ("y", "c")) for row in choices({answer: 40}, stated=(word,))
    ]
    rows += choices({"w": 200}, stated=("d",))
    counts = Counter(row["answer"] for row in select(table(rows), RULES, "all", 0).table.to_pylist())
    assert set(counts.values()) <= {40, 41} and sum(counts.values()) >= 120


def test_waits_are_levelled_within_an_answer():
    rows = []
    for wait, count in ((60, 400), (100, 30), (200, 30)):
        rows += choices({"w": count, "x": count, "y": count}, times=(0, wait))
    rows += choices({"w": 300}, times=(0, 60), start=10_000)
    kept = select(table(rows), RULES, "all", 0).table.to_pylist()
    for answer in "wxy":
        waits = Counter(row["times"][1] for row in kept if row["answer"] == answer)
        assert waits[100] == waits[200] == 30


def test_two_answers_only_cannot_be_balanced():
    selection = select(table(choices({"w": 50, "x": 50})), RULES, "all", 0)
    assert selection.table.num_rows == 0
    assert reported(selection)["change"] == (100, None, 0)


def test_a_template_short_of_its_aim_says_which_answers_are_left():
    near = {"track": 7, "read": (0,)}
    rows = choices({"w": 11, "x": 10, "y": 7}) + [candidate(f"near {i}", "change", "x", **near) for i in range(2)]
    (row,) = (row for row in select(table(rows), RULES, "paper", 0).report if row["template"] == "change")
    # Of two near-duplicates only one is left.
    left = "29 candidates are left (w 11, x 11, y 7), which allow 21 questions with at most 34 % for one answer"
    assert (row["candidates"], row["aim"], row["kept"], row["shortage"]) == (30, 540, 21, left)
    level = select(table(choices({"w": 9, "x": 9, "y": 9})), RULES, "paper", 0).report
    assert {row["shortage"] for row in level} == {None}


def reported(selection):
    return {row["template"]: (row["candidates"], row["aim"], row["kept"]) for row in selection.report}


def starts(offsets, action="walking"):
    return [
        candidate(f"{action} {i}", "start", f'{{"frame":{int(150 + s * 15)}}}', stated=(action,), times=(150,))
        for i, s in enumerate(offsets)
    ]


def test_event_offsets_are_levelled():
    generator = random.Random(5)
    rows = starts([generator.uniform(3, 6) for _ in range(300)] + [generator.uniform(6, 40) for _ in range(100)])
    kept = select(table(rows), RULES, "all", 0).table.to_pylist()
    bins = Counter(answer_bin("frame", row["answer"], row["times"], "start") for row in kept)
    assert max(bins.values()) <= 0.25 * len(kept)
    assert len(kept) >= 60


def test_few_offsets_stay_as_they_are():
    rows = starts([3.5, 4, 4.5, 8])
    assert select(table(rows), RULES, "all", 0).table.num_rows == 4


@pytest.mark.parametrize(
    ("seconds", "number"),
    [(3, 1), (5.9, 1), (6, 2), (9.9, 2), (10, 3), (14.9, 3), (15, 4), (20.9, 4), (21, 5), (99, 5)],
)
def test_offset_bins(seconds, number):
    assert answer_bin("frame", f'{{"frame":{round(150 + seconds * 15)}}}', [150], "start") == number
    span = f'{{"start_frame":{round(150 + seconds * 15)},"end_frame":9999}}'
    assert answer_bin("span", span, [150], "span") == number


def test_gap_and_wait_bins():
    assert [
        answer_bin("number", f'{{"value":{v}}}', [0], "seconds_between") for v in (5, 9.9, 10, 20, 39.9, 40, 400)
    ] == [
        1,
        1,
        2,
        3,
        3,
        4,
        4,
    ]
    assert [wait_bin(round(s * 15)) for s in (3, 5.9, 6, 11.9, 12, 24)] == [1, 1, 2, 2, 3, 4]


# -- profiles -----------------------------------------------------------------------------------------------------


def test_the_paper_profile():
    assert list(PROFILES["paper"].values()) == [67, 76, 222, 32, 51, 30, 1620]
    assert sum(PROFILES["paper"].values()) == 2098
    answers = {"w": 900, "x": 900, "y": 900}
    rows = choices(answers) + choices({"w": 40, "x": 40, "y": 40}, "presence")
    selection = select(table(rows), RULES, "paper", 0)
    # What presence and distance cannot give, change gives.
    assert Counter(row["template"] for row in selection.table.to_pylist()) == {"presence": 120, "change": 1500}
    report = reported(selection)
    assert report["presence"] == (120, 540, 120) and report["change"] == (2700, 540, 1500)
    assert report["distance"] == (0, 540, 0) and report["two_hop"] == (0, 76, 0)
    for family, number in PROFILES["paper"].items():
        assert sum(row["aim"] for row in selection.report if row["family"] == family) == number


@given(
    st.dictionaries(st.sampled_from(["change", "presence", "distance"]), st.lists(st.integers(0, 60), max_size=5)),
    st.integers(0, 130),
)
@settings(deadline=None)
def test_a_family_gets_its_number_where_its_answers_allow(counts, wanted):
    """No answer above 34 %, and no selection of this kind could hold one question more."""
    rows = [row for name, some in counts.items() for row in choices(dict(zip("vwxyz", some, strict=False)), name)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PROFILES, "paper", {"unique_anchor": wanted})
        selection = select(table(rows), RULES, "paper", 0)
    kept = {name: sorted(Counter(answers).values()) for name, answers in kept_answers(selection).items()}
    for answers in kept.values():
        assert max(answers) <= 0.34 * sum(answers)
    total = sum(map(sum, kept.values()))
    assert total <= wanted
    # What each template could hold by itself, in every size: min(count, floor(0.34 size)) summed reaches the size.
    sizes = {
        name: [k for k in range(sum(some) + 1) if sum(min(n, int(0.34 * k)) for n in some) >= k]
        for name, some in counts.items()
    }
    for name in counts:
        rest = total - sum(kept.get(name, []))
        # A larger size of this template alone, the others left as they are, would be too many.
        assert all(size + rest > wanted for size in sizes[name] if size > sum(kept.get(name, [])))


def kept_answers(selection):
    found = {}
    for row in selection.table.to_pylist():
        found.setdefault(row["template"], []).append(row["answer"])
    return found


PLANS["gap_count"] = canonical(
    TEMPLATES["gap_count"].build(
        Slots((Condition(action="sitting", at="t1"),), {"t1": 0, "t2": 300}, (), ("conversation",))
    )
)


def gaps(values, form="gap_starts"):
    times = (0, 300) if form == "gap_count" else (0,)
    return [
        candidate(f"{form} {i}", "gap", f'{{"value":{value}}}', times=times, form=form)
        for i, value in enumerate(values)
    ]


def test_counts_and_seconds_are_levelled_apart():
    seconds = gaps([6.0] * 50 + [12.0] * 50 + [25.0] * 50 + [50.0] * 50)
    kept = select(table(seconds + gaps([5] * 300, "gap_count")), RULES, "all", 0).table.to_pylist()
    # One count alone cannot be levelled: all stay, and they leave the seconds as they are.
    assert len(kept) == 500
    alone = select(table(gaps([4, 5, 6] * 30 + [5] * 300, "gap_count")), RULES, "all", 0).table.to_pylist()
    assert Counter(row["answer"] for row in alone) == {f'{{"value":{n}}}': 30 for n in (4, 5, 6)}


def test_the_forms_of_a_template_share_its_number():
    rows = gaps([6.0, 12.0, 25.0, 50.0] * 2) + gaps([4, 5, 6] * 40, "gap_count")
    selection = select(table(rows), RULES, "paper", 0)
    reads = Counter(row["form"] == "gap_count" for row in selection.table.to_pylist())
    assert reads == {False: 8, True: 22} and reported(selection)["gap"][1:] == (10, 30)


def test_the_seed_changes_which_are_kept_and_nothing_else_does():
    rows = choices({"w": 90, "x": 30, "y": 30, "z": 30})
    one, two = (select(table(rows), RULES, "all", seed).table for seed in (0, 1))
    assert one.num_rows == two.num_rows and not one.equals(two)


@given(st.lists(st.integers(0, 12), min_size=4, max_size=4))
@settings(deadline=None, max_examples=examples(20))
def test_no_two_bins_of_gaps_hold_more_and_no_more_gaps_could_stay(counts):
    lengths = (6.0, 12.0, 25.0, 50.0)
    rows = gaps([length for length, count in zip(lengths, counts, strict=True) for _ in range(count)])
    kept = Counter(row["answer"] for row in select(table(rows), RULES, "all", 0).table.to_pylist())
    sizes = [kept[f'{{"value":{length}}}'] for length in lengths]

    def within(sizes):
        return all(100 * (a + b) <= 50 * sum(sizes) for a, b in pairwise(sizes))

    best = max(sum(some) for some in product(*(range(count + 1) for count in counts)) if within(some))
    # Where next to none could stay, all do.
    assert sum(sizes) == (best if best >= sum(counts) / 10 else sum(counts))
    assert within(sizes) or sizes == counts
