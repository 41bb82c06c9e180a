"""Pictures for notebooks and folders: questions, rows of queries, and the graph as files for other engines."""

import json
import pickle
import sys
from types import SimpleNamespace

import cv2
import duckdb
import numpy as np
import pytest
from processes import run

import jrdb_avr
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.errors import InputError

SEQUENCE = "sample-plaza-01_0"


@pytest.fixture
def displayed(monkeypatch):
    """What is displayed, in place of a notebook."""
    found = []
    fake = SimpleNamespace(display=found.append, Image=lambda data: data)
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(display=fake))
    monkeypatch.setitem(sys.modules, "IPython.display", fake)
    return found


def decoded(png):
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR_RGB)


def test_a_notebook_shows_a_question_and_the_people_of_rows(small_demo, displayed):
    store = jrdb_avr.Store(small_demo.folder / "store")
    bench = jrdb_avr.Bench(store)
    asked = next(question for question in bench.questions if "(frame " in question.question)
    store.question(asked.question_id).show()
    html = displayed.pop()._repr_html_()
    assert asked.question[:20] in html and html.count("<li>") == len(asked.choices)
    assert 1 <= html.count("data:image/png;base64,") == html.count("frame ") - asked.question.count("frame ")
    people = store.cypher("who_is_where", sequence=SEQUENCE, frame=150)
    assert people.num_rows == len(people["track"]) > 3 and repr(people).startswith("<QueryRows: ")
    people.show()
    sheet = decoded(displayed.pop())
    assert sheet.shape == (240 * -(-people.num_rows // 6), 1440, 3)
    with pytest.raises(InputError, match="no question"):
        store.question("x")
    with pytest.raises(InputError, match="return these columns"):
        store.sql("SELECT 1 AS track").show()


def test_benches_and_observers_take_a_store_and_can_be_pickled(small_demo):
    path = small_demo.folder / "store"
    bench, observer = (pickle.loads(pickle.dumps(kind(path))) for kind in (jrdb_avr.Bench, jrdb_avr.Observer))
    assert len(repr(bench)) < 100 and len(repr(observer)) < 300
    seen = observer(SEQUENCE, 150, 180.0)
    assert (seen.image == bench.observer(SEQUENCE, 150, 180.0).image).all()
    shown = decoded(seen._repr_png_())
    assert (shown == seen.image).all() and len(repr(bench.sequences)) < 200
    episode = bench.episode(bench.questions[0].question_id)
    frame = episode.observe(150, 180.0).frame_index
    with pytest.raises(jrdb_avr.RefusedError) as refused:
        episode.submit(None, [{"frame_id": frame, "bbox": [0, 0, 10, 10]}])
    assert frame == 150 and "frame_id" not in str(refused.value)


def test_crops_are_a_picture_per_row_and_a_sheet(small_demo, tmp_path):
    store, rows = small_demo.folder / "store", "FROM intervals_sightings WHERE frame = 150"
    boxed = f"SELECT sequence, frame, x, y, w, h {rows}"
    for statement, name in ((f"SELECT sequence, frame, track {rows}", "tracks"), (boxed, "boxes")):
        code, out, err = run("sql", statement, "--store", store, "--json", "--crops", tmp_path / name)
        count = len(json.loads(out))
        assert code == 0 and f"{count} crops of {count} rows" in err
        assert len([*(tmp_path / name).glob(f"*-{SEQUENCE}-000150.png")]) == count > 3
        assert (tmp_path / name / "sheet.png").exists()
    row, image = json.loads(out)[0], cv2.imread(str(next((tmp_path / "boxes").glob("0001-*"))))
    # The person is in the middle. The left edge of the box has one color.
    edge = image[int(row["y"]) + 4 : int(row["y"] + row["h"]) - 4, round(240 - row["w"] / 2)]
    assert image.shape == (480, 480, 3) and len(edge) > 20 and not np.ptp(edge, axis=0).any()
    odd = "VALUES (0, NULL, 0), (150, 1, -5), (150, 1.5, 5), (1, 1, 5), (-1, 1, 5), (150, 'nan'::DOUBLE, 5)"
    statement = f"FROM ({odd}) t(frame, x, w) SELECT '{SEQUENCE}' AS sequence, frame, x, 9.5 AS y, w, 40 AS h"
    code, _, err = run("sql", statement, "--store", store, "--crops", tmp_path / "odd")
    assert code == 0 and " crops of 6 rows" in err and [*(tmp_path / "odd").glob("0003-*")]
    assert not {path.name[:4] for path in (tmp_path / "odd").iterdir()} & {"0001", "0002", "0005", "0006"}
    rows = "SELECT 5 AS sequence, 150 AS frame, 1 AS track"
    code, _, err = run("sql", rows, "--store", store, "--crops", tmp_path / "none")
    assert code == 1 and "sequence 5 of row 1 is not loaded" in err
    code, _, err = run("sql", "SELECT 1 AS one", "--store", store, "--crops", tmp_path / "none")
    assert code == 1 and "return these columns" in err and not (tmp_path / "none").exists()


def test_the_graph_loads_into_another_engine(small_demo, tmp_path):
    store = jrdb_avr.Store(small_demo.folder / "store")
    code, _, err = run("export", "--store", store.path, "--graph", tmp_path / "G")
    assert code == 0, err
    assert (tmp_path / "G").stat().st_mode & 0o777 == 0o700, "it holds the annotations"
    with Graph.open(store.graph_path, read_only=True) as graph:
        expected = graph.count_rows()
    counts, nodes = dict.fromkeys(expected, 0), {}
    for entry in json.loads((tmp_path / "G" / "schema.json").read_text()):
        table = duckdb.read_parquet(str(tmp_path / "G" / entry["file"]))
        assert table.columns == [*entry["columns"]]
        counts[entry["table"]] += len(table)
        if "key" in entry:
            nodes[entry["table"]] = {row[0] for row in table.select(entry["key"]).fetchall()}
        else:
            ends = table.select('"from"', '"to"').fetchall()
            assert {a for a, _ in ends} <= nodes[entry["from"]] and {b for _, b in ends} <= nodes[entry["to"]]
    assert counts == expected and counts["SeenIn"] > 0
