"""The mark: every value survives encoding and pixels; nothing unreadable is ever read as something else."""

import random

import cv2
import numpy as np
import pytest
from environment import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from jrdb_avr.schema import markers as marks
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.labels import AGES, GENDERS, INTERACTIONS, OTHER_ACTIONS, POSES
from jrdb_avr.schema.markers import Mark, decode, draw, encode, plate_of, read
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box
from jrdb_avr.schema.things import OBJECTS, VERBS


@st.composite
def any_mark(draw_value):
    partner = draw_value(st.none() | st.integers(0, 4095))
    thing = draw_value(st.none() | st.sampled_from(OBJECTS))
    actions = draw_value(st.sets(st.sampled_from(OTHER_ACTIONS), max_size=2))
    return Mark(
        identity=draw_value(st.integers(0, 4095)),
        gender=draw_value(st.none() | st.sampled_from(GENDERS)),
        age=draw_value(st.none() | st.sampled_from(AGES)),
        pose=draw_value(st.none() | st.sampled_from(POSES)),
        actions=tuple(sorted(actions, key=OTHER_ACTIONS.index)),
        group=draw_value(st.none() | st.integers(0, 254)),
        distance_dm=draw_value(st.none() | st.integers(0, 254)),
        heading_deg=draw_value(st.none() | st.integers(0, 71).map(lambda step: 5 * step)),
        partner=partner,
        interaction=None if partner is None else draw_value(st.sampled_from(INTERACTIONS)),
        object=thing,
        verb=None if thing is None else draw_value(st.sampled_from(VERBS)),
    )


def random_mark(rng):
    partner = rng.random() < 0.5
    return Mark(
        identity=rng.randrange(4096),
        gender=rng.choice(GENDERS),
        age=rng.choice(AGES),
        pose=rng.choice(POSES),
        actions=tuple(sorted(rng.sample(OTHER_ACTIONS, rng.randrange(3)), key=OTHER_ACTIONS.index)),
        group=rng.randrange(255),
        distance_dm=rng.randrange(255),
        heading_deg=rng.randrange(72) * 5,
        partner=rng.randrange(4096) if partner else None,
        interaction=rng.choice(INTERACTIONS) if partner else None,
    )


def first_only(mark):
    """The mark without what its second grid holds."""
    return Mark(mark.identity, mark.gender, mark.age, mark.pose, mark.actions, mark.group, mark.distance_dm)


def is_true(reading, mark):
    """A reading says nothing but what the mark says."""
    return reading.mark == (mark if reading.complete else first_only(mark))


def jpeg(image, quality=95):
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done
    return cv2.imdecode(data, cv2.IMREAD_COLOR)


def overlap(a, b):
    """Intersection over union in the plane."""
    columns = min(a.x + a.w, b.x + b.w) - max(a.x, b.x)
    rows = min(a.y + a.h, b.y + b.h) - max(a.y, b.y)
    shared = max(columns, 0) * max(rows, 0)
    return shared / (a.w * a.h + b.w * b.h - shared)


def scene(rng, width=CROP):
    """A patchy background as bright as backgrounds get."""
    coarse = np.array([[[rng.randrange(30, 180) for _ in range(3)] for _ in range(width // 40)] for _ in range(12)])
    image = cv2.resize(coarse.astype(np.uint8), (width, HEIGHT), interpolation=cv2.INTER_LINEAR)
    noise = np.random.default_rng(rng.randrange(2**32)).integers(-6, 7, image.shape)
    return np.clip(image + noise, 0, 185).astype(np.uint8)


@pytest.mark.slow
@settings(max_examples=examples(30))
@given(any_mark(), st.sampled_from(["first", "tall", "wide"]), st.data())
def test_up_to_three_wrong_cells_are_noticed(mark, layout, data):
    cells = encode(mark, layout, 60, 120)
    places = data.draw(st.sets(st.integers(0, cells.size - 1), min_size=1, max_size=3))
    for place in places:
        cells.ravel()[place] ^= 1
    decoded = decode(cells)
    if decoded is not None:
        # The first grid is whole, so the wrong cells are all in the second.
        assert layout != "first"
        assert not decoded.complete
        assert decoded.mark == first_only(mark)


@settings(max_examples=examples(20), deadline=None)
@given(any_mark(), st.integers(18, 460), st.integers(40, 470), st.data())
def test_what_is_drawn_is_read_through_jpeg(mark, w, h, data):
    x, y = data.draw(st.integers(0, CROP - w)), data.draw(st.integers(0, HEIGHT - h))
    image = np.full((HEIGHT, CROP, 3), data.draw(st.integers(40, 180)), np.uint8)
    draw(image, Box(x, y, w, h), mark)
    if max(w, h) > 127 * min((w - 4) // 7, (h - 4) // 18):
        assert plate_of(w, h) is None
        assert read(jpeg(image)) == []
        return
    for picture in (image, jpeg(image)):
        (reading,) = read(picture)
        assert reading.complete == (plate_of(w, h)[0] != "first")
        assert is_true(reading, mark)
        assert overlap(reading.box, Box(x, y, w, h)) >= 0.9


@pytest.mark.parametrize(("w", "h"), [(17, 200), (200, 39), (8, 20), (1, 1), (20, 300)])
def test_too_small_a_box_has_a_frame_only(w, h):
    image = np.full((HEIGHT, CROP, 3), 100, np.uint8)
    draw(image, Box(50, 60, w, h), Mark(5))
    assert plate_of(w, h) is None
    assert read(image) == []
    assert (image != 100).any()


@pytest.mark.parametrize("x", [3740, 3700, -20, -59, 3759.6])
def test_over_the_seam(x):
    """A wrapped crop and the whole panorama read the same person; the box may pass the right edge."""
    mark = Mark(77, pose="walking", distance_dm=42)
    image = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    box = Box(x, 150, 60, 160)
    draw(image, box, mark)
    (reading,) = read(image, wrap=True)
    assert reading.mark == mark
    turned = Box(reading.box.x + WIDTH * round((x - reading.box.x) / WIDTH), *reading.box[1:])
    assert overlap(turned, box) > 0.9
    crop = np.hstack([image[:, -240:], image[:, :240]])
    (reading,) = read(crop)
    left = (x + WIDTH // 2) % WIDTH - WIDTH // 2 + 240
    assert overlap(reading.box, Box(left, 150, 60, 160)) > 0.9


def test_a_plate_that_touches_the_edges_of_a_picture():
    image = np.full((HEIGHT, 400, 3), 90, np.uint8)
    draw(image, Box(100, 100, 100, 250), Mark(7))
    lit = np.flatnonzero((image.min(axis=2) > marks.BRIGHT).any(axis=0))
    for left, right in ((lit[0], 400), (0, lit[-1] + 1), (lit[0], lit[-1] + 1)):
        (reading,) = read(image[:, left:right])
        assert reading.mark.identity == 7 and abs(reading.box.x + left - 100) < 3


def test_a_panorama_reads_no_mark_twice():
    image = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    for i, x in enumerate(range(0, WIDTH - 60, 47)):
        draw(image, Box(x, 150, 40, 120), Mark(i))
    readings = read(image, wrap=True)
    assert sorted(reading.mark.identity for reading in readings) == list(range(len(range(0, WIDTH - 60, 47))))
    assert [reading.box.x for reading in readings] == sorted(reading.box.x for reading in readings)


@pytest.mark.slow
def test_crowds_noise_and_cuts_give_no_false_reading():
    """Many marks that cover and cut each other, twice through JPEG, with noise: each reading is right."""
    rng = random.Random(1)
    drawn, readings = 0, 0
    for round_ in range(examples(30)):
        image = scene(rng)
        truth = {}
        for identity in rng.sample(range(4096), 30):
            w, h = rng.randrange(12, 160), rng.randrange(30, 330)
            box = Box(rng.randrange(-w + 2, CROP - 2), rng.randrange(-20, HEIGHT - 20), w, h)
            mark = Mark(**{**random_mark(rng).__dict__, "identity": identity})
            draw(image, box, mark)
            truth[identity] = (mark, box)
            drawn += 1
        # Somebody without a mark walks before them.
        cv2.line(image, (rng.randrange(CROP), 0), (rng.randrange(CROP), HEIGHT), (90, 80, 70), rng.randrange(1, 30))
        noise = np.random.default_rng(round_).normal(0, rng.choice([0, 4, 12, 25]), image.shape)
        # Neither side of the noise may make the scene as bright as a plate.
        noisy = np.clip(image + noise, 0, np.maximum(image, 200)).astype(np.uint8)
        for reading in read(jpeg(jpeg(noisy), rng.choice([70, 85, 95]))):
            readings += 1
            mark, box = truth[reading.mark.identity]
            assert is_true(reading, mark)
            assert overlap(reading.box, box) >= 0.8
    assert readings > 0.05 * drawn > 40


@pytest.mark.parametrize(
    "mark",
    [
        *(Mark(4096), Mark(-1), Mark(1, gender="other"), Mark(1, pose="hopping"), Mark(1, actions=("flying",))),
        *(Mark(1, actions=("typing", "reading", "writing")), Mark(1, group=255), Mark(1, distance_dm=255)),
        *(Mark(1, heading_deg=7), Mark(1, heading_deg=360), Mark(1, partner=3), Mark(1, object="bag")),
    ],
)
def test_what_a_mark_cannot_show_is_refused(mark):
    with pytest.raises(InputError):
        draw(np.zeros((HEIGHT, CROP, 3), np.uint8), Box(10, 10, 100, 200), mark)


def test_a_plate_is_the_only_bright_thing():
    for color in marks.FRAME_COLORS:
        gray = cv2.cvtColor(np.array([[color]], np.uint8), cv2.COLOR_RGB2GRAY)[0, 0]
        assert gray < marks.BRIGHT - 20
