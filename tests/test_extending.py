"""A template, a layer and an answer mode are added by the lists of `docs/architecture.md` alone, in an edited copy."""

import json
import os
import random
import re
import shutil
import subprocess
import sys

import pytest
from environment import DOCS, ROOT
from random_worlds import lively_world
from worlds import load_world, person, write_root

ARCHITECTURE = (DOCS / "architecture.md").read_text("utf-8")

ROW = """
    Template(
        "toy",
        "chain_2hop",
        AnswerSpec(mode="multiple_choice", read="action", of="c", at="t0"),
        ("At {t0}, begin with {who}. Go on to {the1}, and from there to {the2}. Which of these is C doing then?",),
        edges=_TWO_HOPS,
        time_proof="program",
        seeks="from somebody described two certain relations lead on to a person of known pose",
    ),
"""

READER = '''"""The toy layer: `labels_toy/<sequence>.json` -> the annotation table `toys`."""

from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles.columns import LayerTables
from jrdb_avr.loaders.problems import Problems


def load_toys(path: Path, problems: Problems) -> LayerTables:
    """Read the toys that people hold, {frame: [track, ...]}."""
    held = msgspec.json.decode(path.read_bytes(), type=dict[int, list[int]])
    rows = [{"frame": frame, "track": track} for frame in held for track in held[frame]]
    frames = np.array(sorted(held), np.int64)
    counts = np.array([len(held[frame]) for frame in frames], np.int64)
    return LayerTables({"toys": pa.Table.from_pylist(rows)}, {"toys": (frames, counts)})
'''

HEADING = """
    Mode(
        "heading",
        Heading,
        (Part("angle_deg", "angle", "direction of movement"),),
        same=lambda given, truth, _second: float(angle_error(given.angle_deg, truth.angle_deg)) <= 20.0,
        asks="angle",
        phrase="towards {angle_deg}",
        aim=0.25,
        guessers=("constant",),
        smallest_read="action",
    ),
"""

HEADING_STRUCT = '''
class Heading(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The direction of a person's movement, in degrees."""

    angle_deg: float


'''

PLAY_HEADING = """
import json
import numpy as np
from jrdb_avr.agent.methods.episode import Episode
from jrdb_avr.engine.pages.page import readable
from jrdb_avr.schema.answer_modes import decode_answer, same_answer
from jrdb_avr.schema.answers import Heading, encode_answer
from jrdb_avr.schema.method import Observation, Question, SequenceInfo, Task

question = Question(question_id="q", sequence="s", question="Where to?", choices=(), answer_mode="heading")
task = Task(
    question,
    SequenceInfo("s", 15.0, 100, (0, 5)),
    lambda sequence, frame_index, angle_deg: Observation(
        sequence, frame_index, 0.0, angle_deg, 46.0, 0, np.zeros((480, 480, 3), np.uint8)
    ),
    None,
    lambda step: None,
    lambda write: None,
)
episode = Episode(task)
seen = episode.observe(5, 180.0)
schema = episode.answer_schema["properties"]["answer"]
episode.submit({"angle_deg": 385.0}, [{"frame_id": seen.frame_index, "bbox": [427, 250, 573, 708]}])
prediction = episode.finished()
stored = encode_answer(prediction.answer)
print(json.dumps({
    "prompt": episode.prompt,
    "schema": schema,
    "status": prediction.status,
    "stored": stored,
    "scores": [same_answer(decode_answer("heading", stored), Heading(true)) for true in (10.0, 90.0)],
    "page": readable("heading", stored, (), 15.0),
}))
"""

PROGRAM = """
import json, sys
from jrdb_avr.engine.cli import main
for line in sys.stdin:
    sys.argv = ["jrdb-avr", *json.loads(line)]
    main()
    print(end=chr(0))
"""


ALONE = ("--workers", "1")
"""Each process of the copy reads and imports all of it anew."""


def listed(what):
    """The files that the page lists for adding something; a folder stands for files in it."""
    entry = re.search(rf"^\*\*{what}\*\*(.*?)(?=^\*\*|\Z)", ARCHITECTURE, re.M | re.S)[1]
    return set(re.findall(r"`((?:schema|loaders|queries|engine|agent)/[\w/.<>]*)`", entry))


class Copy:
    """A copy of the program to edit, and the files edited in it."""

    def __init__(self, folder):
        self.root = folder / "jrdb_avr"
        self.edited = set()
        # What is compiled already comes along: it is made anew for what is edited.
        ignored = shutil.ignore_patterns("tests", "docs", ".*", "build", "*.egg-info")
        shutil.copytree(ROOT, self.root, ignore=ignored)

    def add(self, name, text):
        assert not (self.root / name).exists()
        (self.root / name).write_text(text, "utf-8")
        self.edited.add(name)

    def insert(self, name, before, text):
        whole = (self.root / name).read_text("utf-8")
        assert whole.count(before) == 1, f"{name}: {before!r}"
        (self.root / name).write_text(whole.replace(before, text + before), "utf-8")
        self.edited.add(name)

    def python(self, program, text=""):
        """What a program over the copy prints."""
        done = subprocess.run(
            [sys.executable, "-P", "-c", program],
            input=text,
            capture_output=True,
            text=True,
            env=os.environ | {"PYTHONPATH": str(self.root.parent)},
            cwd=self.root.parent,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def run(self, *commands):
        """What each command of the copy prints; one process runs them all."""
        lines = (json.dumps([str(part) for part in command]) + "\n" for command in commands)
        return self.python(PROGRAM, "".join(lines)).split("\0")[:-1]


@pytest.fixture
def copy(tmp_path):
    return Copy(tmp_path)


def test_an_answer_mode_takes_a_struct_a_record_and_its_prompts(copy):
    copy.insert("schema/answers.py", "]\n\nTIE: Final", ', "heading"')
    copy.insert("schema/answers.py", "Answer = Choice |", HEADING_STRUCT.lstrip())
    copy.insert("schema/answers.py", "Choice | FrameAnswer", "Heading | ")
    copy.insert("schema/answer_modes.py", '        Mode(\n            "number",', HEADING)
    copy.insert("schema/answer_modes.py", "    FrameViewpoint,\n    Number,\n", "    Heading,\n")
    copy.add("agent/prompts/answer_heading.md", '{"angle_deg": 210.0}\nthe direction.\nLook twice.\n')
    copy.add("agent/prompts/agent_reads_heading.md", "No read gives a heading.\n")
    assert all(
        any(name.startswith(place.partition("<")[0]) for place in listed("an answer mode")) for name in copy.edited
    )

    played = json.loads(copy.python(PLAY_HEADING))
    assert '{"angle_deg": 210.0}' in played["prompt"] and "Look twice." in played["prompt"]
    assert played["schema"]["required"] == ["angle_deg"]
    assert (played["status"], played["stored"]) == ("answered", '{"angle_deg":25.0}')
    assert played["scores"] == [True, False]
    assert played["page"] == "towards 25.0\N{DEGREE SIGN}"


@pytest.mark.slow
def test_a_template_takes_a_row_and_a_query(copy, tmp_path):
    copy.insert("schema/templates.py", '    Template(\n        "three_hop",', ROW.lstrip("\n"))
    copy.add("queries/generators/toy.cypher", (ROOT / "queries/generators/two_hop.cypher").read_text("utf-8"))
    assert len(copy.edited) <= 4
    assert all(any(name.startswith(place) for place in listed("a template")) for name in copy.edited)

    # Twenty seconds of a few people, in which there are chains of two hops.
    store = load_world(tmp_path, lively_world(random.Random(8), "yard-2020-01-01_0")).path
    query = "SELECT question FROM questions WHERE template = 'toy'"
    generated, found, checked = copy.run(
        ("generate", "--store", store, "--json", *ALONE),
        ("sql", query, "--store", store, "--json"),
        # Proofs, the second program, and the plan over the graph.
        ("validate", "--replay", "--store", store, "--json"),
    )
    assert '"toy"' in generated
    questions = [row["question"] for row in json.loads(found)]
    assert questions and all("from there to" in question for question in questions)
    checks = json.loads(checked)
    assert checks and not any(check["faults"] for check in checks)


@pytest.mark.slow
def test_a_layer_takes_a_reader_a_table_and_their_names(copy, tmp_path):
    copy.add("loaders/layers/toys.py", READER)
    copy.insert("loaders/root.py", '    "pose": (', '    "toys": ("labels_toy",),\n')
    copy.insert("loaders/sequence.py", '    "pose": load_pose,', '    "toys": load_toys,\n')
    copy.insert(
        "loaders/sequence.py",
        "from jrdb_avr.loaders.problems import",
        "from jrdb_avr.loaders.layers.toys import load_toys\n",
    )
    copy.insert("schema/tables.py", '    *("timestamps", "images"),\n', '    "toys",\n')
    copy.insert(
        "schema/tables.py",
        '    "groups": ("Group of each person at each frame.',
        '    "toys": ("Toys that people hold.", "sequence frame track"),\n',
    )
    assert all(any(name.startswith(place) for place in listed("a layer")) for name in copy.edited)

    sequence, people = "toys-2019-02-07_0", [person(1, (100, 100, 60, 200)), person(3, (900, 100, 60, 200))]
    root = write_root(tmp_path / "root", {sequence: {"2d": {"labels": {"000015.jpg": people}}}})
    folder = root / "labels" / "labels_toy"
    folder.mkdir()
    (folder / f"{sequence}.json").write_text('{"15": [3, 1], "30": []}')
    store = tmp_path / "store"
    toys = "SELECT frame, track FROM annotations_toys ORDER BY track"
    records = "SELECT frame, records FROM annotations_frames WHERE layer = 'toys' ORDER BY frame"
    _, *found = copy.run(
        ("load", root, "--store", store, *ALONE),
        ("sql", toys, "--store", store, "--json"),
        ("sql", records, "--store", store, "--json"),
    )
    assert [json.loads(rows) for rows in found] == [
        [{"frame": 15, "track": 1}, {"frame": 15, "track": 3}],
        [{"frame": 15, "records": 2}, {"frame": 30, "records": 0}],
    ]
