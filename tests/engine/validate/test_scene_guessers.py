"""Guessers that know the store's people: on a store made by hand, and on the sample against SQL and `iou`."""

import duckdb
import pytest
from scored_runs import table

from jrdb_avr.engine.generate.blind import QuestionText, blind_check, question_texts
from jrdb_avr.engine.validate.scene_guessers import check_store, scene_guessers
from jrdb_avr.queries.store import Store, write_table
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.labels import answer_of_choice
from jrdb_avr.schema.panorama import Box, iou
from jrdb_avr.schema.tables import INTERVALS
from jrdb_avr.schema.templates import TEMPLATES

CHOICES = ("walking", "standing", "sitting", "cycling")
FRAMES = (0, 15, 30, 45)

PEOPLE = (
    # sequence, track, what the person certainly does at frames 0 and 30, where the box ends, clear
    ("a", 1, "reading", "standing", 45, True),
    ("a", 2, "reading", "standing", 45, True),
    ("a", 3, "reading", "standing", 45, True),
    ("b", 1, "reading", "walking", 45, True),
    ("b", 2, "reading", "walking", 30, True),
    ("b", 3, "reading", "sitting", 45, True),
    ("b", 4, "typing", "sitting", 45, True),
    ("c", 1, "typing", "sitting", 30, True),
    ("c", 2, "reading", "cycling", 45, False),
    ("c", 3, "reading", "cycling", 45, False),
    ("c", 4, "reading", "cycling", 45, False),
    # A label outside the vocabulary.
    ("d", 1, "waiting for sth", "waiting for sth", 45, True),
)


@pytest.fixture
def store(tmp_path):
    """Four sequences with these people; the boxes of a sequence are the larger, the larger the track."""
    store = Store(tmp_path)
    for name in "abcd":
        own = [row for row in PEOPLE if row[0] == name]
        box = {"sequence": name, "x": 100.0, "y": 100.0, "h": 100.0}
        rows = {
            "sequence": [{"sequence": name, "fps": 15.0, "frame_count": 60}],
            "frames": [{"sequence": name, "frame": frame, "keyframe": True} for frame in FRAMES],
            "sightings": [
                {**box, "frame": frame, "track": track, "w": 10.0 * track, "clear": clear}
                for _, track, _, _, end, clear in own
                for frame in FRAMES
                if frame <= end
            ],
            "actions": [
                {"sequence": name, "track": track, "action": action, "first": first, "last": first, "certain": True}
                for _, track, *actions, _, _ in own
                for action, first in zip(actions, (0, 30), strict=True)
            ],
        }
        for kind, of_kind in rows.items():
            path = tmp_path / "intervals" / kind / f"{name}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_table(path, table(of_kind, INTERVALS[kind]), INTERVALS[kind], {})
    return store


def asked(sequence, described, truth, times=(0, 30), choices=CHOICES):
    number = Choice(choices.index(truth) + 1)
    return QuestionText("q", sequence, TEMPLATES["change"], choices, described, times, number)


def share(store, *questions, name="people"):
    return blind_check(questions, scene_guessers(store))[0][name]


def test_the_likeliest_action_after_the_wait_among_people_of_other_sequences(store):
    # Of those who read at first, b has two walking and one sitting. Neither a itself nor unclear people count.
    assert share(store, asked("a", ("reading",), "walking")) == 1
    assert share(store, asked("a", ("reading",), "standing")) == 0
    assert share(store, asked("b", ("reading",), "standing")) == 1
    # Nobody in another sequence types and reads at once: by all people, two walk and three sit.
    assert share(store, asked("a", ("reading", "typing"), "sitting")) == 1
    # Nobody has an action 45 frames later, so that all choices are equally likely.
    assert share(store, asked("a", ("reading",), "walking", (0, 45))) == 0.25


def test_without_a_wait_the_description_tells_what_a_person_does_at_once(store):
    choices = ("typing", "walking", "standing", "sitting")
    assert share(store, asked("a", ("typing",), "typing", (0,), choices)) == 1
    # Of the target of a chain nothing is stated: in b and c two people type, two walk, and three sit.
    assert share(store, asked("a", (), "sitting", (0,), choices)) == 1
    assert share(store, asked("a", (), "typing", (0,), choices)) == 0


@pytest.fixture(scope="module")
def texts(sample_benchmark):
    return question_texts(sample_benchmark.questions("questions"), sample_benchmark.questions("answers"))


@pytest.fixture(scope="module")
def sample(sample_benchmark, texts):
    return {(row["form"], row["asks"]): row for row in check_store(sample_benchmark, texts)}


def sql_of(store):
    connection = duckdb.connect()
    for kind in ("sightings", "frames", "actions", "sequence"):
        connection.execute(f"CREATE VIEW {kind} AS SELECT * FROM '{store.path}/intervals/{kind}/*.parquet'")
    connection.execute(
        """CREATE TABLE doing AS SELECT sequence, track, frame, list(DISTINCT action) AS actions
        FROM sightings JOIN frames USING (sequence, frame) JOIN actions USING (sequence, track)
        WHERE keyframe AND clear AND certain AND frame BETWEEN first AND last GROUP BY ALL"""
    )
    return connection


LIKELIEST = {
    "change": """SELECT action, count(*) FROM (SELECT unnest(later.actions) AS action
        FROM doing d JOIN doing later ON d.sequence = later.sequence AND d.track = later.track
            AND later.frame = d.frame + $waits[1]
        WHERE d.sequence <> $sequence AND list_has_all(d.actions, $described::VARCHAR[])) GROUP BY ALL""",
    "presence": """SELECT CASE WHEN one AND two THEN 'both times' WHEN one THEN 'only at the first time'
            WHEN two THEN 'only at the second time' ELSE 'neither time' END AS answer, count(*)
        FROM (SELECT EXISTS (FROM sightings s WHERE s.sequence = d.sequence AND s.track = d.track
                AND s.frame = d.frame + $waits[1]) AS one,
            EXISTS (FROM sightings s WHERE s.sequence = d.sequence AND s.track = d.track
                AND s.frame = d.frame + $waits[2]) AS two
            FROM doing d JOIN sequence USING (sequence)
            WHERE d.sequence <> $sequence AND list_has_all(d.actions, $described::VARCHAR[])
                AND d.frame + $waits[2] < frame_count) GROUP BY ALL""",
}


@pytest.mark.parametrize("form", LIKELIEST)
def test_the_likeliest_answer_is_that_of_sql(form, sample_benchmark, texts, sample):
    connection, scores = sql_of(sample_benchmark), []
    for question in (own for own in texts if own.form.query == form):
        for described in (question.described, ()):
            values = {"waits": [time - question.times[0] for time in question.times[1:]], "described": list(described)}
            found = connection.execute(LIKELIEST[form], values | {"sequence": question.sequence}).fetchall()
            people = {text: dict(found).get(answer_of_choice(text), 0) for text in question.choices}
            if any(people.values()):
                break
        best = [text for text in people if people[text] == max(people.values())]
        scores.append((question.chosen in best) / len(best))
    assert len(scores) > 5 and len(set(scores)) > 1
    assert sample[form, "choice"]["people"] == pytest.approx(sum(scores) / len(scores))


def test_boxes_are_those_of_the_evidence(sample_benchmark, texts, sample):
    """The largest person and the best box of each form, box by box with `iou`."""
    evidence = {
        (row["sequence"], row["track"], row["frame"]): Box(*(row[side] for side in "xywh"))
        for row in sample_benchmark.questions("evidence").to_pylist()
    }
    answers = sample_benchmark.questions("answers").to_pylist()
    target = {row["question_id"]: row["target_track"] for row in answers}
    connection = sql_of(sample_benchmark)
    largest = {}
    for name in {own.sequence for own in texts}:
        rows = connection.execute(
            "SELECT frame, x, y, w, h, frame_count FROM sightings JOIN sequence USING (sequence) "
            "WHERE clear AND sequence = ?",
            [name],
        ).fetchall()
        middle = min({row[0] for row in rows}, key=lambda frame: (abs(frame - rows[0][5] / 2), frame))
        largest[name] = (
            middle,
            Box(*max((row for row in rows if row[0] == middle), key=lambda row: row[3] * row[4])[1:5]),
        )
    for (form, asks), row in sample.items():
        group = [own for own in texts if own.form.query == form and own.asks == asks]
        boxes = [evidence[own.sequence, target[own.question_id], own.times[0]] for own in group]
        best = max(sum(iou(guess, box) >= 0.5 for box in boxes) for guess in boxes)
        assert row["best_box"] == pytest.approx(best / len(group)), form
        right = 0
        for own in group:
            frame, guess = largest[own.sequence]
            box = evidence.get((own.sequence, target[own.question_id], frame))
            right += box is not None and iou(guess, box) >= 0.5
        assert row["largest"] == pytest.approx(right / len(group)), form
        assert row["combined"] <= min(max(row["best_box"], row["largest"]), 1)
    assert any(row["combined"] for row in sample.values())


def test_a_store_without_new_sequences_teaches_nothing(sample_benchmark, texts):
    with pytest.raises(InputError, match="no sequence that this one lacks"):
        check_store(sample_benchmark, texts, sample_benchmark)
