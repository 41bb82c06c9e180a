"""What is said of templates with few questions, on tables written by hand."""

import pyarrow as pa

from jrdb_avr.engine.generate.diagnostics import REASONS, RULES, tallies
from jrdb_avr.schema.tables import LAYERS, QUESTIONS
from jrdb_avr.schema.templates import FAMILIES, FORMS, forms_of


def rejected(counts):
    rows = [
        {"sequence": "s", "family": FAMILIES[template], "template": template, "rule": rule, "candidates": count}
        for template, rule, count in counts
    ]
    return pa.Table.from_pylist(rows, schema=QUESTIONS["rejected"])


def asked(**counts):
    names = [name for name, count in counts.items() for _ in range(count)]
    row = {"question_id": "", "sequence": "s", "question": "", "choices": [], "answer_mode": ""}
    rows = [row | {"template": name, "family": FAMILIES[name]} for name in names]
    return pa.Table.from_pylist(rows, schema=QUESTIONS["questions"])


def told(counts, questions, lacking=0, **selected):
    """The row of each template. The layer 3d is missing in so many of three sequences."""
    selection = [{"template": "two_hop", "quota": None, "shortage": None} | selected]
    layers = {f"s{n}": [layer for layer in LAYERS if layer != "3d" or n >= lacking] for n in range(3)}
    rows = tallies(rejected(counts), questions, layers, selection)
    assert [row["template"] for row in rows] == list(FAMILIES)
    return {row["template"]: row for row in rows}


COUNTS = [
    ("two_hop", "anchor", 60),
    ("two_hop", "anchor", 40),
    ("two_hop", "hop.stop", 70),
    ("two_hop", "time.shift", 20),
    ("two_hop", "selection", 5),
]


def test_candidates_are_what_was_refused_and_what_was_kept():
    row = told(COUNTS, asked(two_hop=5))["two_hop"]
    assert {name: row[name] for name in row if name != "why"} == {
        **{"family": "chain_2hop", "template": "two_hop", "candidates": 200, "proven": 10, "questions": 5},
        **dict.fromkeys(REASONS, 0),
        **{"anchor": 100, "hop.stop": 70, "time.shift": 20, "selection": 5},
    }


def test_few_questions_are_explained_by_the_rules_that_refused_most():
    row = told(COUNTS, asked(two_hop=5))["two_hop"]
    assert row["why"] == (
        "candidates: 200, proven: 10, questions: 5; "
        f"anchor refused 50 %: {REASONS['anchor']}; hop.stop refused 35 %: {REASONS['hop.stop']}"
    )
    # One question fewer than balance dropped: that is a reason too.
    assert told(COUNTS, asked(two_hop=4))["two_hop"]["why"].endswith(f"selection refused 3 %: {REASONS['selection']}")


def test_shares_too_small_for_a_percent_are_not_called_none():
    counts = [("two_hop", "anchor", 980), ("two_hop", "hop.stop", 4)]
    why = told(counts, asked(two_hop=16))["two_hop"]["why"]
    assert "; anchor refused 98 %: " in why and "; hop.stop refused <1 %: " in why


def test_enough_questions_or_as_many_as_were_asked_for_need_no_reason():
    assert told(COUNTS, asked(two_hop=30))["two_hop"]["why"] is None
    assert told(COUNTS, asked(two_hop=29))["two_hop"]["why"] is not None
    assert told(COUNTS, asked(two_hop=10), quota=10)["two_hop"]["why"] is None
    assert told(COUNTS, asked(two_hop=9), quota=10)["two_hop"]["why"] is not None


def test_the_answers_that_are_left_explain_what_balance_refused():
    row = told(COUNTS, asked(two_hop=40), quota=50, shortage="only sitting is left")["two_hop"]
    assert row["why"].startswith("candidates: 235, proven: 45, questions: 40; anchor refused 43 %")
    assert row["why"].endswith("; selection refused 2 %: only sitting is left")


def test_no_candidate_says_what_the_scenes_do_not_hold():
    row = told([], asked())["consequence"]
    assert row["why"] == f"no candidate, nowhere is it certain that {forms_of('consequence')[0].seeks}"


def test_a_missing_layer_is_the_reason():
    assert told([], asked(), 3)["distance"]["why"] == "skipped, the layer 3d is missing"
    row = told([("distance", "anchor", 4)], asked(distance=1), 2)["distance"]
    assert row["why"].startswith("skipped, the layer 3d is missing in 2 of 3 sequences; candidates: 5, proven: 1")


def test_every_rule_and_template_has_its_words():
    assert tuple(REASONS)[: len(RULES)] == tuple(RULES)
    assert all(forms[0].seeks for forms in FORMS.values())
