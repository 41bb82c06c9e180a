"""A person as a method: the moves of the page are those of an episode, and what is played is an ordinary run."""

import json
import shutil

import pytest
from browser import browser, complaints, fetch, serving

from jrdb_avr.engine.pages.page import render
from jrdb_avr.engine.report.comparison import report
from jrdb_avr.engine.report.people import HUMAN
from jrdb_avr.engine.run.human import HumanDesk
from jrdb_avr.engine.run.options import QuestionSelection
from jrdb_avr.engine.run.playing import played_run
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.schema.errors import StoreError

HOSTILE = '</script><script>document.title="hit"</script><img src=x onerror=\'document.title="hit"\'>'
PRIVATE_PARTS = ("questions/answers.parquet", "questions/evidence", "annotations", "intervals", "graph.kuzu")


@pytest.fixture
def store(small_demo, tmp_path):
    shutil.copytree(small_demo.folder / "store", tmp_path / "store")
    return Store(tmp_path / "store")


def chosen(store, number=2):
    """The first questions with choices."""
    rows = store.questions("questions").to_pylist()
    return [row["question_id"] for row in rows if row["choices"]][:number]


def playing(store, name="human-a", number=2, **more):
    return played_run(
        store, HUMAN, "ada", name, questions=QuestionSelection(questions=tuple(chosen(store, number))), **more
    )


def post(server, path, body=b""):
    status, text = fetch(
        server, path, method="POST", body=body if isinstance(body, bytes) else json.dumps(body).encode()
    )
    return json.loads(text) if status == 200 else status


def move(server, state, **own):
    return post(server, "move", {"question_id": state["play"]["question_id"], "move": own})


def look(server, state, frame, angle):
    return move(server, state, action="observe", frame_id=f"{frame:06d}", angle_deg=angle)


def answer(server, state, choice, bbox):
    newest = state["play"]["looks"][-1]["frame_id"] if state["play"]["looks"] else "000000"
    evidence = [{"frame_id": newest, "bbox": bbox}]
    return move(server, state, action="answer", answer=choice, evidence_bboxes=evidence)


def test_a_person_plays_under_the_rules_of_react(store):
    """The prediction is that of an episode with the same moves; private files are not there to be read."""
    for part in PRIVATE_PARTS:
        path = store.path / part
        (shutil.rmtree if path.is_dir() else (lambda own: own.unlink(missing_ok=True)))(path)
    box = [400, 300, 600, 800]
    with playing(store) as (bench, run), serving(HumanDesk(bench, run, "the page").respond) as server:
        assert fetch(server) == (200, "the page")
        state = post(server, "state")
        assert set(state) == {"due", "questions", "error", "play"} and (state["due"], state["questions"]) == (2, 2)
        assert set(state["play"]) == {
            *("question_id", "question", "choices", "fields", "rule", "advice", "frames", "fps", "frame_count"),
            *("looks", "left", "over", "answered"),
        }
        frame = state["play"]["frames"][3]
        none = next(own for own in range(frame, 10_000) if own not in state["play"]["frames"])
        assert "must look" in answer(server, state, 1, box)["error"]
        state = look(server, state, frame, 90.0)
        assert state["error"] == "" and state["play"]["left"] == {"looks": 23, "moves": 48}
        assert "within 1 degree" in look(server, state, frame, 90.5)["error"]
        assert "legal" in look(server, state, none, 90)["error"]
        assert "answer must be" in answer(server, state, 99, box)["error"]
        assert fetch(server, f"look?question={state['play']['question_id']}&number=0")[0] == 200
        last = answer(server, state, 2, box)
        assert last["error"] == "" and last["play"]["over"] and last["play"]["answered"] and last["due"] == 1
        assert move(server, state, action="answer")["error"] == "this question is not being played any more"
        second = post(server, "next")
        assert second["play"]["question_id"] == chosen(store)[1] and second["play"]["looks"] == []
        looked = look(server, second, frame, 90.0)
        again = post(server, "next")
        assert again["play"] == looked["play"], "nobody skips a question, or begins it anew with all looks"

        episode = bench.episode(chosen(store)[0])
        moves = [(frame, 90.0), (frame, 90.5), (none, 90)]
        for own in [None, *moves, 99, 2]:
            try:
                if isinstance(own, tuple):
                    episode.observe(*own)
                else:
                    episode.submit(own or 1, [{"frame_id": f"{frame:06d}", "bbox": box}])
            except Exception as error:
                assert type(error).__name__ == "RefusedError"
        expected = episode.finished()
    rows = read_table(store.run_path("human-a") / "predictions.parquet").to_pylist()
    assert [row["question_id"] for row in rows] == chosen(store)[:1]
    assert (rows[0]["status"], json.loads(rows[0]["answer"])) == ("answered", {"choice": 2})
    assert rows[0]["n_observations"] == expected.n_observations == 1
    assert rows[0]["n_model_calls"] == expected.n_model_calls == 6
    assert tuple(rows[0][f"evidence_{key}"] for key in "xywh") == expected.evidence.box
    steps = read_table(store.run_path("human-a") / "steps.parquet").to_pylist()
    assert {step["kind"] for step in steps} == {"observe", "solve"}


def test_a_run_goes_on_and_is_reported(small_demo, store):
    for name, choices in (("human-a", (1, 2)), ("human-b", (1, 3))):
        with playing(store, name, 1) as (bench, run), serving(HumanDesk(bench, run, "").respond) as server:
            state = post(server, "state")
            answer(server, look(server, state, state["play"]["frames"][0], 10), choices[0], [1, 1, 9, 9])
            assert "play" not in post(server, "next")
        with pytest.raises(StoreError, match="--resume"), playing(store, name):
            pass
        with playing(store, name, resume=True) as (bench, run), serving(HumanDesk(bench, run, "").respond) as server:
            state = post(server, "state")
            assert state["play"]["question_id"] == chosen(store)[1] and state["due"] == 1
            answer(server, look(server, state, state["play"]["frames"][0], 10), choices[1], [1, 1, 9, 9])
    found = report(store)
    assert {row["run"]: row["method"] for row in found.table() if row["run"].startswith("human")} == {
        "human-a": HUMAN,
        "human-b": HUMAN,
    }
    (row,) = found.table("people")
    assert (row["first"], row["second"], row["n"], row["same_answer"]) == ("human-a", "human-b", 2, 50.0)


def test_an_answer_that_the_disk_refuses_is_kept_until_it_is_written(store, monkeypatch):
    with playing(store, number=1) as (bench, run), serving(HumanDesk(bench, run, "").respond) as server:
        state = post(server, "state")
        state = look(server, state, state["play"]["frames"][0], 10)
        with monkeypatch.context() as patch:
            patch.setattr(run, "append", full_disk)
            assert (answer(server, state, 1, [1, 1, 9, 9]), post(server, "next")) == (404, 404)
            assert post(server, "state")["play"]["over"] and not run.finished
        assert "play" not in post(server, "next") and run.finished[chosen(store, 1)[0]].prediction["answer"]


def full_disk(entry):
    raise StoreError("no space left")


def test_a_refused_answer_that_ends_the_question_was_not_taken(store):
    with playing(store, number=1) as (bench, run), serving(HumanDesk(bench, run, "").respond) as server:
        state = post(server, "state")
        state = look(server, state, state["play"]["frames"][0], 10)
        for over in (False, True):
            found = answer(server, state, 99, [1, 1, 9, 9])["play"]
            assert (found["over"], found["answered"]) == (over, False)


def test_a_move_after_the_end_of_the_run_is_told_so(store):
    with playing(store, number=2) as (bench, run), serving(HumanDesk(bench, run, "").respond) as server:
        state = post(server, "state")
        answer(server, look(server, state, state["play"]["frames"][0], 10), 1, [1, 1, 9, 9])
        state = post(server, "next")
        seen = look(server, state, state["play"]["frames"][0], 10)
        run.finish()
        assert answer(server, seen, 1, [1, 1, 9, 9]) == 404
    rows = read_table(store.run_path("human-a") / "predictions.parquet")
    assert rows["question_id"].to_pylist() == list(run.finished) == chosen(store, 1)


def test_what_is_no_move_is_refused(store):
    with playing(store) as (bench, run), serving(HumanDesk(bench, run, "").respond) as server:
        state = post(server, "state")
        name = state["play"]["question_id"]
        for body in (b"", b"[]", b"{", b"[" * 30_000, b'{"question_id":1,"move":{}}', b"\xff", b'{"question_id":"x"}'):
            assert post(server, "move", body) == 404
        for path in (
            "look",
            "look?number=0",
            f"look?question={name}&number=0",
            f"look?question={name}&number=-1",
            "journal/painted.jsonl",
        ):
            assert fetch(server, path)[0] == 404
        for path in ("state", "next", "move"):
            assert fetch(server, path)[0] == 404, "pages of others cannot make the browser move by a link"
        assert post(server, "state")["play"]["left"] == {"looks": 24, "moves": 50}, "none of these cost a move"
        odd = move(server, state, action=["x"], frame_id={"a": 1})
        assert odd["error"] and odd["play"]["left"]["moves"] == 49
        assert move(server, {"play": {"question_id": "other"}}, action="answer")["play"]["left"]["moves"] == 49
    assert not (store.run_path("human-a") / "predictions.parquet").exists()


@pytest.mark.slow
def test_a_person_drags_looks_boxes_and_answers(store, tmp_path):
    from selenium.webdriver import ActionChains, Keys
    from selenium.webdriver.support.ui import WebDriverWait

    path = store.question_path("questions")
    questions = read_table(path)
    texts = [f"{HOSTILE} {text}" for text in questions["question"].to_pylist()]
    place = questions.column_names.index("question")
    store.write_questions("questions", questions.set_column(place, questions.schema.field(place), [texts]), {})
    with (
        playing(store) as (bench, run),
        serving(HumanDesk(bench, run, render("play.html", who=HOSTILE)).respond) as server,
        browser(tmp_path) as driver,
    ):

        def element(name):
            return driver.find_element("id", name)

        def until(condition):
            WebDriverWait(driver, 60, 0.02).until(lambda _: condition())

        driver.get(server.url)
        until(lambda: element("question").text)
        assert (
            HOSTILE in element("question").text
            and driver.title != "hit"
            and not driver.find_elements("tag name", "img")
        )
        assert not element("submit").is_enabled()
        frames = bench.sequences[bench.questions[0].sequence].frames
        strip = element("strip")
        width = strip.rect["width"]
        # From the middle, 180 degrees, an eighth of the strip to the left is 135.
        ActionChains(driver).move_to_element(strip).click_and_hold().move_by_offset(
            -round(width / 8), 0
        ).release().perform()
        driver.find_element("tag name", "body").send_keys(Keys.ARROW_RIGHT)
        element("goto").send_keys(Keys.CONTROL, "a")
        element("goto").send_keys(str(frames[2] + 1), Keys.TAB)
        element("look").click()
        until(lambda: element("left").text == "23 looks, 49 turns left")
        (seen,) = [json.loads(step.response) for step in run_steps(server)]
        assert int(seen["frame_id"]) == frames[2] and seen["angle_deg"] == pytest.approx(140, abs=0.5)
        assert len(driver.find_elements("css selector", "#sofar image")) == 1
        element("look").click()
        until(lambda: "The repeated look cost nothing" in element("error").text)
        # A question half played is there again after the page was closed.
        driver.get(server.url)
        until(lambda: element("left").text == "23 looks, 49 turns left")
        view = element("view")
        driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", view)
        side = view.rect["width"]
        drag = ActionChains(driver).move_to_element_with_offset(view, round(side / 4), round(side / 4)).click_and_hold()
        drag.move_by_offset(-round(side / 2), -round(side / 4)).release().perform()
        assert "the answer" in element("need").text and "box" not in element("need").text
        choice = driver.find_elements("css selector", "#fields input")[2]
        driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", choice)
        choice.click()
        assert element("need").text == "" and element("submit").is_enabled()
        element("submit").click()
        until(lambda: element("over").is_displayed())
        element("next").click()
        until(lambda: element("left").text == "24 looks, 50 turns left")
        assert element("progress").text == "1 of 2 questions answered" and not element("submit").is_enabled()
        assert complaints(driver) == []
    (row,) = read_table(store.run_path("human-a") / "predictions.parquet").to_pylist()
    assert json.loads(row["answer"]) == {"choice": 3} and row["evidence_frame"] == frames[2]
    # The box is from a quarter to three quarters across, and from a half to three quarters down.
    left = round(140 / 360 * 3760) - 240
    expected = (left + 120, 240, 240, 120)
    assert [row[f"evidence_{key}"] for key in "xywh"] == pytest.approx(expected, abs=8)


def run_steps(server):
    """The steps of the question that a server's desk has open."""
    return server.respond.__self__._play.steps
