"""`view`: what is private stays so without answers, texts are texts, and questions, frames and winners are found."""

import json
import re
import shutil

import msgspec
import pytest
from browser import browser, complaints, fetch, serving
from question_files import rewrite
from scored_runs import BOX, CASES, ELSEWHERE, stored_failures
from traced_runs import HOSTILE, PERSON, stored_run, trace_runs
from twin_runs import twin_store

from jrdb_avr.engine.pages.view import SCORE_OUTCOMES, Viewer, address
from jrdb_avr.engine.report.comparison import report, score
from jrdb_avr.queries.runs import read_run_manifest, write_run_manifest
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.schema.errors import AvrWarning, StoreError


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("browser")) as driver:
        yield driver


@pytest.fixture(scope="module")
def hostile(sample_benchmark, tmp_path_factory):
    """A store of runs with hostile texts, and its first question."""
    path = tmp_path_factory.mktemp("hostile") / "S"
    shutil.copytree(sample_benchmark.path, path)
    store = Store(path)
    return store, trace_runs(store)


PRIVATE_PARTS = ("questions/answers.parquet", "questions/evidence", "annotations", "intervals", "graph.kuzu")


def addresses(viewer, question):
    """All kinds of pages of a store, and some that do not exist."""
    runs = list(viewer.runs)
    asked = [own.question_id for own in viewer.questions]
    yield from (
        "",
        "?cause=wrong+person",
        address("", outcome=SCORE_OUTCOMES[0])[2:],
        f"?family={viewer.questions[0].family}",
        "?page=9",
    )
    yield from (address("question", id=name) for name in asked[:5])
    yield from (address("question", id=question, run=name) for name in [*runs, "none"])
    yield from (address("compare", first=runs[0], second=name, score="answer") for name in [*runs, "none"])
    yield from (address("trace", run=name, id=question) for name in runs)
    yield from (
        "report",
        "answers.parquet",
        "questions/answers.parquet",
        "../answers.parquet",
        "question?id=" + "x" * 99,
    )


def test_the_true_answer_needs_no_run(hostile):
    store, question = hostile
    with serving(Viewer(store, None, report(store)).respond) as server:
        texts = [fetch(server, address("question", id=question, **run))[1] for run in ({}, {"run": "none"})]
    parts = (text.partition('id="true"')[:2] for text in texts)
    assert [('id="given"' in before, bool(true)) for before, true in parts] == [(True, True), (False, True)]


def test_without_answers_nothing_private_is_opened(hostile, tmp_path):
    """Byte for byte the same responses where the private files are gone."""
    store, question = hostile
    bare = Store(tmp_path / "bare")
    shutil.copytree(store.path, bare.path)
    score(store)
    for part in PRIVATE_PARTS:
        (shutil.rmtree if (bare.path / part).is_dir() else (lambda path: path.unlink(missing_ok=True)))(
            bare.path / part
        )
    with_scores = Viewer(store, None, report(store))
    viewers = [Viewer(own, None, None) for own in (store, bare)]
    told = 0
    with (
        serving(viewers[0].respond) as first,
        serving(viewers[1].respond) as second,
        serving(with_scores.respond) as all_,
    ):
        for path in addresses(viewers[0], question):
            found = fetch(first, path)
            assert found == fetch(second, path), path
            told += found != fetch(all_, path)
            assert not any(
                mark in found[1] for mark in ("\N{CHECK MARK}", "\N{BALLOT X}", "true answer", '"target"')
            ), path
        assert told > 10, "the same pages tell more with answers"
        assert fetch(first, "?outcome=both+right&cause=nobody") == fetch(first), "nobody can filter by what is private"
        for page in ("report", address("trace", run="full", id=question)):
            assert (fetch(first, page)[0], fetch(all_, page)[0]) == (404, 200)


def test_no_path_leads_out_of_the_pictures(small_demo):
    folder = small_demo.folder
    store = Store(folder / "store")
    viewer = Viewer(store, store.manifest().image_root, None)
    name, info = next(iter(viewer.sequences.items()))
    with serving(viewer.respond) as server:
        picture = address("panorama", sequence=name, frame=str(info.frames[0]))
        assert fetch(server, picture)[0] == 200
        for sequence, frame in (("..", "0"), (f"../{name}", "0"), (f"{name}/../{name}", "0"), ("/etc", "0"), ("", "0")):
            assert fetch(server, address("panorama", sequence=sequence, frame=frame))[0] == 404
        for frame in ("-1", "1e0", "../0", "0.jpg", "9" * 30, "\u0663", ""):
            assert fetch(server, address("panorama", sequence=name, frame=frame))[0] == 404
        for path in ("../", "%2e%2e/", "..%2f..%2fetc/passwd", "store.json", "view.js", "question/../", "//etc/passwd"):
            assert fetch(server, path)[0] == 404, path


def test_texts_of_models_are_text(opened, hostile):
    store, question = hostile
    driver = opened
    viewer = Viewer(store, None, report(store))
    with serving(viewer.respond) as server:
        for path in (
            "",
            *(address("question", id=question, run=name) for name in viewer.runs),
            "compare?first=full&second=empty",
        ):
            driver.get(server.url + path)
            assert complaints(driver) == [], path
            assert "hit" not in driver.title and not driver.find_elements("css selector", "img"), path
            assert driver.execute_script("return document.documentElement.scrollWidth <= innerWidth"), path
        driver.get(server.url + address("question", id=question, run="full"))
        text = driver.find_element("tag name", "main").text
        assert "no pictures" in text and HOSTILE[:20] in text and "\u202e" not in driver.page_source
        people = [own.text for own in driver.find_elements("css selector", ".step b.person")]
        assert people[:2] == ["p1", "p1"] and people[2].startswith(PERSON[:20])


@pytest.fixture(scope="module")
def failures(tmp_path_factory):
    """Run r, which fails in each way once, and run s, which answers and boxes rightly only where r has no box."""
    path = tmp_path_factory.mktemp("failures") / "S"
    _, _, store = stored_failures(path, families=("long_range", "chain_2hop"))
    manifest = read_run_manifest(store, "r")
    write_run_manifest(store, msgspec.structs.replace(manifest, run_id="s", method="agent", model="other"))
    rows = read_table(store.run_path("r") / "predictions.parquet").to_pylist()
    for row in rows:
        box = BOX if row["question_id"] == "no box" else ELSEWHERE
        row |= {"run_id": "s", "evidence_frame": 7} | {f"evidence_{key}": v for key, v in zip("xywh", box, strict=True)}
        row |= {"answer": '{"choice":1}' if row["question_id"] in ("no box", "loose") else '{"choice":2}'}
    table = read_table(store.run_path("r") / "predictions.parquet")
    store.write_run("s", "predictions", type(table).from_pylist(rows, table.schema))
    store.write_run("s", "steps", read_table(store.run_path("r") / "steps.parquet").slice(0, 0))
    return store


def test_questions_are_found_by_outcome_and_cause(failures):
    viewer = Viewer(failures, None, report(failures))
    causes = {name: cause for name, (_, _, cause) in CASES.items() if cause}
    assert viewer.runs["r"].causes == causes
    assert viewer.runs["r"].outcome("scores") == "both right" and viewer.runs["r"].outcome("loose") == "answer only"
    assert viewer.runs["s"].outcome("no box") == "both right" and viewer.runs["s"].outcome("nobody") == "both wrong"
    assert viewer.runs["s"].outcome("unheard of") == ""
    with serving(viewer.respond) as server:

        def listed(**values):
            page = fetch(server, address("", **values).removeprefix("./"))[1]
            return {name for name in CASES if f'href="{address("question", id=name)}"'.replace("&", "&amp;") in page}

        assert listed() == set(CASES)
        for cause in set(causes.values()):
            assert listed(run="r", cause=cause) == {name for name, own in causes.items() if own == cause}
        assert listed(run="r", outcome="both right") == {"scores"}
        assert listed(outcome="both right") == {"scores", "no box"}, "of any run on the page"
        assert listed(run="s", outcome="answer only", cause="nobody") | {"loose"} == {"loose"}
        assert listed(family="no such family") == set()


def test_a_time_twin_is_shown_beside_its_question_with_the_time_that_differs(tmp_path):
    store = twin_store(tmp_path)

    def page(viewer, question):
        with serving(viewer.respond) as server:
            return fetch(server, address("question", id=question).removeprefix("./"))[1]

    scored, public = Viewer(store, None, report(store)), Viewer(store, None, None)
    text = page(scored, "b1")
    assert re.findall("<mark>(.*?)</mark>", text) == ["8.0 s (frame 120)", "9.0 s (frame 135)"]
    assert f'href="{address("question", id="b2", run="r")}"'.replace("&", "&amp;") in text
    # The run has both answers right, and of its boxes the first.
    words = " ".join(re.sub("<.*?>", " ", text).split())
    assert "answered 0 ✓ ✓ ✓ ✗ never looked there" in words
    assert len(re.findall('<ol class="choices">', text)) == 2
    # Both true answers are shown even if the steps of the run are missing, as they are of imported predictions.
    (store.run_path("r") / "steps.parquet").unlink()
    assert len(re.findall('<li class="right', page(scored, "b1"))) == 2
    # A question without a twin, and pages without answers, say nothing of twins.
    for viewer, question in ((scored, "e"), (public, "b1"), (public, "e")):
        text = page(viewer, question)
        assert "<mark>" not in text and 'class="twins"' not in text and "win:" not in text
    rewrite(store, "answers", lambda rows: rows[-1].update(twin_id="b"))
    with pytest.warns(AvrWarning, match="twin_id b: not on exactly two questions"):
        assert "<mark>" not in page(Viewer(store, None, report(store)), "b1")


@pytest.mark.slow
def test_two_runs_are_compared_question_by_question(opened, failures):
    driver = opened
    with serving(Viewer(failures, None, report(failures)).respond) as server:

        def counts(**values):
            driver.get(server.url + address("compare", **values))
            assert complaints(driver) == []
            return [
                int(cell.text) for cell in driver.find_elements("css selector", "table tbody tr:first-child td.num b")
            ]

        others = len(CASES) - 2
        assert counts(first="r", second="s") == [1, 1, 0, others]
        groups = driver.find_elements("css selector", "details.group")
        assert [own.get_attribute("open") is not None for own in groups] == [True, True, False, False]
        assert counts(first="s", second="r") == [1, 1, 0, others]
        assert counts(first="r", second="s", score="answer") == [len(CASES) - 2, 0, 2, 0]
    with serving(Viewer(failures, None, None).respond) as server:
        assert counts(first="r", second="s") == [others, 2]
        assert counts(first="r", second="r") == [0, len(CASES)]


def test_a_question_is_looked_through_by_keyboard(opened, small_demo):
    from selenium.webdriver import ActionChains, Keys
    from selenium.webdriver.support.ui import WebDriverWait

    driver = opened
    store = Store(small_demo.folder / "store")
    viewer = Viewer(store, store.manifest().image_root, report(store))
    (run,) = viewer.runs.values()
    question = next(iter(run.predictions))
    row = run.predictions[question]

    def press(*keys):
        ActionChains(driver).send_keys(*keys).perform()

    def frame():
        return int(driver.find_element("id", "frame").text.split()[1])

    def until(condition):
        WebDriverWait(driver, 60, 0.02).until(lambda _: condition())

    def pictured():
        return f"frame={frame()}" in (driver.find_element("id", "picture").get_attribute("href") or "").split("&")

    with serving(viewer.respond) as server:
        driver.get(server.url)
        assert complaints(driver) == []
        driver.find_element("css selector", f'a[href*="id={question}&run="], a[href*="id={question}"]').click()
        until(lambda: driver.find_elements("id", "frame"))
        frames = viewer.sequences[viewer.questions[0].sequence].frames
        # It begins where the run has its box, with the box, the target's, and the looks of that frame.
        assert frame() == row["evidence_frame"]
        until(pictured)
        assert driver.find_elements("css selector", "#overlay rect.given")
        assert driver.find_elements("css selector", "#overlay rect.target")
        assert driver.find_elements("css selector", "#overlay rect.look")
        place = frames.index(frame())
        press(Keys.ARROW_LEFT, Keys.ARROW_LEFT, Keys.ARROW_RIGHT)
        assert frame() == frames[max(place - 2, 0) + 1]
        driver.find_element("id", "scrub").send_keys(Keys.HOME)
        until(lambda: frame() == frames[0])
        press("n")
        looked = sorted({json.loads(step["response"])["frame_id"] for step in _looks(store, run.name, question)})
        assert frame() in {int(own) for own in looked}
        # It plays on until it is stopped, and the end is the end.
        driver.execute_script("scrub.value = arguments[0]; scrub.dispatchEvent(new Event('input'))", len(frames) - 3)
        press(" ")
        until(lambda: frame() == frames[-1] and driver.find_element("id", "play").text == "play")
        until(pictured)
        driver.execute_script("scrub.value = 0; scrub.dispatchEvent(new Event('input'))")
        press(" ")
        until(lambda: frame() != frames[0])
        press(" ")
        assert driver.find_element("id", "play").text == "play"
        button = driver.find_elements("css selector", ".step button.jump")[-1]
        driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", button)
        button.click()
        assert frame() == int(button.get_attribute("data-frame"))
        # The arrows belong to the panorama while it is zoomed, and to the frames otherwise.
        panorama = driver.find_element("css selector", ".zoomable > svg")
        before = frame()
        panorama.click()
        press("+", Keys.ARROW_RIGHT)
        place = driver.execute_script("return arguments[0].getAttribute('viewBox')", panorama)
        assert frame() == before and float(place.split()[2]) == pytest.approx(3760 / 1.5)
        press("0", Keys.ARROW_LEFT)
        assert frame() != before
        top = driver.execute_script("return document.getElementById('stage').getBoundingClientRect().top")
        assert abs(top) < 1, "the panorama stays in view below"
        assert complaints(driver) == []


def _looks(store, run, question):
    rows = read_table(store.run_path(run) / "steps.parquet").to_pylist()
    return [row for row in rows if row["question_id"] == question and row["kind"] == "observe"]


@pytest.mark.slow
def test_the_report_leads_to_runs_and_pairs(opened, failures):
    driver = opened
    with serving(Viewer(failures, None, report(failures)).respond) as server:
        driver.get(server.url + "report")
        driver.find_element("css selector", ".runs tbody a").click()
        assert driver.title == "JRDB-AVR: runs"
        driver.get(server.url + "report")
        driver.find_element("css selector", "#pairs ~ details tbody a").click()
        assert driver.find_element("tag name", "h1").text in ("r and s", "s and r")
        assert complaints(driver) == []


@pytest.mark.slow
def test_the_report_is_sorted_and_filtered(opened, failures):
    from selenium.webdriver import Keys
    from selenium.webdriver.support.ui import Select

    driver = opened

    def visible(selector):
        found = "[...document.querySelectorAll(arguments[0])].filter((own) => own.getClientRects().length)"
        return driver.execute_script(f"return {found}.map((own) => own.innerText ?? own.textContent)", selector)

    def column(table, place):
        return [text.split()[0] for text in visible(f"{table} tbody tr > :nth-child({place + 1})")]

    def head(table, place):
        return driver.find_elements("css selector", f"{table} thead tr:last-child th")[place]

    def choose(name, text):
        Select(driver.find_element("css selector", f"[data-filter={name}]")).select_by_value(text)

    comparison = report(failures)
    with serving(Viewer(failures, None, comparison).respond) as server:
        driver.get(server.url + "report")
        # Words by the alphabet first, numbers the largest first; the keyboard sorts too.
        for expected, order in ((["r", "s"], "ascending"), (["s", "r"], "descending")):
            head(".runs", 0).find_element("tag name", "button").click()
            assert (column(".runs", 0), head(".runs", 0).get_attribute("aria-sort")) == (expected, order)
        shares = sorted((row["evidence"] for row in comparison.table()), reverse=True)
        for expected, order in ((shares, "descending"), (shares[::-1], "ascending")):
            head(".runs", 3).find_element("tag name", "button").send_keys(Keys.ENTER)
            assert [float(text) for text in column(".runs", 3)] == pytest.approx(expected, abs=0.051)
            assert head(".runs", 3).get_attribute("aria-sort") == order
        assert not head(".runs", 2).get_attribute("aria-sort")
        # A cell of a small picture is sorted by its combined score.
        head(".multiples", 2).find_element("tag name", "button").click()
        family = head(".multiples", 2).get_attribute("data-family")
        rows = {row["run"]: row["combined"] for row in comparison.table("family") if row["family"] == family}
        found = [rows[name] for name in column(".multiples", 0)]
        assert found == sorted(found, reverse=True) and len(set(found)) == 2

        pairs = len(driver.find_elements("css selector", "#pairs ~ details tbody tr"))
        choose("method", "agent")
        assert column(".runs", 0) == column(".multiples", 0) == ["s"]
        assert [text.split()[0] for text in visible("#breakdowns ~ details[open] .crossed thead th")] == ["family", "s"]
        assert driver.find_element("id", "found").text == "1 of 2 runs"
        assert len(visible(".square circle")) == 1
        assert len(visible("#pairs ~ details tbody tr")) == pairs == 1, "a pair stays with either of its runs"
        choose("family", "chain_2hop")
        assert visible(".multiples thead button") == ["run", "chain 2hop"]
        assert column("#breakdowns ~ details[open] .crossed", 0) == ["chain_2hop"]
        choose("model", "m")
        assert column(".runs", 0) == []
        choose("method", "")
        assert column(".runs", 0) == ["r"]
        # One decimal everywhere but in p.
        texts = driver.execute_script(
            "return [...document.querySelectorAll('td.num, td.num *, svg title')].flatMap((own) => [...own.childNodes])"
            ".filter((node) => node.nodeType === 3).map((node) => node.data)"
        )
        numbers = re.findall(r"(?<!p )(?<![\d.<])\d+\.\d+", "\n".join(texts))
        assert len(numbers) > 100 and [own for own in numbers if not re.fullmatch(r"\d+\.\d", own)] == []
        assert complaints(driver) == []


def test_what_is_missing_is_said(sample_benchmark, benchmark_copy):
    viewer = Viewer(sample_benchmark, None, None)
    name = viewer.questions[0].question_id
    with serving(viewer.respond) as server:
        status, text = fetch(server, address("question", id=name))
        assert status == 200 and "no pictures" in text and "Steps" not in text
        assert "does not have this question" in fetch(server, address("question", id=name, run="x"))[1]
        assert fetch(server, "question", method="POST", body=b"")[0] == 404
    with pytest.raises(StoreError, match="no runs yet"):
        report(sample_benchmark)
    stored_run(benchmark_copy, "mine", steps=[])
    (benchmark_copy.run_path("mine") / "steps.parquet").unlink()
    viewer = Viewer(benchmark_copy, None, None)
    with serving(viewer.respond) as server:
        assert "cannot read" in fetch(server, address("question", id=name, run="mine"))[1]
