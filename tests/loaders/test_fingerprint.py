"""A fingerprint describes a copy and holds no annotation, and `load` says how to load renamed folders."""

import json
import re
import shutil

import pytest
from processes import run

from jrdb_avr.loaders.fingerprint import fingerprint
from jrdb_avr.loaders.synthetic.write import plan, write

BOXES = "labels/labels_2d_stitched"


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sample")
    list(write(plan(folder / "root", [(60, 4)], 3, "keyframes"), 1))
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
    keys = json.loads(text)["folders"][BOXES]["keys"]["labels"]["000000.jpg"]["[]"]
    assert keys["box"]["lengths"] == [4, 4] and set(keys["box"]["[]"]["types"]) == {"float", "int"}
    assert keys["attributes"]["occlusion"]["names"] and "pedestrian:0000" in keys["label_id"]["names"]


def shifted(root):
    for path in (root / BOXES).glob("*.json"):
        labels = json.loads(path.read_text())["labels"]
        moved = {f"{int(name[:6]) + 2:06}.jpg": objects for name, objects in labels.items()}
        path.write_text(json.dumps({"labels": moved}))


ALTERED = {
    "2019 numbering": shifted,
    "no attributes": lambda root: change(root, BOXES, lambda record: record.pop("attributes")),
    "floats for ints": lambda root: change(
        root, BOXES, lambda record: record.update(box=[x + 0.5 for x in record["box"]])
    ),
    "no actions": lambda root: change(root, BOXES, lambda record: record.pop("action_label", None)),
    "texts for codes": lambda root: change(
        root, BOXES, lambda record: record.update(action_label={k: str(v) for k, v in record["action_label"].items()})
    ),
    "truncated as text": lambda root: change(root, BOXES, lambda record: record["attributes"].update(truncated="true")),
    "another label": lambda root: change(root, BOXES, lambda record: record.update(action_label={"juggling": 1})),
    "another id": lambda root: change(root, BOXES, lambda record: record.update(label_id="rider:1")),
    "renamed folder": lambda root: (root / BOXES).rename(root / "labels" / "boxes"),
    "missing layer": lambda root: shutil.rmtree(root / "labels" / "labels_3d"),
    "one camera": lambda root: [
        path.rename(path.with_stem(path.stem + "_image0")) for path in (root / BOXES).glob("*")
    ],
    "not JSON": lambda root: next((root / BOXES).glob("*.json")).write_text("{"),
}


@pytest.mark.parametrize("name", ALTERED)
def test_an_altered_copy_has_another_fingerprint(sample, root, name):
    def plain(folder):
        # Sizes differ with any change.
        return re.sub(r'"bytes": \[[0-9, ]+\]', "", json.dumps(fingerprint(folder)))

    before = plain(sample)
    assert plain(root) == before
    ALTERED[name](root)
    assert plain(root) != before


def test_a_root_of_renamed_folders_loads_as_the_message_says(root, tmp_path):
    shutil.rmtree(root / "labels" / "labels_3d")
    for index, folder in enumerate(sorted((root / "labels").iterdir())):
        folder.rename(folder.with_name(f"mine-{index}"))
    code, _, err = run("load", root, "--store", tmp_path / "store")
    options = re.findall(r"--layer-dir (\w+=\S+)", err)
    assert code == 1 and {option.partition("=")[0] for option in options} >= {"2d", "pose", "panoptic"}, err
    given = [part for option in options for part in ("--layer-dir", option)]
    code, out, err = run("load", root, "--store", tmp_path / "store", *given)
    assert code == 0, err
    assert "pose" in out and "panoptic" in out
