"""observe: the right pixels, the right words about them, and refusals that say what is allowed."""

import dataclasses
import math
import os
import threading

import cv2
import numpy as np
import pytest
from environment import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from jrdb_avr.engine.observe.observer import Observer, decode_panorama
from jrdb_avr.engine.observe.overlay import draw_people
from jrdb_avr.schema.errors import InputError, ObserveError
from jrdb_avr.schema.method import SequenceInfo
from jrdb_avr.schema.panorama import crop_left

NAME = "cafe-2020-01-01_0"
FRAMES = (0, 15, 30)


def panorama(seed=0):
    """A smooth strip that JPEG keeps well: hue tells the column, rows tell the height."""
    columns = np.arange(3760)
    strip = np.zeros((480, 3760, 3), np.uint8)
    strip[..., 0] = 127 + 120 * np.sin(columns * 2 * np.pi / 3760)
    strip[..., 1] = 127 + 120 * np.cos(columns * 2 * np.pi / 3760)
    strip[..., 2] = (np.arange(480)[:, None] + seed) % 480 / 2
    return strip


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    (folder / NAME).mkdir()
    for frame in FRAMES:
        write(folder / NAME / f"{frame:06d}.jpg", panorama(frame))
    (folder / "outside.jpg").write_bytes((folder / NAME / "000000.jpg").read_bytes())
    return folder


def write(path, image):
    cv2.imwrite(str(path), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])


def info(frames=FRAMES, name=NAME):
    return SequenceInfo(name, 15.0, frames[-1] + 1 if frames else 0, frames)


@pytest.fixture(scope="module")
def observe(root):
    return Observer(root, [info()])


def stored(root, frame):
    return cv2.imread(str(root / NAME / f"{frame:06d}.jpg"))[..., ::-1]


@given(st.floats(-1e6, 1e6), st.sampled_from(FRAMES), st.booleans())
@settings(max_examples=examples(30), deadline=None)
def test_the_crop_is_the_columns_round_the_angle(root, observe, angle, frame, first_look):
    seen = (Observer(root, [info()]) if first_look else observe)(NAME, frame, angle)
    centre = angle / 360 * 3760
    columns = [(round(centre % 3760) - 240 + i) % 3760 for i in range(480)]
    assert seen.image.shape == (480, 480, 3)
    assert seen.image.dtype == np.uint8
    assert np.array_equal(seen.image, stored(root, frame)[:, columns])
    assert seen.left == columns[0] == crop_left(angle)


def test_what_is_said_of_a_crop(observe):
    seen = observe(NAME, 15, -90)
    said = dataclasses.asdict(seen)
    del said["image"]
    assert said == {
        "sequence": NAME,
        "frame_index": 15,
        "timestamp": 1.0,
        "angle_deg": 270.0,
        "fov_deg": 45.96,
        "left": 2580,
    }
    assert [observe(NAME, 15, angle).left for angle in (180, 90, 270, 0)] == [1640, 700, 2580, 3520]


def test_180_is_ahead_and_the_strip_is_whole(root, observe):
    ahead = observe(NAME, 0, 180).image
    assert np.array_equal(ahead, stored(root, 0)[:, 1640:2120])
    fresh = Observer(root, [info()])
    for _ in range(4):
        assert np.array_equal(fresh.panorama(NAME, 0), stored(root, 0))
        fresh(NAME, 0, 10.0)


@pytest.mark.parametrize(
    ("sequence", "frame", "angle", "says"),
    [
        ("nowhere", 0, 0.0, NAME),
        ("../outside", 0, 0.0, NAME),
        ("", 0, 0.0, NAME),
        (None, 0, 0.0, NAME),
        ([], 0, 0.0, NAME),
        (NAME.upper(), 0, 0.0, NAME),
        (NAME + "\0", 0, 0.0, NAME),
        (f"./{NAME}", 0, 0.0, NAME),
        (NAME, 1, 0.0, "the nearest is 0"),
        (NAME, -15, 0.0, "the nearest is 0"),
        (NAME, 29, 0.0, "3 from 0 to 30, the nearest is 30"),
        (NAME, 10**30, 0.0, "the nearest is 30"),
        (NAME, 15.0, 0.0, "no image at frame"),
        (NAME, "15", 0.0, "no image at frame"),
        (NAME, None, 0.0, "no image at frame"),
        (NAME, True, 0.0, "no image at frame"),
        (NAME, 0, math.nan, "no finite number"),
        (NAME, 0, math.inf, "no finite number"),
        (NAME, 0, -math.inf, "no finite number"),
        (NAME, 0, "180", "no finite number"),
        (NAME, 0, None, "no finite number"),
        (NAME, 0, 10**400, "no finite number"),
        (NAME, 0, True, "no finite number"),
    ],
)
def test_refusals_say_what_is_allowed(observe, sequence, frame, angle, says):
    with pytest.raises(ObserveError) as error:
        observe(sequence, frame, angle)
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_names_that_are_paths_are_refused_before_anything_is_read(root):
    for name in ("../x", "a/b", "..", "", "a\0b", "/etc"):
        with pytest.raises(InputError):
            Observer(root, [info(name=name)])


def test_images_are_read_only_and_their_own(observe):
    one, two = observe(NAME, 0, 10.0).image, observe(NAME, 0, 10.0).image
    for image in (one, observe.panorama(NAME, 0)):
        with pytest.raises(ValueError, match="read-only"):
            image[0, 0, 0] = 1
    assert not np.shares_memory(one, observe.panorama(NAME, 0))
    assert one.flags["C_CONTIGUOUS"]
    assert np.array_equal(one, two)


def broken(data):
    return {
        "empty": b"",
        "text": b"not a picture",
        "cut": data[: len(data) // 2],
        "cut at the end": data[:-2],
        "png": cv2.imencode(".png", panorama())[1].tobytes(),
        "header only": data[:400] + b"\xff\xd9",
        "small": cv2.imencode(".jpg", panorama()[:, :1880])[1].tobytes(),
        "tall": cv2.imencode(".jpg", np.zeros((481, 3760, 3), np.uint8))[1].tobytes(),
        "turned": cv2.imencode(".jpg", np.zeros((3760, 480, 3), np.uint8))[1].tobytes(),
    }


def test_broken_files_are_refused_in_one_line(root, tmp_path):
    good = (root / NAME / "000000.jpg").read_bytes()
    (tmp_path / NAME).mkdir()
    observe = Observer(tmp_path, [info((0,))])
    place = tmp_path / NAME / "000000.jpg"
    with pytest.raises(ObserveError, match="No such file"):
        observe(NAME, 0, 0.0)
    for what, data in broken(good).items():
        place.write_bytes(data)
        with pytest.raises(ObserveError, match="000000") as error:
            observe(NAME, 0, 0.0)
        assert "\n" not in str(error.value), what
    # A failure is not remembered.
    place.write_bytes(good)
    assert observe(NAME, 0, 0.0).frame_index == 0


def test_a_header_that_promises_a_giant_is_not_decoded():
    data = bytearray(cv2.imencode(".jpg", np.zeros((480, 3760, 3), np.uint8))[1].tobytes())
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = b"\xff\xff\xff\xff"
    with pytest.raises(ObserveError, match="65535 x 65535"):
        decode_panorama(bytes(data), "giant.jpg")


@given(st.binary(max_size=60))
def test_any_bytes_are_refused(data):
    with pytest.raises(ObserveError):
        decode_panorama(b"\xff\xd8" + data + b"\xff\xd9", "x.jpg")


def test_without_images():
    with pytest.raises(ObserveError, match="no images"):
        Observer(None, [info()])(NAME, 0, 0.0)
    with pytest.raises(ObserveError, match="none"):
        Observer(None, [info(())])(NAME, 0, 0.0)


def test_the_cache_is_bounded_and_used(root, monkeypatch):
    from jrdb_avr.engine.observe import observer as module

    decoded = []
    decode = module.decode_panorama
    monkeypatch.setattr(module, "decode_panorama", lambda data, name: decoded.append(name) or decode(data, name))
    observe = Observer(root, [info()], cached=2)
    for frame in (0, 15, 0, 15, 0):
        observe(NAME, frame, 0.0)
    assert len(decoded) == 2
    observe(NAME, 30, 0.0)  # 15 is the oldest
    observe(NAME, 0, 0.0)
    assert len(decoded) == 3
    observe(NAME, 15, 0.0)
    assert len(decoded) == 4
    assert observe._strips.cache_info().currsize == 2


def test_many_threads_see_what_one_sees(root, monkeypatch):
    from jrdb_avr.engine.observe import observer as module

    decoded = []
    decode = module.decode_panorama
    monkeypatch.setattr(module, "decode_panorama", lambda data, name: decoded.append(name) or decode(data, name))
    observe = Observer(root, [info()])
    start = threading.Barrier(8)
    wrong = []

    def look():
        start.wait()
        for i in range(12):
            frame, angle = FRAMES[i % 3], i * 37.0
            columns = (np.arange(480) + int(crop_left(angle))) % 3760
            if not np.array_equal(observe(NAME, frame, angle).image, truth[frame][:, columns]):
                wrong.append((frame, angle))

    truth = {frame: stored(root, frame) for frame in FRAMES}
    threads = [threading.Thread(target=look) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
    assert len(decoded) == 3


# -- for a person to look at ------------------------------------------------------------------------------------------


def sighting(x, track=3, clear=True):
    return {"track": track, "x": x, "y": 100.0, "w": 60.0, "h": 150.0, "clear": clear, "pose": "sitting", "cluster": 2}


def changed_columns(before, after):
    return set(np.flatnonzero((before != after).any(axis=(0, 2))).tolist())


@pytest.mark.parametrize("x", [500.0, 3730.0, -30.0, 3760.0])
def test_a_box_is_drawn_where_it_is_on_both_sides_of_the_seam(x):
    strip = np.full((480, 3760, 3), 127, np.uint8)
    drawn = changed_columns(strip, draw_people(strip, [sighting(x)]))
    assert {int(x + i) % 3760 for i in (0, 59)} <= drawn
    assert all((column - int(x) + 10) % 3760 < 200 for column in drawn)
    assert (strip == 127).all()


def test_a_box_is_drawn_on_a_crop_over_the_seam(observe):
    seen = observe(NAME, 0, 0.0)  # left column 3520, so stitched column 3730 is column 210
    drawn = changed_columns(seen.image, draw_people(seen.image, [sighting(-30.0)], left=seen.left))
    assert {210, 269} <= drawn
    assert not changed_columns(seen.image, draw_people(seen.image, [sighting(1800.0)], left=seen.left))


def standing(x, code=2, wrapped=False):
    """A pose row: points on a line to the right of `x`; `wrapped`: columns are taken modulo the panorama's width."""
    columns = [(x + 4 * i) % 3760 if wrapped else x + 4 * i for i in range(17)]
    return {"track": 3, "keypoints": [v for i, column in enumerate(columns) for v in (column, 100.0 + 5 * i, code)]}


@pytest.mark.parametrize("wrapped", [False, True])
@pytest.mark.parametrize("x", [500.0, 3730.0, -30.0, 3755.0])
def test_a_skeleton_is_drawn_where_it_is_on_both_sides_of_the_seam(observe, x, wrapped):
    strip = np.full((480, 3760, 3), 127, np.uint8)
    drawn = changed_columns(strip, draw_people(strip, [], [standing(x, wrapped=wrapped)]))
    assert {int(x + 4 * i) % 3760 for i in range(17)} <= drawn
    # No line leads across the strip.
    assert all((column - int(x) + 10) % 3760 < 90 for column in drawn)
    seen = observe(NAME, 0, 0.0)
    crop = changed_columns(seen.image, draw_people(seen.image, [], [standing(x, wrapped=wrapped)], seen.left))
    left = {(column - seen.left) % 3760 for column in drawn}
    assert crop == {column for column in left if column < 480}


def test_points_that_are_not_visible_are_not_drawn():
    strip = np.full((480, 3760, 3), 127, np.uint8)
    assert not changed_columns(strip, draw_people(strip, [], [standing(500.0, 0)]))
    half = standing(500.0)
    half["keypoints"][3 * 9 :] = [0.0] * 24
    assert max(changed_columns(strip, draw_people(strip, [], [half]))) < 540
    assert min(changed_columns(strip, draw_people(strip, [], [half]))) > 490


@pytest.mark.parametrize("number", [10**5000, -(10**5000)], ids=["large", "small"])
def test_numbers_too_long_to_be_written_are_refused(observe, number):
    with pytest.raises(ObserveError, match="frames with an image"):
        observe(NAME, number, 0)
    with pytest.raises(ObserveError, match="no finite number"):
        observe(NAME, FRAMES[0], number)


def test_a_pipe_in_place_of_an_image_is_not_waited_for(tmp_path):
    (tmp_path / NAME).mkdir()
    os.mkfifo(tmp_path / NAME / "000000.jpg")
    with pytest.raises(ObserveError, match="no whole JPEG"):
        Observer(tmp_path, [info((0,))])(NAME, 0, 180)
