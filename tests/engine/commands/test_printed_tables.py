"""What commands print: tables in which no word is split, nodes as in Cypher, CSV that no spreadsheet runs."""

import csv
import io
import re
import sys

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from jrdb_avr.engine.console import csv_text, print_rows
from jrdb_avr.engine.text_table import cell_text, clean

WORDS = st.lists(st.text("abcXYZ019_.-", min_size=1, max_size=14), max_size=8).map(" ".join)
CELLS = st.none() | st.integers() | st.floats(allow_nan=False) | st.booleans() | WORDS


class Screen(io.StringIO):
    """Standard output, a terminal or none."""

    terminal = False

    def isatty(self):
        return self.terminal


def printed(rows, width=80, terminal=False, **options):
    out = Screen()
    out.terminal = terminal
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", str(width))
        patch.setenv("TERM", "dumb")
        patch.setattr(sys, "stdout", out)
        print_rows(rows, **options)
    return out.getvalue()


@example([(None, None, -(10**33), *[None] * 4)] * 4, 60)
@given(
    st.integers(1, 14).flatmap(lambda n: st.lists(st.tuples(*[CELLS] * n), min_size=1, max_size=9)),
    st.integers(60, 140),
)
def test_every_word_stays_whole_and_every_line_fits(lines, width):
    rows = [{f"column_{n}": cell for n, cell in enumerate(line)} for line in lines]
    text = printed(rows, width)
    assert max(map(len, text.splitlines())) <= width
    words = re.sub("[─-╿]", " ", text).split()
    for row in rows:
        for name, cell in row.items():
            assert name in words
            assert all(word in words for word in cell_text(cell).split())


def test_a_long_word_widens_its_table_instead_of_breaking():
    path = "/".join(["folder"] * 30)
    assert max(map(len, printed([{"list": ",".join(["name"] * 60)}]).splitlines())) <= 80
    assert path in printed([{"n": 1, "path": path}] * 5) and path in printed([{"n": 1, "path": path}])


def test_a_wide_row_is_turned_and_wide_rows_stand_in_parts_that_repeat_what_tells_them_apart():
    wide = {f"a_long_name_{n}": n for n in range(12)}
    turned = printed([{"run": "a"} | wide, {"run": "b"} | wide])
    assert re.search(r"run +┃ a +┃ b ", turned) and re.search(r"a_long_name_11 +│ 11 │ 11 ", turned)
    parts = printed([{"run": f"r{n}", "kind": kind} | wide for n in range(5) for kind in ("x", "y")])
    heads = [line.split()[1:5:2] for line in parts.splitlines() if line.startswith("┃")]
    assert len(heads) > 1 and all(head == ["run", "kind"] for head in heads)


def test_rows_without_end_are_counted_on_a_terminal_and_printed_elsewhere():
    rows = [{"n": n} for n in range(1234)]
    text = printed(rows, terminal=True)
    assert "│   99 │" in text.replace("│ 99 │", "│   99 │") and "│  100 │" not in text
    assert text.splitlines()[-1] == "... 1,134 more: --csv or --json prints all"
    assert "1233" in printed(rows)


def test_nodes_relations_and_paths_read_as_in_cypher():
    person = {"_ID": {"offset": 0, "table": 2}, "_LABEL": "Person", "track": 3, "age": None}
    action = {"_ID": {"offset": 1, "table": 5}, "_LABEL": "Action", "name": "sitting\x1b[31m"}
    performs = {"_SRC": person["_ID"], "_DST": action["_ID"], "_LABEL": "Performs", "_ID": {}, "first": 0.5}
    assert cell_text(performs) == "[:Performs {first: 0.5}]"
    there = {"_NODES": [person, action], "_RELS": [performs]}
    back = {"_NODES": [action, person], "_RELS": [performs]}
    assert cell_text(there) == "(:Person {track: 3})-[:Performs {first: 0.5}]->(:Action {name: sitting[31m})"
    assert cell_text(back) == "(:Action {name: sitting[31m})<-[:Performs {first: 0.5}]-(:Person {track: 3})"
    assert cell_text({"a": [1, None], "b": "x"}) == "{a: [1, ], b: x}"


def test_no_part_of_a_cell_is_a_formula_and_hidden_characters_are_shown():
    texts = ["\uff1d1+1", "\uff0b1", "\uff201", "a;=1+1", "a; @x", "a\t=1", "a\n\uff1d1", ["b;=1"], {"c": ";+1"}]
    (_, *cells) = csv.reader(io.StringIO(csv_text([{"text": text} for text in texts])))
    assert [text for (text,) in cells if re.search(r"(^|[;\t\n])[ \n]*[=+\-@\uff1d\uff0b\uff20]", text)] == []
    # Semicolons and signs inside a text stay as they are.
    assert csv_text([{"text": "a; b = 1 - 2"}]) == "text\na; b = 1 - 2\n"
    for code in (0xAD, 0x61C, 0x200B, 0x200D, 0x200E, 0x202E, 0x2060, 0x2066, 0xFEFF, 0xE0041):
        name = f"a{chr(code)}b"
        for text in (printed([{"run": name}]), csv_text([{"run": name, "more": [name]}])):
            assert chr(code) not in text and f"a[U+{code:04X}]b" in text
    assert clean("é שלום سلام 日本 ✔️") == "é שלום سلام 日本 ✔️"


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@a", "\t=1", "\r=1", "\x00=1", "\r\n-1"])
def test_no_text_of_csv_is_a_formula_in_cells_or_headings(text):
    ((heading, _), (cell, number)) = csv.reader(io.StringIO(csv_text([{text: text, "n": -1.5}])))
    assert not heading.lstrip("\n").startswith(("=", "+", "-", "@", "\t")) and heading == cell
    assert number == "-1.5"
