"""An episode keeps the rules of a question whoever plays it: a harness with tools, or a script."""

import contextlib
import re

import msgspec
import pytest
from environment import DOCS
from scripted import MODES, blank_task, evidence

from jrdb_avr.agent.methods.episode import Episode, Remaining, most_moves
from jrdb_avr.agent.methods.react import ReAct
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.errors import AvrError, ObserveError, RefusedError

METHODS = (DOCS / "methods.md").read_text("utf-8")
BOX = evidence((100, 200, 300, 400), frame=5)


def refused(move, *arguments):
    with pytest.raises(RefusedError) as caught:
        move(*arguments)
    return str(caught.value)


def test_a_look_and_an_answer_are_the_question():
    episode = Episode(blank_task(), budget=3)
    assert (episode.frames, episode.left, episode.over) == ((0, 5, 10), Remaining(3, 8), False)
    assert episode.observe(5, 540).angle_deg == 180.0
    assert episode.left == Remaining(2, 7)
    episode.submit(2, BOX)
    found = episode.finished()
    assert (found.status, found.answer, found.reason) == ("answered", Choice(2), "")
    # 480 pixels wide, 40 columns to the left of the crop: the crop of 180 degrees begins at column 1640.
    assert (found.evidence.frame, found.evidence.box) == (5, (1640 + 48, 96, 96, 96))
    assert (found.n_observations, found.n_model_calls) == (1, 2)
    assert episode.over and episode.left == Remaining(0, 0)
    assert "finished" in refused(episode.observe, 0, 0.0)
    assert episode.finished() == found


def test_a_refused_move_is_spent_and_says_why():
    episode = Episode(blank_task(), budget=2)
    assert refused(episode.submit, 2, BOX) == "the first turn must look"
    assert "none of the legal frames" in refused(episode.observe, 7, 0.0)
    assert "six digits" in refused(episode.observe, "../../etc", 0.0)
    assert "finite" in refused(episode.observe, 5, float("nan"))
    episode.observe("000005", 359.8)
    assert "within 1 degree" in refused(episode.observe, 5, 0.3)
    assert episode.left == Remaining(1, 0) and episode.over
    found = episode.finished()
    assert (found.status, found.answer, found.evidence) == ("invalid", Choice(2), None)
    assert "finite" in found.reason


def test_looks_end_before_moves():
    episode = Episode(blank_task(), budget=1)
    episode.observe(0, 0.0)
    assert "no looks are left" in refused(episode.observe, 5, 90.0)
    assert episode.left == Remaining(0, 2)


def test_the_newest_readable_parts_count_and_an_answer_sent_again_ends():
    episode = Episode(blank_task())
    episode.observe(5, 180.0)
    assert "number of a choice" in refused(episode.submit, 9, BOX)
    assert "evidence" in refused(episode.submit, 3, [])
    assert "evidence" in refused(episode.submit, 3, [])
    assert episode.over
    found = episode.finished()
    assert (found.answer, found.evidence.frame, found.status) == (Choice(3), 5, "answered")


def test_finished_is_pure_and_may_be_called_at_any_time():
    episode = Episode(blank_task())
    seen = []
    for move in (lambda: episode.observe(5, 180.0), lambda: episode.observe(5, 180.0), lambda: episode.submit(1, [])):
        assert episode.finished() == episode.finished()
        seen.append(episode.finished())
        with pytest.raises(RefusedError) if len(seen) > 1 else contextlib.nullcontext():
            move()
    assert [found.status for found in (*seen, episode.finished())] == ["answered"] * 3 + ["invalid"]
    assert "no answer was taken" in seen[0].reason
    episode.submit(4, BOX)
    assert episode.finished().answer == Choice(4)


def test_a_broken_picture_is_no_refusal():
    task = blank_task()

    def broken(sequence, frame_index, angle_deg):
        raise ObserveError("000005.jpg cannot be decoded")

    object.__setattr__(task, "observe", broken)
    episode = Episode(task)
    with pytest.raises(ObserveError):
        episode.observe(5, 0.0)
    assert issubclass(RefusedError, AvrError) and episode.left.looks == episode.budget


@pytest.mark.parametrize("mode", MODES)
def test_the_prompt_has_the_rules_and_its_example_is_taken(mode):
    choices = ("walking", "standing") if mode == "multiple_choice" else ()
    episode = Episode(blank_task(mode, choices), budget=7)
    assert "You may make 7 looks and 16 turns" in episode.prompt
    assert episode.prompt.endswith(episode.text) and "Question: What does the person do?" in episode.text
    assert "Legal frames: 000000 to 000010 in steps of 5" in episode.text
    form = episode.prompt.partition("submit_answer(answer=")[2].partition(", evidence_bboxes=")[0]
    for placeholder, value in (("<frame_id>", "000005"), ("<angle>", "180"), ("<choice>", "2"), ("<number>", "12.5")):
        form = form.replace(placeholder, value)
    arguments = {"answer": msgspec.json.decode(form), "evidence_bboxes": BOX}
    assert list(arguments) == list(episode.answer_schema["properties"]) == episode.answer_schema["required"]
    episode.observe(5, 180.0)
    episode.submit(arguments["answer"], BOX)
    assert episode.finished().status == "answered"


@pytest.mark.parametrize("mode", MODES)
def test_the_method_of_the_page_answers_in_every_mode(mode):
    (code,) = re.findall(r"^```python\n(from jrdb_avr import Episode\n.*?)^```", METHODS, re.M | re.S)
    names = {}
    exec(compile(code, "docs/methods.md", "exec"), names)
    task = blank_task(mode, ("walking", "standing") if mode == "multiple_choice" else ())
    assert names["Ahead"](None).answer(task).status == "answered"


def test_tools_and_react_make_the_same_prediction_of_the_same_moves():
    moves = [
        '{"action": "answer", "answer": 2, "evidence_bboxes": []}',
        '{"action": "observe", "frame_id": "000005", "angle_deg": 180}',
        '{"action": "observe", "frame_id": "000005", "angle_deg": 180.5}',
        '{"action": "answer", "answer": 9, "evidence_bboxes": [{"frame_id": "000005", "bbox": [1, 2, 3, 4]}]}',
        '{"action": "answer", "answer": 3, "evidence_bboxes": [{"frame_id": "000005", "bbox": [9, 2, 3, 4]}]}',
    ]
    replies = iter(moves * 10)

    class Chat:
        def complete(self, messages, schema=None):
            return Reply(next(replies), finish_reason="stop")

    steps, own = [], []
    by_react = ReAct(Chat(), budget=4).answer(blank_task(steps=steps))
    episode = Episode(blank_task(steps=own), budget=4)
    turn = 0
    while not episode.over:
        move = msgspec.json.decode(moves[turn % len(moves)])
        turn += 1
        with pytest.raises(RefusedError) if turn != 2 else contextlib.nullcontext():
            if move["action"] == "observe":
                episode.observe(move["frame_id"], move["angle_deg"])
            else:
                episode.submit(move["answer"], move["evidence_bboxes"])
    by_tools = episode.finished()
    assert turn == most_moves(4)
    for name in ("status", "answer", "evidence", "reason", "verdict", "n_observations", "n_model_calls"):
        assert getattr(by_tools, name) == getattr(by_react, name), name
    plain = [(step.kind, step.request, step.response) for step in steps if step.kind != "model"]
    assert plain == [(step.kind, step.request, step.response) for step in own]
