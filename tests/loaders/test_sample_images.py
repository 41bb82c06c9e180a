"""The sample's panoramas, read back from the JPEG files and compared with the label files, by code of its own."""

import json

import pytest
from click.testing import CliRunner

from jrdb_avr.engine.cli import group
from jrdb_avr.schema.labels import POSES

pytestmark = pytest.mark.slow

SIZES = ("--sequences", "2", "--frames", "150", "--people", "26")


def sample(folder, *options):
    result = CliRunner().invoke(group, ["sample", str(folder), *SIZES, *options])
    assert result.exit_code == 0, result.output
    return folder


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return sample(tmp_path_factory.mktemp("sample") / "root", "--workers", "1")


def test_images_stand_at_keyframes_and_once_per_second_round_a_moment(root):
    """Three per second, also where nothing changes, and the pairs at many places: they do not tell when."""
    for folder in (root / "images" / "image_stitched").iterdir():
        frames = sorted(int(path.stem) for path in folder.glob("*.jpg"))
        seconds = [[frame - start for frame in frames if 0 <= frame - start < 15] for start in range(0, 150, 15)]
        assert all(places[0] == 0 and places[2] == places[1] + 1 and len(places) == 3 for places in seconds)
        assert len({places[1] for places in seconds}) > 3


def test_changes_have_an_image_on_either_side(root):
    for path in (root / "labels" / "labels_2d_stitched").glob("*.json"):
        images = {int(one.stem) for one in (root / "images" / "image_stitched" / path.stem).glob("*.jpg")}
        before, changes = {}, set()
        for key, objects in json.loads(path.read_text())["labels"].items():
            frame = int(key[:6])
            for one in objects:
                poses = [action for action in one.get("action_label", {}) if action in POSES]
                seen, old = before.get(one["label_id"], (-9, None))
                if len(poses) == 1 and seen == frame - 1 and old != poses:
                    changes |= {frame - 1, frame}
                if len(poses) == 1:
                    before[one["label_id"]] = frame, poses
        assert len(changes) > 6
        assert changes <= images


@pytest.mark.parametrize(
    ("option", "count"),
    [(("--images", "keyframes"), 4), (("--images", "all"), 60), (("--no-images",), 0)],
)
def test_fewer_images(tmp_path, option, count):
    folder = sample(tmp_path / "root", "--sequences", "1", "--frames", "60", "--people", "3", *option)
    assert len(list(folder.rglob("*.jpg"))) == count


def test_images_do_not_depend_on_the_workers(tmp_path):
    sizes = ("--frames", "60", "--people", "8")
    one, two = (sample(tmp_path / workers, *sizes, "--workers", workers) for workers in ("1", "2"))
    mine = sorted(path.relative_to(one) for path in one.rglob("*.jpg"))
    assert len(mine) > 20
    assert mine == sorted(path.relative_to(two) for path in two.rglob("*.jpg"))
    assert all((one / path).read_bytes() == (two / path).read_bytes() for path in mine)
