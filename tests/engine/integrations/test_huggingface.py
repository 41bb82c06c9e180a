"""The published folder loads in Hugging Face's datasets and in mlcroissant, and holds nothing private."""

import datetime
import json
import re

import pyarrow.parquet as pq
import pytest
import yaml
from processes import run

from jrdb_avr.engine.integrations.huggingface import export_folders, licence_of, sources_of
from jrdb_avr.queries.opaque import key_path, stored_ids
from jrdb_avr.queries.runs import read_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.card import RAI, SAMPLE, SOURCES
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import CANARY, LAYERS, QUESTIONS

DAY = datetime.date(2026, 1, 2)
PUBLIC = ("questions", "sequences")


@pytest.fixture(scope="module")
def store(sample_benchmark, tmp_path_factory):
    """The store, with a key of its own, by which the opaque names come in another order than the real ones."""
    folder = tmp_path_factory.mktemp("published") / "store"
    folder.mkdir()
    for path in sample_benchmark.path.iterdir():
        (folder / path.name).symlink_to(path)
    key_path(Store(folder)).write_text("00" * 32)
    return Store(folder)


@pytest.fixture(scope="module")
def folders(store):
    return export_folders(store, store.path.parent / "out", "A Lab", "https://example.org/questions", DAY)


@pytest.fixture(scope="module")
def datasets(tmp_path_factory):
    """Hugging Face's library without a network."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HF_HUB_OFFLINE", "1")
        patch.setenv("HF_HOME", str(tmp_path_factory.mktemp("hf")))
        import datasets

        datasets.disable_progress_bars()
        yield datasets


def test_both_folders_load_by_their_configs(store, folders, datasets, tmp_path):
    public, private = folders
    assert datasets.get_dataset_config_names(str(public)) == list(PUBLIC)
    own = {name: datasets.load_dataset(str(public), name, split="test", cache_dir=str(tmp_path)) for name in PUBLIC}
    names = datasets.load_dataset(str(private), "names", split="test", cache_dir=str(tmp_path))
    real = {row["sequence"]: row["name"] for row in names}
    for name, found in own.items():
        # With the names and ids put back, these are the store's tables.
        back = [{**row, "sequence": real[row["sequence"]]} for row in with_stored(found, store)]
        key = QUESTIONS[name].names[0]
        assert sorted(back, key=lambda row: row[key]) == sorted(
            store.questions(name).to_pylist(), key=lambda row: row[key]
        )
    assert (
        datasets.load_dataset(str(public), split="test", cache_dir=str(tmp_path)).num_rows == own["questions"].num_rows
    )
    for name in ("answers", "evidence"):
        found = datasets.load_dataset(str(private), name, split="test", cache_dir=str(tmp_path))
        rows = with_stored(found.data.table.to_pylist(), store)
        assert sorted(rows, key=str) == sorted(store.questions(name).to_pylist(), key=str)


def with_stored(rows, store):
    """Rows with the store's ids of questions in place of opaque ids."""
    stored = stored_ids(store)
    return [{**row, "question_id": stored[row["question_id"]]} if "question_id" in row else row for row in rows]


@pytest.mark.slow
def test_croissant_is_valid_and_loads_the_same_records(folders):
    import mlcroissant

    public, _ = folders
    dataset = mlcroissant.Dataset(str(public / "croissant.json"))
    issues = dataset.metadata.ctx.issues
    assert not issues.errors and not issues.warnings
    for name in PUBLIC:
        found = [{key.split("/")[1]: text(value) for key, value in record.items()} for record in dataset.records(name)]
        assert found == pq.read_table(public / "data" / f"{name}.parquet").to_pylist()
        for field in next(own for own in dataset.metadata.record_sets if own.id == name).fields:
            assert re.fullmatch(r"[A-Z].*\.", field.description)
    said = dataset.metadata
    assert said.conforms_to[0].endswith("croissant/1.1") and said.date_published.date() == DAY
    assert [creator.name for creator in said.creators] == ["A Lab"] and said.url == "https://example.org/questions"
    assert re.fullmatch(r"\d+\.\d+\.\d+\+[0-9a-f]{12}", said.version) and "@article{jrdb" in said.cite_as
    assert said.license == [SAMPLE.licence_url] and CANARY in said.description
    fields = json.loads((public / "croissant.json").read_text())
    assert {name: fields[f"rai:{name}"] for name in RAI} == RAI
    assert (said.data_collection, said.data_limitations) == (RAI["dataCollection"], [RAI["dataLimitations"]])
    assert said.personal_sensitive_information and said.data_biases and said.data_use_cases


def text(value):
    if isinstance(value, list):
        return [text(part) for part in value]
    return value.decode() if isinstance(value, bytes) else value


def test_nothing_private_is_in_the_public_folder(store, folders):
    public, _ = folders
    files = sorted(path for path in public.rglob("*") if path.is_file())
    assert [str(path.relative_to(public)) for path in files] == [
        *("README.md", "croissant.json", "data/questions.parquet", "data/sequences.parquet")
    ]
    # What the files hold is searched as stored and as unpacked.
    shown = b"\n".join(path.read_bytes() for path in files)
    for name in PUBLIC:
        file = pq.ParquetFile(public / "data" / f"{name}.parquet")
        assert file.schema_arrow.names == QUESTIONS[name].names
        assert set(file.schema_arrow.metadata) <= {b"canary", b"generation", b"ARROW:schema"}
        shown += json.dumps(file.read().to_pylist(), ensure_ascii=False).encode()
    answers, evidence = store.questions("answers"), store.questions("evidence")
    hidden = set(store.questions("sequences")["sequence"].to_pylist()) | set(answers["question_id"].to_pylist())
    for column in ("plan", "proofs", "needed", "bindings", "rules"):
        hidden |= set(answers[column].to_pylist())
    hidden |= {json.dumps(value)[1:-1] for value in hidden}
    hidden |= set(answers.column_names) - {"question_id", "answer", "rules", "hops", "plan", "proofs"}
    hidden |= {f"{value}" for name in "xywh" for value in evidence[name].to_pylist() if len(f"{value}") > 9}
    assert len(hidden) > 500
    assert [value for value in hidden if value.encode() in shown] == []
    # The search finds what is there.
    assert store.questions("questions")["question"][0].as_py().encode() in shown
    # The order of rows tells nothing of the names either.
    for name in PUBLIC:
        key = pq.read_table(public / "data" / f"{name}.parquet").column(0).to_pylist()
        assert key == sorted(key)
    names = sorted(pq.read_table(folders[1] / "data" / "names.parquet").to_pylist(), key=lambda row: row["name"])
    assert [row["sequence"] for row in names] != key


def test_the_card_states_licence_canary_and_occlusion(store, folders, monkeypatch, tmp_path):
    card = (folders[0] / "README.md").read_text()
    front = yaml.safe_load(card.split("---\n")[1])
    assert front["license"] == "apache-2.0" and front["configs"][0]["default"] is True
    assert CANARY in card and "**Synthetic" in card and SAMPLE.licence_url in card
    assert card.count("| attributes |") == 2
    evidence = ("attributes", "geometry")
    monkeypatch.setattr(
        Store, "visibility", lambda store: dict(zip(sorted(store.manifest().sequences), evidence, strict=True))
    )
    public, _ = export_folders(store, tmp_path / "again", published=DAY)
    assert all(f"| {kind} |" in (public / "README.md").read_text() for kind in evidence)


def test_the_sources_are_those_of_the_layers(store, monkeypatch, tmp_path):
    assert {layer for source in SOURCES for layer in source.layers} == set(LAYERS)
    assert [source.name for source in sources_of(["2d", "pose"])] == ["JRDB", "JRDB-Pose"]
    assert licence_of([SAMPLE, SOURCES[0]]) == "other"
    # As if the sample were a recording.
    monkeypatch.setattr("jrdb_avr.schema.card.is_of_sample", lambda name: False)
    public, _ = export_folders(store, tmp_path / "real", published=DAY)
    front, card = (public / "README.md").read_text().split("---\n")[1:]
    assert yaml.safe_load(front)["license"] == "cc-by-nc-sa-3.0" and "Synthetic" not in card
    based = json.loads((public / "croissant.json").read_text())["isBasedOn"]
    assert [source["name"] for source in based] == [source.name for source in SOURCES]
    assert all(f"| {source.name} | [{source.licence}]({source.licence_url})" in card for source in SOURCES)


def test_an_export_is_repeatable_and_replaces_nothing(store, folders, tmp_path):
    again = export_folders(store, tmp_path / "out", "A Lab", "https://example.org/questions", DAY)
    for first, second in zip(folders, again, strict=True):
        files = {path.relative_to(first): path.read_bytes() for path in first.rglob("*") if path.is_file()}
        assert files == {path.relative_to(second): path.read_bytes() for path in second.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match="not empty"):
        export_folders(store, tmp_path / "out")
    code, out, err = run("export", "--store", store.path, "--hf", tmp_path / "cli")
    assert (code, out) == (0, "") and "to be published" in err
    assert (tmp_path / "cli" / "public" / "croissant.json").exists()
    for arguments in ((), ("r", "--hf", "x"), ("--jsonl", "x"), ("r",)):
        assert run("export", "--store", store.path, *arguments)[0] == 2


@pytest.mark.parametrize("least", [1, 10])
def test_the_hub_reads_the_scores_of_a_run(small_demo, tmp_path, monkeypatch, least):
    from huggingface_hub import eval_result_entries_to_yaml, parse_eval_result_entries

    store, run_id, file = small_demo.folder / "store", "react-simulated-perfect", tmp_path / "results.yaml"
    arguments = ("export", "--store", store, run_id, "--results", file)
    monkeypatch.setattr("jrdb_avr.engine.report.tables.LEAST_CLUSTERS", least)
    assert run(*arguments)[0] == 1 and not file.exists()
    assert run(*arguments, "--url", "https://huggingface.co/datasets/lab/questions")[0] == 0
    written = yaml.safe_load(file.read_text("utf-8"))
    entries = parse_eval_result_entries(written)
    # No key is one that the Hub does not know.
    assert eval_result_entries_to_yaml(entries) == written
    (row,) = [row for row in json.loads(run("report", "--store", store, "--json")[1]) if row["run"] == run_id]
    manifest = read_run_manifest(Store(store), run_id)
    assert [(entry.task_id, entry.value) for entry in entries] == [
        (name, row[name]) for name in ("combined", "answer", "evidence")
    ]
    asked = f"{row['n']} questions of {row['sequences']} sequences, hash {manifest.questions_sha256[:16]}"
    for entry in entries:
        bounds = f": {row[f'{entry.task_id}_low']} to {row[f'{entry.task_id}_high']}" if least == 1 else ""
        about = ["method react", "synthetic", asked, "minimum IoU 0.5", row["interval"] + bounds]
        assert entry.notes.split("; ") == about
        assert (entry.dataset_id, entry.date) == ("lab/questions", manifest.created)
    monkeypatch.setattr(Store, "training_set", lambda store: {"profile": "train"})
    assert "training set" in run(*arguments, "--url", "https://huggingface.co/datasets/lab/questions")[2]
