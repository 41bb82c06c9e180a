"""A reader of the public text and the raw labels finds every stored answer, and no other.

The reader (`text_reader`) has no plan and shares no code with the program. It takes ambiguous words in each ordinary
way: a question passes when all of them single out the stored person and score against the stored answer.
"""

import ast
import json
import shutil

import pytest
from places import REAL, SUPPORT
from text_reader import Found, Reader, differs, open_readings
from text_reader_vocabulary import Reading
from text_reader_words import UnreadableError, parse

from jrdb_avr.schema.answers import decode_answer, same_answer
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.wording.text import render


class Benchmark:
    """Public questions of a store with their private answers, and a reader of each sequence."""

    def __init__(self, store, root):
        self.answers = {row["question_id"]: row for row in store.questions("answers").to_pylist()}
        self.rows = sorted(store.questions("questions").to_pylist(), key=lambda row: row["sequence"])
        self.boxes = {}
        for row in store.questions("evidence").to_pylist():
            self.boxes.setdefault(row["question_id"], {})[row["frame"]] = tuple(row[side] for side in "xywh")
        self.readers = {sequence: Reader(root, sequence) for sequence in {row["sequence"] for row in self.rows}}

    def stored(self, row):
        answer = self.answers[row["question_id"]]
        return Found(answer["target_track"], json.loads(answer["answer"]))


def wrong_answers(answer, choices):
    """Answers that score 0 against one, most of them barely."""
    if "choice" in answer:
        return [{"choice": choice + 1} for choice in range(len(choices)) if choice + 1 != answer["choice"]]
    if "value" in answer:
        return [{"value": answer["value"] * factor} for factor in (0.49, 2.01)]
    if "start_frame" in answer:
        first, last = answer["start_frame"], answer["end_frame"]
        way = (last - first + 1) // 3 + 1
        return [{"start_frame": first + by, "end_frame": last + by} for by in (-way, way) if first + by >= 0]
    moved = [{**answer, "frame": answer["frame"] + by} for by in (-16, 16)]
    turned = [{**answer, "angle_deg": (answer["angle_deg"] + by) % 360} for by in (-21, 21) if "angle_deg" in answer]
    return moved + turned


def check(benchmark):
    """Every stored answer is found under every held reading, and what scores 0 or is of another person is flagged."""
    for row in benchmark.rows:
        stored, reader = benchmark.stored(row), benchmark.readers[row["sequence"]]
        assert not reader.disputes(row["question"], row["choices"], stored), row["question"]
        found = reader.find(parse(row["question"]), row["choices"], Reading())
        for wrong in wrong_answers(stored.answer, row["choices"]):
            encoded = (decode_answer(row["answer_mode"], json.dumps(one)) for one in (wrong, stored.answer))
            assert not same_answer(*encoded)
            assert differs(found, Found(stored.target, wrong)), (row["question"], wrong)
        own = {
            frame: people[found.target].box
            for frame, people in reader.recording.frames.items()
            if found.target in people
        }
        assert own == benchmark.boxes[row["question_id"]]


def test_reader_finds_every_answer_of_the_sample(sample_benchmark):
    benchmark = Benchmark(sample_benchmark, sample_benchmark.path.parent / "root")
    assert len({row["template"] for row in benchmark.rows}) == 12
    check(benchmark)


def test_every_paraphrase_of_a_question_is_read_alike(sample_benchmark):
    plans = {row["question_id"]: parse_plan(row["plan"]) for row in sample_benchmark.questions("answers").to_pylist()}
    for row in sample_benchmark.questions("questions").to_pylist():
        plan = plans[row["question_id"]]
        for key in range(6):
            assert parse(render(row["template"], plan, f"{key:064x}")) == parse(row["question"])


def real_benchmark(folder, sequences):
    from jrdb_avr.engine.generate.run import generate
    from jrdb_avr.loaders.load import load
    from jrdb_avr.loaders.root import find_root
    from jrdb_avr.queries.store import Store
    from jrdb_avr.schema.rules import LoadRules, Rules

    labels = folder / "root" / "labels" / "labels_2d_stitched"
    labels.mkdir(parents=True)
    for path in sequences:
        shutil.copy(path, labels)
    store = Store(folder / "store")
    load(find_root(folder / "root"), store, LoadRules(), 1)
    generate(store, Rules(), workers=1)
    return Benchmark(store, folder / "root")


real = pytest.mark.skipif(not REAL.exists(), reason="the real annotations are not here")


@real
def test_reader_finds_every_answer_of_two_real_sequences(tmp_path):
    labels = sorted((REAL / "labels" / "labels_2d_stitched").glob("*.json"), key=lambda path: path.stat().st_size)
    check(real_benchmark(tmp_path, labels[:2]))


@real
@pytest.mark.slow
def test_reader_finds_every_answer_of_the_real_annotations(tmp_path):
    check(real_benchmark(tmp_path, (REAL / "labels" / "labels_2d_stitched").glob("*.json")))


# The reader itself, on worlds of a few people.

CHOICES = ["walking", "standing", "sitting", "lying down"]
LEFT = "Find the only person to the robot's left who is holding something at 1.0 s (frame 15). "
POSE = LEFT + "What is that person's posture or movement at 4.0 s (frame 60)?"


def person(number, degrees, *actions, width=40, prefix="pedestrian"):
    box = [degrees / 360 * 3760 - width / 2, 100, width, 200]
    group = {"cluster_ID": number, "cluster_stat": 1}
    return {
        "label_id": f"{prefix}:{number}",
        "box": box,
        "action_label": dict.fromkeys(actions, 1),
        "social_group": group,
    }


@pytest.fixture
def reader(tmp_path):
    """A reader of one sequence whose people are the same at every keyframe."""

    def make(*people, later=None):
        (tmp_path / "labels_2d_stitched").mkdir(exist_ok=True)
        frames = range(0, 91, 15)
        labels = {f"{frame:06}.jpg": people if later is None or frame < 60 else later for frame in frames}
        (tmp_path / "labels_2d_stitched" / "place.json").write_text(json.dumps({"labels": labels}))
        return Reader(tmp_path, "place")

    return make


ALICE = person(1, 95, "standing", "holding sth")


@pytest.mark.parametrize(("degrees", "disputed"), [(185, False), (150, True), (134, True)])
def test_a_second_person_of_the_half_plane_is_a_dispute(reader, degrees, disputed):
    one = reader(ALICE, person(2, degrees, "walking", "holding sth"))
    assert bool(one.disputes(POSE, CHOICES, Found(1, {"choice": 2}))) == disputed


def test_a_doubtful_label_may_fit_a_description(reader):
    bob = person(2, 100, "walking")
    bob["action_label"]["holding sth"] = 3
    assert "several fit" in str(reader(ALICE, bob).disputes(POSE, CHOICES, Found(1, {"choice": 2})))


def test_a_record_without_a_number_may_be_anybody(reader):
    text = LEFT + "Look again at 5.0 s (frame 75) and at 6.0 s (frame 90): at which of these can that person be seen, "
    choices, away = ["neither time", "both times"], Found(1, {"choice": 1})
    text += "if at either?"
    assert not reader(ALICE, later=[]).disputes(text, choices, away)
    for prefix in ("Pedestrian", "pedestrian:x", "ped"):
        stranger = person(2, 300, "walking", prefix=prefix)
        assert reader(ALICE, later=[stranger]).disputes(text, choices, away)
    assert not reader(ALICE, later=[person(2, 300, prefix="car")]).disputes(text, choices, away)


def test_first_to_the_left_is_the_nearest_by_centre_and_by_edge(reader):
    text = (
        "In the scene at 1.0 s (frame 15), A is the only person who is holding something. B is the first person to the "
        "left of A as seen from the robot. C is the first person to the left of B as seen from the robot. "
        "What is C's posture or movement?"
    )
    others = [person(2, 80, "walking"), person(3, 70, "sitting"), person(4, 62, "walking", width=240)]
    complaints = reader(ALICE, *others).disputes(text, CHOICES, Found(3, {"choice": 3}))
    assert len(complaints) == 1 and "near edge" in complaints[0] and "person 4" in complaints[0]


def test_open_readings_name_what_the_rules_do_not_hold(reader):
    text = "Find the only person who is walking at 1.0 s (frame 15). " + POSE.removeprefix(LEFT)
    one = reader(person(1, 95, "walking"), person(2, 250, "going upstairs"))
    found = Found(1, {"choice": 1})
    assert not one.disputes(text, CHOICES, found)
    assert "several fit" in str(one.disputes(text, CHOICES, found, open_readings))


@pytest.mark.parametrize(
    "text",
    [
        POSE.replace("holding something", "juggling"),
        POSE.replace("1.0 s", "2.0 s"),
        POSE.replace("posture or movement", "mood"),
        POSE.replace("robot's left", "robot's far side"),
    ],
)
def test_unknown_words_are_refused(text):
    with pytest.raises(UnreadableError):
        parse(text)


def test_reader_shares_no_code_with_the_program():
    for path in SUPPORT.glob("text_reader*.py"):
        tree = ast.parse(path.read_text())
        names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
        names |= {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert not [name for name in names if name.startswith("jrdb_avr")]
