"""The pages in a real browser: nothing on the console, nothing fetched, and the keyboard works."""

import base64
import contextlib
import json
import re
from xml.etree import ElementTree

import msgspec
import numpy as np
import pyarrow as pa
import pytest
from browser import browser, complaints
from processes import run
from scored_runs import stored_failures
from traced_runs import trace_runs

from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.engine.pages.inspect import (
    choose_questions,
    close_up,
    inspect_page,
    inspect_questions,
    nearest_annotated,
)
from jrdb_avr.engine.pages.page import environment, readable, render, write_page
from jrdb_avr.engine.pages.report import Crossed, pivot
from jrdb_avr.engine.pages.reviews import read_reviews
from jrdb_avr.engine.pages.svg import PlanGraph, scatter, wrapped
from jrdb_avr.engine.pages.timeline import Stretch, TimelineRow, runs_of
from jrdb_avr.engine.report.bundle import write_bundle
from jrdb_avr.queries.questions import read_sequences
from jrdb_avr.queries.runs import read_run_manifest, write_run_manifest
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.tables import RUNS

HOSTILE = '</script><script>document.title="hit"</script><img src=x onerror=\'document.title="hit"\'>\x1b[31m'


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser")
    with browser(folder) as driver:
        yield driver, folder


def visit(driver, path):
    driver.get(path.as_uri())
    assert complaints(driver) == []
    # Nothing but the file itself has been asked for.
    fetched = driver.execute_script("return performance.getEntriesByType('resource').map(e => e.name)")
    assert [name for name in fetched if not name.startswith("data:")] == []


@contextlib.contextmanager
def narrow(driver, width=400):
    """The window of a telephone."""
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        yield
    finally:
        driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@contextlib.contextmanager
def emulated(driver, *features):
    """What the reader likes, or that it is printed."""
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": list(features)})
    try:
        yield
    finally:
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})


def shown(driver, selector):
    return driver.find_elements("css selector", selector)


# -- the report -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Two runs in a store, one of them with hostile texts wherever a text can stand."""
    path = tmp_path_factory.mktemp("report")
    stored_failures(path / "S", settings={"model": HOSTILE})
    code, _, err = run("report", "--store", path / "S", "--paper", "--html", path / "report.html")
    assert code == 0, err
    return path / "report.html"


@pytest.mark.slow
def test_each_row_of_the_budgets_of_looks_has_the_cells_of_the_header(benchmark_copy, tmp_path):
    for looks in (2, 3):
        options = ("--model", "simulated:perfect", "--limit", 2, "--looks", looks, "--run-id", f"of-{looks}")
        assert run("evaluate", "--store", benchmark_copy.path, "--method", "react", *options)[0] == 0
    assert run("report", "--store", benchmark_copy.path, "--html", tmp_path / "report.html")[0] == 0
    text = (tmp_path / "report.html").read_text("utf-8")
    assert "Budget of looks" in text
    for shown_table in re.findall(r'<table class="plain.*?</table>', text, re.DOTALL):
        rows = re.findall(r"<tr.*?</tr>", shown_table, re.DOTALL)
        assert len({len(re.findall(r"<t[dh][ >]", row)) for row in rows}) == 1


def test_the_report_shows_its_tables_and_nothing_else_runs(opened, report):
    driver, _ = opened
    visit(driver, report)
    assert driver.title == "JRDB-AVR report"
    assert not shown(driver, "img")
    assert [row.text.split()[0] for row in shown(driver, "h2 + .scroll tbody tr")][:1] == ["r"]
    assert len(shown(driver, ".intervals .answer circle")) == 1
    # Intervals and bars are to scale, in percent.
    _, out, _ = run("report", "--store", report.parent / "S", "--table", "all", "--json")
    rows = json.loads(out)
    (main,) = (row for row in rows if row["table"] == "main")
    for kind in ("answer", "evidence", "combined"):
        (span,) = shown(driver, f".intervals .{kind} line.span")
        (at,) = shown(driver, f".intervals .{kind} svg.at")
        ends = [float(span.get_attribute(name).removesuffix("%")) for name in ("x1", "x2")]
        one = main[f"{kind}_low"] is None
        assert ends == [main[kind if one else f"{kind}_{end}"] for end in ("low", "high")]
        assert at.get_attribute("x") == f"{main[kind]}%"
    causes = [row for row in rows if row["table"] == "evidence_failures" and row["times"]]
    parts = [[float(p.get_attribute(name)) for name in ("x", "width")] for p in shown(driver, "svg.stack rect")]
    assert [width for _, width in parts] == pytest.approx([100 * row["times"] / row["n"] for row in causes], abs=0.01)
    assert [x for x, _ in parts[1:]] == pytest.approx([x + width for x, width in parts[:-1]], abs=0.01)
    assert "right person, loose box" in driver.find_element("tag name", "main").text


def test_pages_are_readable_on_a_small_screen(opened, report):
    driver, _ = opened
    with narrow(driver):
        visit(driver, report)
        assert driver.execute_script("return document.documentElement.scrollWidth") == 400


def test_a_page_is_dark_where_the_reader_likes_it(opened, report):
    driver, _ = opened
    with emulated(driver, {"name": "prefers-color-scheme", "value": "dark"}):
        visit(driver, report)
        color = driver.execute_script("return getComputedStyle(document.body).backgroundColor")
    assert sum(map(int, re.findall(r"\d+", color))) < 150


def test_paper_has_no_controls_and_is_light(opened, report, inspected):
    driver, _ = opened
    controls = "[...document.querySelectorAll('select, input, dialog, header, nav, .zoom, .seconds, article button')]"
    for page in (report, inspected):
        visit(driver, page)
        dark = {"name": "prefers-color-scheme", "value": "dark"}
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print", "features": [dark]})
        found = driver.execute_script(
            f"return [{controls}.filter((own) => own.getClientRects().length).length,"
            "getComputedStyle(document.body).backgroundColor,"
            "[...document.querySelectorAll('figure, svg')].map((own) => getComputedStyle(own).breakInside)]"
        )
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})
        assert found[:2] == [0, "rgb(255, 255, 255)"] and set(found[2]) == {"avoid"}


# -- the leaderboard --------------------------------------------------------------------------------------------------


def test_the_leaderboard_ranks_and_shows_texts_of_bundles_as_text(opened, tmp_path):
    driver, _ = opened
    _, _, store = stored_failures(tmp_path / "S", settings={"model": HOSTILE, HOSTILE: 1})
    manifest = read_run_manifest(store, "r")
    for name, ids in (("hostile", manifest.question_ids), ("few", manifest.question_ids[:3])):
        own = msgspec.structs.replace(
            manifest, run_id=name, question_ids=ids, method=HOSTILE, model="<b>m", created=HOSTILE
        )
        write_run_manifest(store, own)
        rows = read_table(store.run_path("r") / "predictions.parquet").to_pylist()
        kept = [row for row in rows if row["question_id"] in ids]
        store.write_run(name, "predictions", pa.Table.from_pylist(kept, RUNS["predictions"]))
        write_bundle(store, name, tmp_path / f"<i>{name}")
    write_bundle(store, "r", tmp_path / "good")
    bundles = [tmp_path / name for name in ("<i>few", "<i>hostile", "good")]
    page = tmp_path / "board.html"
    code, _, err = run("report", "--store", store.path, "--leaderboard", *bundles, "--html", page)
    assert code == 0, err
    visit(driver, page)
    assert driver.title == "JRDB-AVR leaderboard" and not shown(driver, "img, i, tbody b b")
    rows = [
        [cell.text for cell in row.find_elements("css selector", "th, td")] for row in shown(driver, ".board tbody tr")
    ]
    board = json.loads(run("report", "--store", store.path, "--leaderboard", *bundles, "--json")[1])
    # Each row says its rank, its scores and of which questions they are; the sets are apart.
    assert [(row["rank"], row["run"], row["n"]) for row in board] == [(1, "hostile", 13), (1, "r", 13), (1, "few", 3)]
    for cells, row in zip(rows, board, strict=True):
        assert [cells[0], cells[1].split()[0], cells[2].split()[0]] == ["1", row["run"], f"{row['combined']:.1f}"]
        assert cells[-1].split() == [str(row["n"]), row["questions"][:8]]
    assert len({row["questions"] for row in board}) == len(shown(driver, ".board")) == 2
    with narrow(driver):
        visit(driver, page)
        assert driver.execute_script("return document.documentElement.scrollWidth") == 400


# -- inspect ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def inspected(sample_benchmark, tmp_path_factory):
    path = tmp_path_factory.mktemp("inspect") / "inspect.html"
    code, _, err = run("inspect", "--sample", 4, "--seed", 1, "--store", sample_benchmark.path, "--out", path)
    assert (code, err) == (0, f"wrote {path}: 4 questions\n")
    return path


def test_a_sample_is_seeded_and_of_the_filters(sample_benchmark, tmp_path):
    def drawn(seed):
        return choose_questions(ids, 3, seed)

    rows = sample_benchmark.questions("questions").to_pylist()
    ids = [row["question_id"] for row in rows]
    assert drawn(0) == drawn(0) != drawn(5)
    base = ("inspect", "--store", sample_benchmark.path, "--out", tmp_path / "page.html", "--json")
    family = rows[0]["family"]
    code, out, _ = run(*base, "--family", family, "--sample", 2)
    shown = {row["question_id"] for row in json.loads(out)}
    assert code == 0 and len(shown) == 2
    assert shown <= {row["question_id"] for row in rows if row["family"] == family}
    assert {row["question_id"] for row in json.loads(run(*base, ids[1], "--question", ids[0])[1])} == {*ids[:2]}
    assert run(*base)[0] == run(*base, "--family", "none")[0] + 1 == 2


def test_no_text_of_a_question_runs_or_breaks_the_page(opened, sample_benchmark, tmp_path):
    driver, _ = opened
    text = f"{HOSTILE}{{{{7*7}}}}\u202e{'x' * 10_000}"
    multiple = next(r for r in sample_benchmark.questions("questions").to_pylist() if r["choices"])
    (one,) = inspect_questions(sample_benchmark, [multiple["question_id"]])
    proofs = tuple(msgspec.structs.replace(proof, variant=text, answer=text) for proof in one.record.proofs)
    one.record = msgspec.structs.replace(one.record, question=text, choices=(text,) * 4, proofs=proofs)
    one.timeline = [row._replace(label=text) for row in one.timeline]
    html = inspect_page([one], Observer(None, read_sequences(sample_benchmark).values()), "0", lambda _: None)
    write_page(tmp_path / "h.html", html)
    with narrow(driver):
        visit(driver, tmp_path / "h.html")
        assert driver.execute_script("return document.documentElement.scrollWidth") == 400
    assert driver.title == "JRDB-AVR: 1 questions to inspect" and not shown(driver, "img")
    said = driver.find_element("class name", "question").text
    assert "{{7*7}}[U+202E]xxx" in said and "\u202e" not in html and "\x1b" not in html


@pytest.mark.slow
def test_questions_are_judged_by_keyboard_and_imported(opened, inspected, benchmark_copy):
    from selenium.webdriver import ActionChains, Keys
    from selenium.webdriver.support.ui import WebDriverWait

    driver, folder = opened
    wait = WebDriverWait(driver, 60, 0.02).until
    visit(driver, inspected)

    def press(*keys):
        for key in keys:
            ActionChains(driver).send_keys(key).perform()

    def count():
        return driver.find_element("id", "count").text

    def current():
        return [article.get_attribute("id") for article in shown(driver, "article.current")]

    assert (count(), current()) == ("0 of 4 decided: 0 accepted, 0 rejected", ["q1"])
    press("a")
    assert (count(), current()) == ("1 of 4 decided: 1 accepted, 0 rejected", ["q2"])
    press("r", "two people fit, a & b", Keys.ENTER)
    # The browser says that a dialog has closed after the key has been handled.
    wait(lambda _: count().startswith("2 of 4"))
    assert (count(), current()) == ("2 of 4 decided: 1 accepted, 1 rejected", ["q3"])
    press("j", "j", "j", "k")
    assert current() == ["q3"]
    press("a", "u")
    assert (count(), current()) == ("2 of 4 decided: 1 accepted, 1 rejected", ["q3"])
    press("r", Keys.ESCAPE)
    assert count().startswith("2 of 4")
    driver.find_element("id", "download").click()
    file = folder / "decisions.json"
    wait(lambda _: file.exists() and file.stat().st_size)
    names = [article.get_attribute("data-id") for article in shown(driver, "article")]
    assert [
        (row["question_id"], row["decision"], row["reason"]) for row in json.loads(file.read_text())["decisions"]
    ] == [
        (names[0], "accept", ""),
        (names[1], "reject", "two people fit, a & b"),
    ]
    assert complaints(driver) == []
    driver.get("about:blank")
    code, _, err = run("inspect", "--import", file, "--reviewer", "ada", "--store", benchmark_copy.path)
    assert code == 0, err
    assert {row["question_id"] for row in read_reviews(benchmark_copy)} == set(names[:2])
    # A page closed by mistake has lost nothing, until it is told to forget.
    visit(driver, inspected)
    assert count() == "2 of 4 decided: 1 accepted, 1 rejected"
    assert shown(driver, "article")[1].find_element("class name", "reason").text == "two people fit, a & b"
    driver.find_element("id", "anew").click()
    driver.switch_to.alert.accept()
    assert count().startswith("0 of 4")
    visit(driver, inspected)
    assert count().startswith("0 of 4")


@pytest.mark.slow
def test_what_a_browser_keeps_is_not_trusted(opened, inspected):
    """Another file's page may have written to the same shelf."""
    driver, _ = opened
    visit(driver, inspected)
    name = "`jrdb-avr inspect ${sha} ${[...document.querySelectorAll('article')].map(a => a.dataset.id).join()}`"
    sha = "const sha = JSON.parse(document.getElementById('about').textContent).questions_sha256;"
    for kept in ("{", "3", '[{"question_id": "x", "decision": "accept", "reason": ""}, null]'):
        driver.execute_script(f"{sha} localStorage.setItem({name}, arguments[0])", kept)
        visit(driver, inspected)
        assert driver.find_element("id", "count").text.startswith("0 of 4")
    driver.execute_script("localStorage.clear()")


def test_a_question_shows_answer_plan_people_and_proofs(opened, inspected, sample_benchmark):
    driver, _ = opened
    visit(driver, inspected)
    answers = {row["question_id"]: row for row in sample_benchmark.questions("answers").to_pylist()}
    for article in shown(driver, "article"):
        own = answers[article.get_attribute("data-id")]
        right = article.find_elements("css selector", "li.right")
        if right:
            place = article.find_elements("css selector", "ol.choices li").index(right[0])
            assert json.loads(own["answer"]) == {"choice": place + 1}
        else:
            said = article.find_element("css selector", "b.yes").text
            assert set(re.findall(r"\d+", said)) & set(re.findall(r"\d+", own["answer"]))
        plan = json.loads(own["plan"])
        assert len(article.find_elements("css selector", ".plan rect.node")) == len(plan["nodes"])
        assert len(article.find_elements("css selector", ".plan path.edge")) == len(
            {(e["source"], e["target"]) for e in plan["edges"]}
        )
        assert {m.text for m in article.find_elements("css selector", "text.moment")} == set(plan["times"])
        article.find_element("tag name", "summary").click()
        assert len(article.find_elements("css selector", "details tbody tr")) == len(json.loads(own["proofs"]))
        # This store has no pictures, and says so.
        assert "No picture" in article.text


def pressed(driver, *keys):
    from selenium.webdriver import ActionChains

    for key in keys:
        ActionChains(driver).send_keys(key).perform()


@pytest.mark.slow
def test_filters_leave_questions_out_and_the_keyboard_goes_past_them(opened, inspected):
    from selenium.webdriver.support.ui import Select

    driver, _ = opened
    visit(driver, inspected)
    articles = shown(driver, "article")

    def left():
        return [article for article in articles if article.is_displayed()]

    def current():
        return driver.find_element("css selector", "article.current")

    def choose(name, text):
        Select(driver.find_element("css selector", f"[data-filter={name}]")).select_by_visible_text(text)
        driver.find_element("tag name", "h1").click()

    template = articles[-1].get_attribute("data-template")
    choose("template", template)
    of_it = [article for article in articles if article.get_attribute("data-template") == template]
    assert left() == of_it and 0 < len(of_it) < 4
    assert driver.find_element("id", "found").text == f"{len(of_it)} of 4 shown" and current() == of_it[0]
    pressed(driver, "j", "j", "j", "j")
    assert current() == of_it[-1]
    pressed(driver, "k", "k", "k", "k")
    assert current() == of_it[0]
    choose("template", "all")
    choose("decision", "not decided")
    # A question that is decided leaves, and the next one comes; a field takes its letters.
    place = articles.index(current())
    pressed(driver, "a")
    assert left() == [article for article in articles if article != articles[place]] and current() in left()
    assert driver.find_element("id", "progress").get_attribute("value") == "1"
    driver.find_element("css selector", "[data-filter=decision]").send_keys("a")
    assert driver.find_element("id", "count").text.startswith("1 of 4 decided")
    choose("decision", "accepted")
    assert left() == [articles[place]]
    driver.execute_script("localStorage.clear()")


@pytest.fixture(scope="module")
def pictured(small_demo, tmp_path_factory):
    """An `inspect` page of one question with pictures: (path of the page, store, the inspected question)."""
    store = Store(small_demo.folder / "store")
    asked = store.questions("questions")["question_id"].to_pylist()
    one = next(one for one in inspect_questions(store, asked) if min(one.boxes) >= 15 and not one.counted)
    path = tmp_path_factory.mktemp("pictured") / "i.html"
    assert run("inspect", one.record.question_id, "--store", store.path, "--out", path)[0] == 0
    return path, store, one


def test_a_panorama_is_zoomed_turned_and_shown_again(opened, pictured):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
    from selenium.webdriver.support.ui import WebDriverWait

    driver, _ = opened
    visit(driver, pictured[0])
    svg = driver.find_element("css selector", ".zoomable > svg")
    driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", svg)

    def box():
        own = driver.execute_script("return arguments[0].getAttribute('viewBox')", svg)
        return [float(part) for part in own.split()]

    def click(label):
        driver.find_element("css selector", f".zoom [aria-label='{label}']").click()

    assert box() == [0, 0, 3760, 480]
    wheel = ScrollOrigin.from_element(svg, x_offset=int(svg.rect["width"] / 4))
    before = driver.execute_script("return scrollY")
    ActionChains(driver).scroll_from_origin(wheel, 0, -100).perform()
    WebDriverWait(driver, 60, 0.02).until(lambda _: driver.execute_script("return scrollY") < before)
    assert box()[2] == 3760, "the wheel scrolls the page until the panorama is clicked"
    driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", svg)
    ActionChains(driver).click(svg).perform()
    ActionChains(driver).scroll_from_origin(wheel, 0, -200).perform()
    WebDriverWait(driver, 60, 0.02).until(lambda _: box()[2] < 3760)
    left, top, wide, tall = box()
    assert wide == pytest.approx(3760 / 1.25**2) and (top, tall) == (0, 480)
    # What was under the pointer stays there.
    assert left + 0.75 * wide == pytest.approx(0.75 * 3760, abs=10)
    pressed(driver, "+")
    assert box()[2] == pytest.approx(wide / 1.5)
    click("Zoom in")
    assert box()[2] == pytest.approx(wide / 1.5**2)
    before = box()
    ActionChains(driver).drag_and_drop_by_offset(svg, -100, 0).perform()
    assert box()[0] == pytest.approx((before[0] + 100 * before[2] / svg.rect["width"]) % 3760, abs=10)
    click("Whole panorama")
    assert box() == [0, 0, 3760, 480]
    # It has no ends: on its left lies what is at its right end.
    ActionChains(driver).drag_and_drop_by_offset(svg, 200, 0).perform()
    assert box()[0] > 2900 and shown(driver, ".zoomable use[x='3760']")
    click("Zoom out")
    assert box()[0] == 0 and not shown(driver, ".zoomable use")
    click("Zoom in")
    driver.execute_script("dispatchEvent(new Event('beforeprint'))")
    assert box() == [0, 0, 3760, 480], "paper has all of it"
    # A telephone begins with a part, about the first box.
    with narrow(driver):
        visit(driver, pictured[0])
        svg = driver.find_element("css selector", ".zoomable > svg")
        left, _, wide, tall = box()
        first = next(own for _, own in pictured[2].boxes[min(pictured[2].boxes)])
        assert wide < 2000 and tall == 480 and 0 < (first.x - left) % 3760 < wide


def test_unknown_questions_are_refused(sample_benchmark, tmp_path):
    code, out, err = run("inspect", "0" * 16, "--store", sample_benchmark.path, "--out", tmp_path / "i.html")
    assert (code, out) == (1, "")
    assert err == f"jrdb-avr: question id '{'0' * 16}' is not in the store's questions\n"


# -- trace ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_sightings_appear_with_the_slider(opened, benchmark_copy, tmp_path):
    driver, _ = opened
    store, name = benchmark_copy, trace_runs(benchmark_copy)
    code, _, err = run("trace", "full", name, "--store", store.path, "--out", tmp_path / "t.html")
    assert (code, err) == (0, f"wrote {tmp_path / 't.html'}: 7 steps\n")
    driver.get((tmp_path / "t.html").as_uri())
    assert complaints(driver) == []
    assert "hit" not in driver.title and not driver.find_elements("css selector", "img")

    def visible(selector):
        return [e.text for e in driver.find_elements("css selector", selector) if e.is_displayed()]

    def at(step):
        driver.execute_script(
            "const s = document.getElementById('until'); s.value = arguments[0];s.dispatchEvent(new Event('input'))",
            step,
        )

    assert visible(".verdict b") == ["answer \N{BALLOT X}", "evidence \N{CHECK MARK}", "combined \N{BALLOT X}"]
    assert driver.find_element("css selector", "section.step h3").text.startswith("Turn 1: looked at")
    # Two looks have a known form, and one of them was refused.
    assert len(driver.find_elements("css selector", ".map rect.look")) == 2, "a crop over the seam is two parts"
    assert len(visible("circle.seen")) == 2 and len(visible("circle.given")) == 1
    at(1)
    assert visible("circle.seen") == []
    at(2)
    assert len(visible("circle.seen")) == 1
    assert driver.find_element("id", "at").text.startswith("2 of 6: Turn 2: wrote 1 person (p1 new)")
    # A text of ten thousand letters does not make the page wide.
    assert driver.execute_script("return document.documentElement.scrollWidth") <= 1250
    assert run("trace", "decided", name, "--store", store.path, "--out", tmp_path / "d.html")[0] == 0
    driver.get((tmp_path / "d.html").as_uri())
    assert complaints(driver) == [] and "hit" not in driver.title
    text = driver.find_element("tag name", "main").text
    assert "p1 is the likeliest A, the target: log-odds +3.5, 1.5 ahead of the next person." in text
    assert "sitting has log-odds 2.2. Verdict: supported." in text
    assert "The model proposed another answer, which the graph does not support: 1: " in text
    assert driver.find_element("css selector", ".plan .name").text == "A = p1, target"
    assert len(driver.find_elements("css selector", "table.bindings tbody tr")) == 2
    assert "212\N{DEGREE SIGN}: p1 may be there" in text
    for other in ("empty", "broken"):
        assert run("trace", other, name, "--store", store.path, "--out", tmp_path / "o.html")[0] == 0
        driver.get((tmp_path / "o.html").as_uri())
        assert complaints(driver) == []
        assert "The run has no steps for this question." in driver.find_element("tag name", "main").text


# -- diagrams ---------------------------------------------------------------------------------------------------------

PLAN = parse_plan(
    json.dumps(
        {
            "root": "a",
            "target": "d",
            "times": {"t0": {"frame": 30}},
            "nodes": [{"id": "a", "conditions": [{"attribute": "gender", "value": "male"}]}]
            + [{"id": node, "conditions": []} for node in "bcd"],
            "edges": [
                {"source": source, "relation": "conversation", "target": target, "at": "t0"}
                for source, target in ("ab", "ac", "bd", "cd")
            ],
            "answer": {"mode": "multiple_choice", "read": "action", "of": "d", "at": "t0"},
        }
    )
)


def test_a_plan_goes_from_left_to_right():
    graph = PlanGraph(PLAN)
    places = {node.role: (node.x, node.y) for node in graph.nodes}
    assert places["a"][0] < places["b"][0] == places["c"][0] < places["d"][0]
    assert places["b"][1] < places["a"][1] == places["d"][1] < places["c"][1]
    assert graph.nodes[0].lines == ("gender: male",)
    assert (graph.times, graph.reads) == (["t0: frame 30"], "action of d at t0")
    assert len(graph.edges) == 4


def plan_with(edges, nodes="abc", times=None):
    """Return a plan with the given edges between nodes without conditions."""
    return parse_plan(
        json.dumps(
            {
                "root": "a",
                "target": "a",
                "times": {"t0": {"frame": 30}} | (times or {}),
                "nodes": [{"id": node, "conditions": []} for node in nodes],
                "edges": [{"source": s, "target": t, "relation": r, "at": "t0"} for s, t, r in edges],
                "answer": {"mode": "multiple_choice", "read": "action", "of": "a", "at": "t0"},
            }
        )
    )


def test_all_relations_of_a_pair_share_a_line():
    (edge,) = PlanGraph(plan_with([("a", "b", "in front of"), ("a", "b", "conversation")], "ab")).edges
    assert edge.lines == ("in front of", "conversation")


@pytest.mark.parametrize(
    ("edges", "outside"),
    [
        ([("a", "b", "x"), ("b", "a", "y")], "below"),
        ([("a", "b", "x"), ("b", "c", "y"), ("c", "a", "z")], "below"),
        ([("a", "b", "x"), ("a", "c", "y"), ("b", "c", "z")], "right"),
    ],
)
def test_relations_that_do_not_lead_to_the_next_column_are_drawn_outside_the_nodes(edges, outside):
    graph = PlanGraph(plan_with(edges, sorted({node for edge in edges for node in edge[:2]})))
    last = graph.edges[-1]
    if outside == "below":
        assert max(node.y for node in graph.nodes) + graph.node_height < last.y <= graph.height
    else:
        assert max(node.x for node in graph.nodes) + 165 < last.x <= graph.width
    assert len({(edge.x, edge.y) for edge in graph.edges}) == len(edges)


def test_each_kind_of_time_has_words():
    times = {
        "t1": {"event": "start", "of": "a", "action": "walking", "after": "t0"},
        "t2": {"event": "leaves", "of": "a", "after": "t0"},
        "t3": {"after": "t0"},
    }
    graph = PlanGraph(plan_with([], "a", times))
    assert graph.times[1:] == [
        "t1: a starts walking after t0",
        "t2: a leaves after t0",
        "t3: some moment after t0",
    ]
    assert graph.nodes[0].lines == ("any person",)


def timeline(*values):
    """The timeline as drawn."""
    macro = environment().get_template("diagrams.html").module.timeline_svg
    return ElementTree.fromstring(str(macro(*values, roles={"a": 0, "b": 1})))


def attributes(drawn, tag, kind, *names):
    found = (e for e in drawn.iter(tag) if kind in e.get("class", "").split())
    return [tuple(float(e.get(name)) for name in names) for e in found]


def test_a_timeline_is_to_scale():
    spans = (Stretch(0, 49, "action"), Stretch(50, 99, "action", False))
    drawn = timeline([TimelineRow("a", "walking", spans), TimelineRow("b", "x", ())], {"t1": 50, "t0": 0}, 100, 15.0)
    (first, wide), (second, as_wide) = attributes(drawn, "rect", "bar", "x", "width")
    assert wide == pytest.approx(as_wide, abs=0.02)
    assert [(first,), (second,)] == attributes(drawn, "line", "moment", "x1")
    texts = [e.text for e in drawn.iter("text")]
    assert [text for text in texts if text in ("t0", "t1")] == ["t0", "t1"]
    assert sum(e.text.endswith("(unknown)") for e in drawn.iter("title")) == 1
    assert [text for text in texts if text in ("A", "B")] == ["A", "B"]


def test_named_times_beside_each_other_are_told_apart():
    drawn = timeline([], {"t0": 50, "t1": 51, "t2": 90}, 100, 15.0)
    assert attributes(drawn, "text", "moment", "y") == [(11,), (23,), (11,)]


@pytest.mark.parametrize(
    ("mode", "text", "said"),
    [
        ("multiple_choice", '{"choice":2}', "2: b"),
        ("multiple_choice", '{"choice":9}', "9: no such choice"),
        ("frame", '{"frame":30}', "frame 30 (2.0 s)"),
        ("span", '{"start_frame":0,"end_frame":15}', "from frame 0 (0.0 s) to frame 15 (1.0 s)"),
        ("frame_viewpoint", '{"frame":30,"angle_deg":6.89}', "frame 30 (2.0 s), angle 6.9\N{DEGREE SIGN}"),
        ("number", '{"value":23.0666}', "23.07"),
        ("number", '{"value":', '{"value":'),
        ("number", None, ""),
    ],
)
def test_answers_in_words(mode, text, said):
    assert readable(mode, text, ["a", "b"], 15.0) == said


def test_stretches_and_lines():
    assert runs_of([1, 2, 3, 7, 8, 20], 1) == [(1, 3), (7, 8), (20, 20)]
    assert runs_of([0, 15, 45], 15) == [(0, 15), (45, 45)]
    assert runs_of([], 1) == []
    assert wrapped("first to the right of (robot view)", 20) == ("first to the right", "of (robot view)")


def test_dots_are_to_scale():
    row = {"run": "r", "answer": 50.0, "evidence": 10.0, "combined": 5.0}
    dots = scatter([row, row | {"evidence": 11.0}, row | {"answer": 90.0}, row | {"answer": None}])
    assert dots[1].y < dots[0].y and dots[0].x == dots[1].x < dots[2].x and len(dots) == 3


@pytest.mark.parametrize("spread", [0.0, 1.0, 5.0, 100.0])
def test_numbers_of_dots_cover_neither_each_other_nor_a_dot(spread):
    random = np.random.default_rng(int(spread))
    shares = np.clip(random.uniform(0, 100, 2) + random.uniform(-spread, spread, (30, 2)), 0, 100)
    dots = scatter([{"run": "r", "answer": answer, "evidence": evidence} for answer, evidence in shares])
    spots = [(dot.x - 4.5, dot.y - 4.5, dot.x + 4.5, dot.y + 4.5) for dot in dots]
    halves = [(3.3 * len(str(dot.number)), 5.5) for dot in dots]
    labels = [
        (dot.label_x - half, dot.label_y - tall, dot.label_x + half, dot.label_y + tall)
        for dot, (half, tall) in zip(dots, halves, strict=True)
    ]
    for place, one in enumerate(labels):
        for other in [*labels[:place], *spots]:
            assert one[0] >= other[2] or other[0] >= one[2] or one[1] >= other[3] or other[1] >= one[3]
        assert one[0] > 40 and one[2] < 380 and one[1] > 0 and one[3] < 340, "within the axes"
    assert [dot.number for dot in dots] == list(range(1, 31))
    assert spread > 5 or any(dot.leads for dot in dots)


def test_a_breakdown_says_how_many_were_asked():
    def row(run, value, n):
        return {"family": value, "run": run, "method": "react", "label": "", "n": n}

    rows = [row("r", "a", 8), row("s", "a", 8), row("t", "a", 1), row("r", "b", 3)]
    table = Crossed(rows, "family", ["r", "s", "t"])
    assert (table.across, table.values_across, table.counts) == (["a", "b"], True, {"a": 8, "b": 3})
    assert [(run, [cell and cell["n"] for cell in cells]) for run, cells in table.rows] == [
        ("r", [8, 3]),
        ("s", [8, None]),
        ("t", [1, None]),
    ]
    turned = Crossed(rows[:1] + rows[3:], "family", ["r"])
    assert (turned.across, turned.values_across) == (["r"], False)


def test_rows_are_crossed_by_two_columns():
    rows = [{"run": run, "perturbation": name} for run, name in (("s", "none"), ("r", "hop.stop(1)"), ("s", "x"))]
    assert pivot(rows, "run", "perturbation") == {"s": {"none": rows[0], "x": rows[2]}, "r": {"hop.stop(1)": rows[1]}}


def test_a_time_between_annotations_goes_by_the_nearest():
    hertz = [0, 15, 30, 60]
    assert [nearest_annotated(frame, hertz, 15) for frame in (8, 22, 30, 45, 67, 70)] == [15, 15, 30, 45, 60, 70]
    assert [nearest_annotated(frame, range(20), 1) for frame in (8, 30)] == [8, 30]
    assert nearest_annotated(3, [], 1) == 3


def test_a_close_up_reaches_over_the_seam():
    import cv2

    image = np.zeros((480, 3760, 3), np.uint8)
    image[:, 3745:], image[:, :15] = (255, 0, 0), (255, 0, 0)
    seen = close_up("a", Box(3745.0, 200.0, 30.0, 80.0), image, 7)
    ((_, box),) = seen.boxes
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(seen.uri.partition(",")[2]), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (seen.height, seen.width, 3)
    red = np.flatnonzero(picture[int(box.y + box.h / 2), :, 2] > 128)
    assert (red[0], red[-1] + 1) == pytest.approx((box.x, box.x + box.w), abs=2)
    assert box.h / box.w == pytest.approx(80 / 30)


def test_text_of_data_and_models_is_escaped():
    about = {"questions_sha256": HOSTILE}
    page = render("inspect.html", questions=[], options={}, sha256=about["questions_sha256"])
    assert "<img" not in page and "\x1b" not in page
    text = page.partition('id="about">')[2].partition("</script>")[0]
    assert json.loads(text) == about
