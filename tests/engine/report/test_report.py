"""Reports on runs whose every count is known: the paper's own, and small worlds in which each failure happens once."""

import csv
import io
import re
from itertools import combinations

import msgspec
import numpy as np
import pytest
from scored_runs import BOX, CASES, ELSEWHERE, Benchmark, stored_failures, table

from jrdb_avr.engine.console import csv_text
from jrdb_avr.engine.report.bootstrap import intervals, mean_ratio, numbered_sums
from jrdb_avr.engine.report.comparison import report, score
from jrdb_avr.engine.report.formats import cell, for_paper, latex, markdown, paper_caption, with_intervals
from jrdb_avr.engine.report.paper import ABLATION, BY_GROUP, GROUPS
from jrdb_avr.engine.report.scored_runs import ScoredRun
from jrdb_avr.engine.report.side_by_side import paper_rows
from jrdb_avr.engine.report.tables import (
    ablation_rows,
    breakdown_rows,
    main_rows,
    pair_rows,
    ranked,
)
from jrdb_avr.queries.runs import questions_hash, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import RUNS


def papers_predictions():
    """As many questions per group as the paper's, with its counts of right answers, boxes and both."""
    asked, given = [], []
    for group, counts in GROUPS.items():
        families = counts.families
        for i in range(counts.n):
            # Both right first, then answers alone, then boxes alone.
            answers = i < counts.answer
            boxes = i < counts.combined or 0 <= i - counts.answer < counts.evidence - counts.combined
            asked.append((f"{group} {i}", f"s{i % 27}", families[i % len(families)]))
            given.append((1 if answers else 2, BOX if boxes else ELSEWHERE, 7))
    return asked, given


@pytest.fixture(scope="module")
def paper():
    asked, given = papers_predictions()
    benchmark = Benchmark(asked)
    return benchmark, benchmark.run(given, "paper-agent", "agent", "Qwen3.5 9B")


def test_the_papers_counts_give_the_papers_table(paper):
    benchmark, run = paper
    row, agent = main_rows(benchmark.index, [run], 0.5)[0], ABLATION["agent"]
    assert row["n"] == 2098
    assert [row[name] for name in ("answer", "evidence", "combined", "hallucination")] == [
        agent.answer,
        agent.evidence,
        agent.combined,
        agent.hallucination,
    ]
    assert row["combined_macro_groups"] == 9.21
    for name in ("answer", "evidence", "combined"):
        assert row[f"{name}_low"] < row[name] < row[f"{name}_high"]


def test_a_breakdown_by_group_is_the_papers(paper):
    benchmark, run = paper
    ours = {row["group"]: row for row in breakdown_rows(benchmark.index, [run], "group")}
    assert ours.keys() == BY_GROUP.keys()
    for group, row in BY_GROUP.items():
        for name in ("answer", "evidence", "combined", "hallucination"):
            assert ours[group][name] == getattr(row, name), group
    assert sum(row["n"] for row in breakdown_rows(benchmark.index, [run], "family")) == 2098


def test_a_fork_join_counts_as_two_hops(paper):
    benchmark, run = paper
    families = {row["family"]: row["n"] for row in breakdown_rows(benchmark.index, [run], "family")}
    assert {row["hops"]: row["n"] for row in breakdown_rows(benchmark.index, [run], "hops")} == {
        "0": sum(families[name] for name in ("action_boundary", "long_range", "unique_anchor")),
        "2": sum(families[name] for name in ("chain_2hop", "chain_fork_join", "chain_hybrid")),
        "3": families["chain_3hop"],
    }


def test_the_ablation_is_active_by_world(paper):
    benchmark, run = paper
    rows = ablation_rows([run])
    assert [(row["active"], row["world_model"], row["combined"]) for row in rows] == [("on", "on", 14.54)]
    assert ablation_rows([benchmark.run([(1, BOX, 7)] * 2098)]) == []


# -- beside the paper -------------------------------------------------------------------------------------------------


def beside(name, benchmark, runs, backbone=""):
    """The rows of a table of the paper that have a run."""
    return [row for row in paper_rows(name, benchmark.index, runs, backbone) if row["run"]]


def test_the_papers_own_run_differs_nowhere_from_the_paper(paper):
    benchmark, run = paper
    for name, count, empty in (("paper_main", 1, 24), ("paper_ablation", 1, 3), ("paper_groups", 5, 0)):
        rows = beside(name, benchmark, [run])
        assert (len(rows), len(paper_rows(name, benchmark.index, [run])) - len(rows)) == (count, empty)
        for row in rows:
            for kind in ("answer", "evidence", "combined", "hallucination"):
                assert row[kind] == row[f"paper_{kind}"] and row[f"{kind}_difference"] == 0, (name, kind)
    counts = paper_rows("paper_generators", benchmark.index, [run])
    assert (counts[0]["generator"], counts[-1]) == (
        "action_boundary",
        {"generator": "all", "paper_n": 2098, "n": 2098, "n_difference": 0, "label": ""},
    )


def test_a_run_is_beside_the_paper_by_its_models_names_or_by_order():
    benchmark = Benchmark([(name, f"s{name}", "long_range") for name in "ab"])
    runs = {
        model: benchmark.run([(1, BOX, 7), (2, BOX, 7)], model, "react", model)
        for model in ("google/gemma-4-E4B-it", "Qwen/Qwen3-VL-8B-Instruct", "my-finetune", "Qwen/Qwen3.5-9B-AWQ")
    }
    real = beside("paper_main", benchmark, runs.values())
    assert {(row["run"], row["model"]) for row in real} == {
        ("google/gemma-4-E4B-it", "Gemma-4 E4B"),
        ("Qwen/Qwen3-VL-8B-Instruct", "Qwen3-VL 8B"),
    }
    assert (real[0]["answer"], real[0]["answer_difference"], real[0]["n"]) == (50.0, 19.4, 2)
    (row,) = beside("paper_main", benchmark, [runs["my-finetune"]], "Qwen3.5 4B")
    assert (row["model"], row["run"], row["label"]) == ("Qwen3.5 4B", "my-finetune", "")
    with pytest.raises(InputError, match="my-finetune: name the runs of one"):
        paper_rows("paper_main", benchmark.index, runs.values(), "Qwen3.5 4B")
    with pytest.raises(InputError, match="did you mean Qwen3"):
        paper_rows("paper_main", benchmark.index, [], "Qwen3.5 9b")


def test_a_synthetic_run_is_beside_the_paper_only_by_order_and_is_called_synthetic(paper):
    benchmark, run = paper
    made = ScoredRun(msgspec.structs.replace(run.manifest, synthetic=True), run.rows, run.table, 0, run.answers)
    assert beside("paper_main", benchmark, [made]) == []
    rows = paper_rows("paper_main", benchmark.index, [made], "Qwen3.5 9B")
    texts, title = for_paper("paper_main", rows), paper_caption("paper_main", rows)
    assert texts[-1]["answer"].endswith("] synthetic") and texts[-1]["n"] == "2098 synthetic" and "synthetic" in title
    assert texts[0]["answer"] == texts[0]["n"] == "" and "synthetic" not in paper_caption("paper_main", rows[:-1])
    assert "; the figures of this store are synthetic}" in latex(texts, title)


def test_settings_of_one_model_are_told_apart():
    benchmark = Benchmark([("a", "s1", "long_range")])
    noise = {"simulated": {"wrong_box": 0.1}, "temperature": 0, "endpoint": {"base_url": "http://one"}}
    plain = {"temperature": 0, "endpoint": {"base_url": "http://two"}}
    runs = []
    for name, settings in (("noisy", noise), ("plain", plain)):
        for method in ("agent", "agent-passive"):
            run = benchmark.run([(1, BOX, 7)], f"{name}-{method}", method)
            run.manifest = msgspec.structs.replace(run.manifest, settings=settings)
            runs.append(run)
    assert [row["setting"] for row in main_rows(benchmark.index, runs, 0.5)] == ["simulated: wrong_box 0.1"] * 2 + [
        ""
    ] * 2
    # The cells of one setting stand together.
    assert [(row["setting"], row["world_model"], row["active"]) for row in ablation_rows(runs)] == [
        ("", "on", "off"),
        ("", "on", "on"),
        ("simulated: wrong_box 0.1", "on", "off"),
        ("simulated: wrong_box 0.1", "on", "on"),
    ]
    assert main_rows(benchmark.index, runs[:2], 0.5)[0]["setting"] == ""


FOUR = [("a", "s1", "long_range"), ("b", "s1", "long_range"), ("c", "s2", "chain_2hop"), ("d", "s2", "chain_2hop")]


def test_pairs_are_of_the_questions_both_were_asked():
    benchmark = Benchmark(FOUR)
    first = benchmark.run([(1, BOX, 7), (1, BOX, 7), (2, BOX, 7), (1, None, 0)], "one")
    second = benchmark.run([(1, BOX, 7), (2, BOX, 7), (2, BOX, 7), (2, None, 0)], "two")
    rows = {row["score"]: row for row in pair_rows(benchmark.index, [first, second])}
    assert rows["answer"]["n"] == 4
    assert (rows["answer"]["only_first"], rows["answer"]["only_second"], rows["answer"]["p"]) == (2, 0, 0.5)
    assert rows["answer"]["difference"] == -50.0
    assert (rows["evidence"]["only_first"], rows["evidence"]["p"]) == (0, 1.0)


def test_each_two_runs_are_compared_on_the_questions_that_they_share():
    """Of four runs two have all questions, two have others: every pair as if it was drawn by itself."""
    generator = np.random.default_rng(3)
    benchmark = Benchmark([(f"q{n:02}", f"s{n % 12:02}", "long_range") for n in range(60)])
    runs = []
    for name, kept in {"a": slice(None), "b": slice(None), "c": slice(0, 40), "d": slice(20, 60)}.items():
        run = benchmark.run([(choice, BOX, 7) for choice in generator.integers(1, 3, 60).tolist()], name)
        cut = (run.rows[kept], run.table.take(np.arange(60)[kept]))
        runs.append(ScoredRun(run.manifest, *cut, 0, []))
    found = pair_rows(benchmark.index, runs)
    assert [(row["first"], row["second"], row["n"]) for row in found[::3]] == [
        *(("a", "b", 60), ("a", "c", 40), ("a", "d", 40)),
        *(("b", "c", 40), ("b", "d", 40), ("c", "d", 20)),
    ]
    for (first, second), row in zip(combinations(runs, 2), found[::3], strict=True):
        shared = [n for n in range(60) if n in first.rows and n in second.rows]
        mine, yours = ([int(own.scores[own.rows.tolist().index(n), 0]) for n in shared] for own in (first, second))
        clusters = benchmark.index.labels["sequence"].numbers[shared]
        columns = np.stack([np.subtract(yours, mine), np.ones(len(shared))], axis=1)
        names, numbers = np.unique(clusters, return_inverse=True)
        (expected,) = intervals(numbered_sums(numbers, len(names), columns), [mean_ratio((0, 1))])
        bounds = [round(100 * bound, 2) for bound in (expected.value, expected.low, expected.high)]
        assert [row[f"difference{end}"] for end in ("", "_low", "_high")] == bounds


def stored_run(path, given):
    """A store with a run of the four questions."""
    benchmark, store = Benchmark(FOUR), Store(path)
    benchmark.write(store)
    run = benchmark.run(given)
    store.write_run("r", "predictions", benchmark.written["predictions"])
    write_run_manifest(store, msgspec.structs.replace(run.manifest, questions_sha256=questions_hash(store)))
    return store


def test_cost_is_per_question_and_per_right_one(tmp_path):
    given = [(1, BOX, 7), (2, BOX, 7), (1, BOX, 7), (1, None, 0)]
    (row,) = report(stored_run(tmp_path / "a", given)).table("cost")
    assert (row["model_calls"], row["prompt_tokens"], row["tokens_per_combined"]) == (3.0, 100.0, 220)
    (row,) = report(stored_run(tmp_path / "b", [(2, BOX, 7)] * 4)).table("cost")
    assert row["tokens_per_combined"] is None


# -- failures ---------------------------------------------------------------------------------------------------------


def test_each_box_that_does_not_score_has_its_cause(tmp_path):
    benchmark, run, store = stored_failures(tmp_path)
    rows = report(store).table("evidence_failures")
    assert sum(row["times"] for row in rows) == len(CASES) - 1
    # A run of each question alone has the cause of that question.
    steps = store.sql("SELECT * FROM steps").to_pylist()
    predictions = benchmark.written["predictions"].to_pylist()
    for number, name in enumerate(CASES):
        for kind, all_rows in (("steps", steps), ("predictions", predictions)):
            own = [row | {"run_id": f"case-{number}"} for row in all_rows if row["question_id"] == name]
            store.write_run(f"case-{number}", kind, table(own, RUNS[kind]))
        manifest = msgspec.structs.replace(run.manifest, run_id=f"case-{number}", question_ids=(name,))
        write_run_manifest(store, msgspec.structs.replace(manifest, questions_sha256=questions_hash(store)))
    found = {row["run"]: row["cause"] for row in report(store).table("evidence_failures") if row["times"]}
    assert {name: found.get(f"case-{number}", "") for number, name in enumerate(CASES)} == {
        name: cause for name, (_, _, cause) in CASES.items()
    }


def test_a_folder_named_like_a_column_changes_no_row(tmp_path):
    shown = []
    for folder in ("plain", "run_id=7/question_id=q/track=3/frame=x"):
        *_, store = stored_failures(tmp_path / folder / "store")
        rows = [score(store), *(report(store).table(name) for name in ("main", "evidence_failures"))]
        rows += [store.sql(f"FROM {name}").to_pylist() for name in ("runs", "scores", "intervals_sightings", "steps")]
        shown.append(rows)
    assert all(shown[0]) and str(shown[1]) == str(shown[0])


def test_tables_hold_only_the_named_runs_under_the_threshold_at_hand(tmp_path):
    *_, store = stored_failures(tmp_path)
    # The other run cannot be scored, and the stored scores are of another threshold.
    score(store, iou=0.4)
    other = store.run_path("broken") / "predictions.parquet"
    other.parent.mkdir()
    other.write_bytes(b"no parquet")
    (other.parent / "run.json").write_bytes(b"{")
    loose, strict = (
        {row["cause"]: row["times"] for row in report(store, ["r"], iou=iou).table("evidence_failures")}
        for iou in (0.4, 0.5)
    )
    assert strict == loose | {"right person, loose box": loose["right person, loose box"] + 1}


# -- texts ------------------------------------------------------------------------------------------------------------

ROWS = [
    {"model": "a_b|c", "answer": 12.5, "answer_low": 1.0, "answer_high": 20.0, "n": 3},
    {"model": "50% {x} \\ #1", "answer": None},
]


def test_cells_as_a_person_reads_them():
    assert [cell(value) for value in (None, 1.0, 3, "x")] == ["n/a", "1.00", "3", "x"]
    assert with_intervals(ROWS)[0] == {"model": "a_b|c", "answer": "12.50 [1.00, 20.00]", "n": "3"}


def test_markdown_escapes_bars():
    lines = markdown(ROWS).splitlines()
    assert re.fullmatch(r"\|:-+(\|-+:){4}\|", lines[1])
    assert lines[2].split()[:4] == ["|", "a_b\\|c", "|", "12.50"]
    assert [text.strip() for text in lines[3].split("|")][2:] == ["n/a", "", "", "", ""]


def test_latex_compiles_as_text():
    text = latex(ROWS)
    assert re.search(r"a\\_b\|c +& +12\.50", text)
    assert r"50\% \{x\} \textbackslash{} \#1" in text
    assert re.match(r"\\begin{tabular}{lrrrr}\n\\toprule\n model +& +answer +& +answer low ", text)
    assert text.endswith("\\bottomrule\n\\end{tabular}\n")


def test_latex_numbers_settings_and_says_below_what_they_are():
    rows = [{"model": "m", "setting": text} for text in ("b_1: x 1", "", "a: y 2", "b_1: x 1")]
    text = latex(rows)
    assert re.findall(r"^ m +& (\d?)", text, re.MULTILINE) == ["1", "", "2", "1"]
    assert text.endswith("\\par{\\footnotesize 1: b\\_1: x 1}\n\\par{\\footnotesize 2: a: y 2}\n")


HOSTILE = [
    '=HYPERLINK("x")',
    "+1",
    "-1",
    "@a",
    "<b>&[x](y)`\n\n|",
    "a\x1b[31m\x00",
    "[0, 5)",
    "\u202eabc",
    "x" * 10_000,
]


def test_names_of_others_do_no_harm_in_any_format():
    rows = [{"model": text, "n": 1} for text in HOSTILE]
    table = list(csv.reader(io.StringIO(csv_text(rows))))[1:]
    assert len(table) == len(HOSTILE)
    assert not [cells for cells in table if cells[0].startswith(("=", "+", "-", "@"))]
    assert csv_text([{"n": -1.5}]) == "n\n-1.5\n"
    for text in (csv_text(rows), markdown(rows), latex(rows)):
        assert "\x1b" not in text and "\x00" not in text
    lines = markdown(rows).splitlines()
    assert len(lines) == len(HOSTILE) + 2
    assert re.fullmatch(r"\| &lt;b>&amp;\\\[x\\\]\(y\)\\` \\\| +\| +1 \|", lines[6])
    # A bracket after the end of a row would be taken for the height of the gap below it.
    assert re.search(r"\n {\[}0, 5\) +& +1 ", latex(rows)) and not re.search(r"\n *\[", latex(rows))


def runs_over(sequences, **counts):
    """An index, and runs of that many sequences: name=(questions, right of them)."""
    ids = [(f"{n:02}", f"s{n % sequences:02}", "long_range") for n in range(40)]
    benchmark = Benchmark(ids)
    given = {name: [(1, BOX, 7)] * right + [(2, BOX, 7)] * (40 - right) for name, right in counts.items()}
    return benchmark.index, [benchmark.run(own, name) for name, own in given.items()]


def test_few_sequences_give_no_interval_but_say_so():
    for sequences, enough in ((9, False), (10, True)):
        index, runs = runs_over(sequences, one=33, two=18)
        for rows, name in ((main_rows(index, runs, 0.5), "answer"), (pair_rows(index, runs), "difference")):
            # The numbers stay for programs.
            assert all(row[f"{name}_low"] < row[name] < row[f"{name}_high"] for row in rows if row[name])
            texts = with_intervals(rows)
            assert all(("[" in own[name]) == enough for own, row in zip(texts, rows, strict=True) if row[name])
            labels = {own.get("interval") for own in texts}
            assert labels == ({None} if enough else {"too few sequences for an interval"})
            assert ("[" in latex(texts).replace("{[}", "[")) == ("[" in markdown(texts)) == enough


def test_the_best_run_stands_first_and_another_n_is_marked(tmp_path):
    _, runs = runs_over(3, low=10, high=35, middle=20)
    assert [run.manifest.run_id for run in ranked(runs)] == ["high", "middle", "low"]
    rows = [{"run": name, "n": n} for name, n in (("a", 40), ("b", 40), ("c", 9))] + [{"run": "", "n": 2098}]
    assert [row["n"] for row in with_intervals(rows)] == ["40", "40", "9*", "2098"]
    # In a breakdown the groups differ, not the runs.
    assert [row["n"] for row in with_intervals([{"run": "a", "n": 4}, {"run": "a", "n": 5}])] == ["4", "5"]


def test_a_p_value_is_not_rounded_to_nothing():
    rows = [{"p": value} for value in (0.0375, 2.0**-40, 1.0, None)]
    assert [line.strip("| ") for line in markdown(rows).splitlines()[2:]] == ["0.0375", "&lt;0.0001", "1.0000", "n/a"]
    assert [row["p"] for row in with_intervals(rows)] == ["0.0375", "<0.0001", "1.0000", "n/a"]
