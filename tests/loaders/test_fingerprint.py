"""A fingerprint describes a copy and holds no annotation, and `load` says how to load renamed folders."""

import json
import re
import shutil

import msgspec
import pytest
from environment import copy_real, needs_real
from processes import run

from jrdb_avr.loaders.fingerprint import fingerprint
from jrdb_avr.loaders.synthetic.write import plan, write

BOXES = "labels/labels_2d_stitched"
SOCIAL = "labels/labels_2d_activity_social_stitched"
REASONING = "labels/labels_2d_stitched_new_version"


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sample")
    list(write(plan(folder / "root", [(120, 14)], 3, "keyframes"), 1))
    # With the name of a sequence of JRDB, so that load compares it.
    for path in sorted((folder / "root").rglob("sample-plaza-01_0*")):
        path.rename(path.with_name(path.name.replace("sample-plaza-01_0", "meyer-green-2019-03-16_0")))
    return folder / "root"


@pytest.fixture
def root(sample, tmp_path):
    return shutil.copytree(sample, tmp_path / "root")


def change(root, folder, change_of):
    """Change each record of the label files of a folder."""
    for path in (root / folder).glob("*.json"):
        content = json.loads(path.read_text())
        for objects in content["labels"].values():
            for record in objects:
                change_of(record)
        path.write_text(json.dumps(content))


def test_no_value_of_an_annotation_is_in_a_fingerprint(root, tmp_path):
    def mark(record):
        record["box"] = [9173.25, 8264.5, 7355.75, 6446]
        record["label_id"] = "pedestrian:5537"
        record["attributes"]["area"] = 4628.125

    change(root, BOXES, mark)
    change(root, "labels/labels_3d", lambda record: record["box"].update(cx=3719.5, rot_z=2811.25))
    file = tmp_path / "print.json"
    code, _, err = run("load", root, "--fingerprint", file)
    assert code == 0, err
    text = file.read_text()
    for value in ("9173", "8264", "7355", "6446", "5537", "4628", "3719", "2811"):
        assert value not in text
    keys = json.loads(text)["folders"][BOXES]["keys"]
    for key in ("labels", "000000.jpg", "[]"):
        keys = keys["keys"][key]
    keys = keys["keys"]
    assert keys["box"]["lengths"] == [4, 4] and set(keys["box"]["keys"]["[]"]["types"]) == {"float", "int"}
    keys |= keys["attributes"]["keys"]
    assert keys["occlusion"]["names"] and "pedestrian:0000" in keys["label_id"]["names"]


def relabel(root, folder, name_of):
    for path in (root / folder).glob("*.json"):
        labels = json.loads(path.read_text())["labels"]
        path.write_text(json.dumps({"labels": {name_of(int(name[:6])): part for name, part in labels.items()}}))


def without_frames(root):
    for path in (root / BOXES).glob("*.json"):
        labels = json.loads(path.read_text())["labels"]
        path.write_text(json.dumps({"labels": {n: part for n, part in labels.items() if not 20 < int(n[:6]) < 30}}))


def turn(record):
    record["box"]["rot_z"] += 3.14159


def into_corners(record):
    x, y, w, h = record["box"]
    record["box"] = [x, y, x + w, y + h]


def boxes(alter):
    return lambda root: [change(root, folder, alter) for folder in (BOXES, SOCIAL, REASONING)]


ALTERED = {
    "2019 numbering": (lambda root: relabel(root, BOXES, lambda frame: f"{frame + 2:06}.jpg"), "train (2019)"),
    "reversed heading": (lambda root: change(root, "labels/labels_3d", turn), "reversed headings"),
    "no attributes": (boxes(lambda record: record.pop("attributes")), "no attributes.occlusion"),
    "renamed folder": (lambda root: (root / BOXES).rename(root / "labels/boxes"), "boxes looks like the layer 2d"),
    "one camera": (lambda root: one_camera(root), "files of single cameras only"),
    "floats for ints": (
        boxes(lambda record: record["social_group"].update(cluster_ID=record["social_group"]["cluster_ID"] + 0.0)),
        "float in social_group.cluster_ID",
    ),
    "missing frames": (without_frames, "missing frames"),
    "missing layer": (lambda root: shutil.rmtree(root / "labels/labels_3d"), "3d nothing"),
    "texts for numbers": (
        boxes(lambda record: record.update(action_label={k: str(v) for k, v in record["action_label"].items()})),
        "str in action_label",
    ),
    "no actions": (boxes(lambda record: record.pop("action_label")), "no action_label"),
    "another label": (boxes(lambda record: record.update(action_label={"juggling": 1})), "juggling"),
    "boxes as corners": (boxes(into_corners), "corners"),
    "one camera in the usual folder": (
        lambda root: one_camera(root, BOXES),
        "stitched has files of single cameras only",
    ),
    "zipped layer": (lambda root: zipped(root / "labels/labels_3d"), "labels/labels_3d.zip is an archive"),
    "no 3D boxes": (lambda root: shutil.rmtree(root / "labels/labels_3d"), "; without 3d (labels_3d)"),
    "no panoramas": (
        lambda root: (root / "images").rename(root / "IMAGES"),
        "; without images (images/image_stitched/",
    ),
    "no labels": (
        lambda root: shutil.rmtree(root / "labels"),
        "holds nothing to load: no files SEQUENCE.json in labels_2d",
    ),
    "swapped levels": (lambda root: swap_levels(root), "labels_2d_stitched/labels looks like the layer 2d"),
    "no JSON": (lambda root: next((root / BOXES).glob("*")).write_text("{"), "JSON"),
}
"""By alteration, the change of a root and what `load` prints about it."""


def zipped(folder):
    shutil.make_archive(folder, "zip", folder)
    shutil.rmtree(folder)


def one_camera(root, name="labels/labels_2d"):
    for layer in ("labels_2d_activity_social_stitched", "labels_2d_stitched_new_version", "labels_3d"):
        shutil.rmtree(root / "labels" / layer)
    (root / BOXES).rename(root / name)
    for path in sorted((root / name).glob("*")):
        path.rename(path.with_stem(path.stem + "_image0"))


def swap_levels(root):
    (root / BOXES).rename(root / "boxes")
    (root / "labels_2d_stitched").mkdir()
    (root / "boxes").rename(root / "labels_2d_stitched/labels")


def loaded_text(root, store):
    """Return all that `load` prints, without borders and line breaks."""
    _, out, err = run("load", root, "--store", store)
    return re.sub(r"[^\S ]|[│┃]", " ", out + err)


@pytest.mark.parametrize("name", ALTERED)
def test_load_names_how_a_copy_differs(sample, root, tmp_path, name):
    alter, text = ALTERED[name]
    plain = " ".join(loaded_text(sample, tmp_path / "plain").split())
    alter(root)
    assert text not in plain
    assert text in " ".join(loaded_text(root, tmp_path / "store").split())


def rename_layers(root):
    shutil.rmtree(root / "labels" / "labels_3d")
    for index, folder in enumerate(sorted((root / "labels").iterdir())):
        folder.rename(folder.with_name(f"mine-{index}"))


def nest_layers(root):
    for folder in sorted((root / "labels").iterdir()):
        folder.rename(root / "layer")
        folder.mkdir()
        (root / "layer").rename(folder / folder.name)


@pytest.mark.parametrize("alter", [rename_layers, nest_layers, lambda root: (root / "labels").rename(root / "mine")])
def test_a_root_of_other_folders_loads_as_the_message_says(root, tmp_path, alter):
    alter(root)
    code, _, err = run("load", root, "--store", tmp_path / "store")
    options = re.findall(r"--layer-dir (\w+=\S+)", err)
    assert code == 1 and {option.partition("=")[0] for option in options} >= {"2d", "pose", "panoptic"}, err
    given = [part for option in options for part in ("--layer-dir", option)]
    code, out, err = run("load", root, "--store", tmp_path / "store", *given)
    assert code == 0, err
    assert "pose" in out and "panoptic" in out


def test_a_folder_of_roots_names_them(root, tmp_path):
    (tmp_path / "jrdb/splits").mkdir(parents=True)
    root.rename(tmp_path / "jrdb/splits/test_dataset")
    code, _, err = run("load", tmp_path / "jrdb", "--store", tmp_path / "store")
    assert code == 1 and err.endswith(f": give {tmp_path}/jrdb/splits/test_dataset\n"), err


def described(root):
    """Return the fingerprint of a root without what no root repeats: sizes of files, and files that `load` ignores."""
    folders = msgspec.to_builtins(fingerprint(root))["folders"]
    return {name: {key: value for key, value in part.items() if key != "files"} for name, part in folders.items()}


def write_twin(root, twin):
    assert run("load", root, "--fingerprint", twin.with_suffix(".json"))[0] == 0
    code, _, err = run("sample", twin, "--like", twin.with_suffix(".json"))
    assert code == 0, err
    return twin


NOT_DESCRIBED = {"reversed heading", "boxes as corners", "zipped layer"}
"""Alterations that are not in a fingerprint, because it has no number and no name of a file that is no label file."""


@pytest.mark.parametrize("name", sorted(ALTERED.keys() - NOT_DESCRIBED))
def test_a_sample_like_a_fingerprint_reproduces_what_load_prints(root, tmp_path, name):
    alter, text = ALTERED[name]
    alter(root)
    twin = write_twin(root, tmp_path / "twin")
    assert described(twin) == described(root)
    assert text in " ".join(loaded_text(twin, tmp_path / "store").split())


def test_a_sample_like_a_fingerprint_has_each_layer_and_nothing_refused(root, tmp_path):
    def rows(folder):
        text = loaded_text(folder, tmp_path / "store")
        assert "0 refused or skipped" in " ".join(text.split())
        return re.findall(r"(\w+) +1 train(?: \(2022\))? +([0-9,]+)", text)

    twin = write_twin(root, tmp_path / "twin")
    assert rows(twin) == rows(root) and len(rows(root)) == 12
    again = write_twin(root, tmp_path / "again")
    for path in sorted(twin.rglob("*.*")):
        assert path.read_bytes() == (again / path.relative_to(twin)).read_bytes()


@needs_real
def test_a_sample_like_real_annotations_has_their_keys_and_frames(tmp_path):
    copy_real(tmp_path, 0, 3)
    twin = write_twin(tmp_path / "root", tmp_path / "twin")
    assert described(twin) == described(tmp_path / "root")


def test_of_a_large_copy_a_share_of_the_records_is_written(root, tmp_path):
    copy = msgspec.to_builtins(fingerprint(root))

    def enlarge(kind):
        kind["types"] = {name: count * 1000 for name, count in kind["types"].items()}
        kind["names"] = {name: count * 1000 for name, count in kind.get("names", {}).items()}
        for part in kind.get("keys", {}).values():
            enlarge(part)

    enlarge(copy["folders"][BOXES]["keys"])
    copy["folders"][BOXES]["labels"] = {f"plaza-{k}.json": [0, 999, 1000] for k in range(10)}
    (tmp_path / "print.json").write_text(json.dumps(copy))
    code, _, err = run("sample", tmp_path / "twin", "--like", tmp_path / "print.json")
    assert code == 0 and float(re.search(r"([0-9.]+)% of the records", err)[1]) < 50, err
    made = described(tmp_path / "twin")[BOXES]
    assert made["labels"] == copy["folders"][BOXES]["labels"]
    assert made["keys"]["keys"]["labels"]["keys"]["000000.jpg"]["keys"]["[]"]["types"]["dict"] > 1000
    assert run("sample", tmp_path / "new", "--like", tmp_path / "print.json", "--no-images")[0] == 2


def of(labels=None, keys=None, path="labels", frames=()):
    folder = {"frames": list(frames), "labels": labels or {}, "files": {}, "keys": keys or {"types": {}}}
    return json.dumps({"format": 2, "folders": {path: folder}})


def nested(depth, **leaf):
    return {"types": {"dict": 1}, "keys": {"a": nested(depth - 1, **leaf)}} if depth else leaf


MANY = 10**12
DEFECTIVE = {
    "not JSON": "{",
    "deep": "[" * 100_000,
    "deep keys": of({"a.json": []}, keys=nested(300, types={"str": MANY})).replace('"a"', '"labels"'),
    "a list": "[]",
    "older format": '{"format": 1, "folders": {}}',
    "text for number": of(keys={"types": {"dict": "many"}}),
    "negative": of(keys={"types": {"dict": -1}}),
    "not UTF-8": b'{"format": 2, "folders": {"\xff": 1}}',
    "folder above": of(path="../../x"),
    "absolute folder": of(path="/tmp/x"),
    "long folder": of(path="x" * 5000),
    "file above": of({"../../y.json": []}),
    "file of no name": of({"..": []}),
    "long file": of({"x" * 900: []}),
    "long key": of({"a.json": []}, keys={"types": {"dict": 1}, "keys": {"x" * 5000: {"types": {"int": 1}}}}),
    "many frames": of({"a.json": [0, MANY, MANY]}),
    "too many frames": of({"a.json": [0, 10**8, 10**8]}),
    "many pictures": of(path="images/image_stitched/plaza", frames=[0, 300_000, 300_001]),
    "frames backwards": of({"a.json": [5, 2, 9]}),
    "long lists": of({"a.json": []}, keys={"types": {"list": 1}, "keys": {"[]": {"types": {"int": MANY}}}}),
    "frames in frames": of(
        {"a.json": [0, 99_999, 100_000]},
        keys={"types": {"dict": 1}, "keys": {"0.jpg": {"types": {"dict": 1}, "keys": {"0.jpg": {}}}}},
    ),
}


@pytest.mark.parametrize("name", DEFECTIVE)
def test_a_file_that_is_no_fingerprint_gets_a_line(tmp_path, name):
    text = DEFECTIVE[name]
    (tmp_path / "print.json").write_bytes(text if isinstance(text, bytes) else text.encode())
    code, out, err = run("sample", tmp_path / "inner" / "twin", "--like", tmp_path / "print.json")
    assert code == 1 and err.count("\n") == 1 and not out, err
    assert not list((tmp_path / "inner").glob("*")) and not list(tmp_path.glob("*x*"))
