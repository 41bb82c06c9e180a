"""Reasoning files: what people do with things, and the social facts where no social file gives them."""

from __future__ import annotations

import functools

from label_records import BOX, NAME, placed, read, record, rows
from loaded_stores import reported_store
from worlds import member, person, thing

from jrdb_avr.loaders.layers.social import load_reasoning

things_alone = functools.partial(load_reasoning, social=False)


def handling(*pairs):
    return [{"inter_labels": verbs, "pair": pair} for pair, verbs in pairs]


def test_where_a_record_of_a_person_is_lost_no_list_of_things_is_whole(tmp_path):
    people = [member(1, BOX, handles=[((12, 17), {"holding": "1"})]), member(1, BOX, handles=[]), member(2, BOX)]
    reading, _ = read(tmp_path, people, things_alone)
    assert rows(reading, "handles") == [(0, 1, 12, 17, "holding", 1)]
    assert rows(reading, "listed") == []


def test_beside_a_social_file_only_things_are_read(tmp_path):
    content = [member(1, BOX, {"gender": {"Male": "x"}}, [(1, {"hugging": "1"})], None, [((0, 0), {"holding": "1"})])]
    reading, problems = read(tmp_path, content, things_alone)
    assert set(reading.tables) == {"handles", "listed"}
    assert set(reading.frames) == {"handles"}
    assert rows(reading, "handles") == [(0, 1, 0, 0, "holding", 1)]
    # What is wrong with the social part is not of interest here.
    assert problems == []


def test_case_09_verbs_in_every_spelling(tmp_path):
    verbs = {"looking_at": "1", "Finding something": "1", "talking-on": "1", "juggling_balls": "2"}
    reading, problems = read(tmp_path, [record(HOI=handling(([3, 17], verbs)))], things_alone)
    assert [row[4] for row in rows(reading, "handles")] == [
        "finding_something",
        "juggling balls",
        "looking at",
        "talking on",
    ]
    assert dict(reading.unknown) == {("HOI", "juggling balls"): 1}
    assert problems == []


# -- intervals ---------------------------------------------------------------------------------------------------


def loaded(tmp_path, **layers):
    layers = {{"boxes": "2d"}.get(name, name): content for name, content in layers.items()}
    return reported_store(tmp_path, layers)


def spans(store, kind):
    names = [n for n in store.interval(kind, NAME).column_names if n not in ("sequence", "first_s", "last_s")]
    return [tuple(row[n] for n in names) for row in store.interval(kind, NAME).to_pylist()]


def people(frames, *tracks):
    return {f: [person(t, placed(t)) for t in tracks] for f in frames}


def test_handling_becomes_intervals_with_gaps_and_doubts(tmp_path):
    def entries(frame):
        if 4 <= frame <= 6:
            return []
        code = "3" if frame >= 15 else "1"
        return [((12, 40), {"touching": code}), ((12, 40), {"touching": "3"}), ((12, 57), {"opening": "2"})]

    told = {f: [member(1, placed(1), handles=entries(f))] for f in range(20)}
    store, _ = loaded(tmp_path, boxes=people(range(20), 1), reasoning=told)
    assert spans(store, "handles") == [
        (1, 12, 40, "touching", 0, 3, True),
        (1, 12, 40, "touching", 7, 14, True),
        (1, 12, 40, "touching", 15, 19, False),
        (1, 12, 57, "opening", 0, 3, True),
        (1, 12, 57, "opening", 7, 19, True),
    ]
    gaps = [(1, 12, 40, "touching", 4, 6, True), (1, 12, 57, "opening", 4, 6, True)]
    assert spans(store, "possible_handles") == gaps


def test_people_are_no_things_and_the_absent_handle_nothing(tmp_path):
    told = {
        0: [member(t, placed(t), handles=[((5, 63), {"touching": "1"}), ((5, 40), {"touching": "1"})]) for t in (1, 2)]
    }
    store, _ = loaded(tmp_path, boxes=people([0], 1), reasoning=told, panoptic={0: [thing(5, 40), thing(5, 63)]})
    # Category 63 is the pedestrian; person 2 has no box.
    assert spans(store, "handles") == [(1, 5, 40, "touching", 0, 0, True)]
