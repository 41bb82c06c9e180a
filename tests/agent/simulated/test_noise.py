"""The simulated model's errors: their rates, how long they last, and that equal pictures are read alike."""

import itertools

import pytest

from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.simulated.noise import CONFUSED, PictureView, Reader
from jrdb_avr.agent.simulated.people import Person
from jrdb_avr.agent.simulated.profiles import PERFECT, PROFILES, changed_errors, parse_errors, profile_of
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.panorama import WIDTH, Box

REALISTIC = PROFILES["realistic"]
N = 2000


def person(track, pose="standing", height=150.0, **labels):
    values = {"pose": {pose}, "gender": {"male"}, "age": {"young adulthood"}, "action": {"reading"}}
    frozen = {name: frozenset(texts) for name, texts in (values | labels).items()}
    return Person(track, Box(100.0, 150.0, height / 2.5, height), frozen, {"same social group": frozenset()}, 5.0)


def read(errors, track, frame=0, left=0.0, **known):
    """One person in one picture; None if missed."""
    view = PictureView("s", frame, left, 480.0)
    everyone = [person(track, **known)]
    return next((one for one in Reader(errors, view).people(everyone) if one.person.track == track), None)


def share(outcomes):
    outcomes = list(outcomes)
    return sum(outcomes) / len(outcomes)


def test_perfect_reads_what_is_annotated():
    seen = read(PERFECT, 7)
    assert (seen.identity, seen.box) == (7, person(7).box)
    assert [seen.label(name) for name in ("gender", "age", "pose")] == ["male", "young adulthood", "standing"]
    assert seen.holds("action", "reading") is True
    assert seen.holds("action", "typing") is False
    # People hold what they read.
    assert seen.holds("action", "holding sth") is None
    assert seen.holds("object", "holding: bag") is None
    assert seen.metres == 5.0


@pytest.mark.parametrize("pose", CONFUSED)
def test_postures_are_confused_at_the_measured_rates(pose):
    other, rate = CONFUSED[pose]
    errors = parse_errors(["miss=0"], REALISTIC)
    poses = [read(errors, track, pose=pose).label("pose") for track in range(N)]
    assert share(one == other for one in poses) == pytest.approx(rate, abs=0.04)
    assert {*poses} == {pose, other}


def test_other_labels_are_dropped_and_added():
    errors = parse_errors(["miss=0"], REALISTIC)
    seen = [read(errors, track) for track in range(N)]
    assert share(one.holds("action", "reading") for one in seen) == pytest.approx(0.7, abs=0.04)
    assert share(one.holds("action", "typing") for one in seen) == pytest.approx(0.05, abs=0.02)
    assert share(one.label("gender") is None for one in seen) == pytest.approx(0.3, abs=0.04)
    assert share(one.label("gender") == "female" for one in seen) == pytest.approx(0.05 * 0.7, abs=0.02)


def test_errors_belong_to_the_person_then_the_frame_then_the_picture():
    errors = parse_errors(["miss=0"], REALISTIC)
    wrong = [
        [read(errors, track, frame, left, pose="walking").label("pose") == "standing"
         for frame, left in ((0, 0.0), (0, 20.0), (15, 0.0))]
        for track in range(N)
    ]  # fmt: skip
    first = [row for row in wrong if row[0]]
    crop, second = share(row[1] for row in first), share(row[2] for row in first)
    assert crop == pytest.approx(0.86, abs=0.05)  # real: 14 of 16
    assert second == pytest.approx(0.67, abs=0.06)  # real: 20 of 28


@pytest.mark.parametrize(("height", "rate"), [(200, 0.16), (100, 0.45), (60, 0.97), (40, 0.98), (23, 1.0)])
def test_small_people_are_missed_more_often(height, rate):
    missed = [read(REALISTIC, track, height=height) is None for track in range(N)]
    assert share(missed) == pytest.approx(rate, abs=0.04)


def test_misses_last():
    pairs = [[read(REALISTIC, track, frame, height=100) is None for frame in (0, 15)] for track in range(N)]
    assert share(second for first, second in pairs if first) == pytest.approx(0.83, abs=0.05)


def test_covered_people_are_missed_more_often():
    front = person(1)
    behind = [Person(track, front.box._replace(h=140.0), person(2).labels) for track in range(2, N)]
    reader = Reader(REALISTIC, PictureView("s", 0, 0.0, 480.0))
    assert all(other.track not in {one.person.track for one in reader.people([front, other])} for other in behind)


def ghosts(frame, left=0.0, width=float(WIDTH), errors=REALISTIC, sequence="s"):
    return {one.identity: one for one in Reader(errors, PictureView(sequence, frame, left, width)).people([])}


def test_ghosts_are_false_people_that_stay():
    everywhere = [Reader(REALISTIC, PictureView(f"s{n}", 30, 0, WIDTH))._ghosts() for n in range(400)]
    assert sum(map(len, everywhere)) / 400 == pytest.approx(4.5, abs=0.3)
    assert all(23 <= one.box.h <= 80 and one.track < 0 for many in everywhere for one in many)
    again = [[one.track for one in Reader(REALISTIC, PictureView(f"s{n}", 45, 0, WIDTH))._ghosts()] for n in range(400)]
    stayed = share(one.track in later for many, later in zip(everywhere, again, strict=True) for one in many)
    assert stayed == pytest.approx(0.75, abs=0.03)
    shown = share(one.track in ghosts(30, sequence=f"s{n}") for n, many in enumerate(everywhere) for one in many)
    assert shown == pytest.approx(0.67, abs=0.04)


def test_boxes_err_by_a_share_of_their_sides_and_mostly_alike_within_a_frame():
    errors = parse_errors(["miss=0"], REALISTIC)
    rows = []
    for track in range(N):
        first, crop, later = (read(errors, track, frame, left).box for frame, left in ((0, 0), (0, 20.0), (15, 0)))
        rows.append((first.x - 100.0, crop.x - 80.0, later.x - 100.0, first.w))
    spread = sorted(abs(row[0]) / 60.0 for row in rows)[N // 2]
    assert spread == pytest.approx(0.05 * 0.82, abs=0.01)  # the median of |t| with two degrees of freedom
    within = sorted(abs(row[0] - row[1]) for row in rows)[N // 2]
    between = sorted(abs(row[0] - row[2]) for row in rows)[N // 2]
    assert within < between / 2


@pytest.mark.parametrize("changes", [["miss=0", "box=0.3"], ["miss=0", "wrong_box=1"]])
def test_a_box_at_the_edge_of_a_picture_can_be_written(changes):
    errors = parse_errors(changes, REALISTIC)
    for track in range(N):
        left, _, right, _ = write_box(read(errors, track, left=(130.0, -349.9)[track % 2]).box, (480, 480))
        assert left < right


def test_one_in_twenty_is_taken_for_another_person_and_one_for_a_new_one():
    everyone = [person(track) for track in range(1, 21)]
    known, other, new, pairs = 0, 0, 0, 0
    for n in range(60):
        named = [
            Reader(REALISTIC, PictureView(f"s{n}", frame, 0, WIDTH))._identities([one.track for one in everyone])
            for frame in (0, 30)
        ]
        for identities in named:
            assert len({*identities.values()}) == len(everyone)
        back = {identity: track for track, identity in named[0].items()}
        for track, identity in named[1].items():
            pairs += 1
            met = back.get(identity)
            known += met == track
            new += met is None
            other += met not in (None, track)
    assert known / pairs == pytest.approx(0.9, abs=0.03)  # real: 40 of 44
    assert other / pairs == pytest.approx(0.05, abs=0.02)
    assert new / pairs == pytest.approx(0.05, abs=0.02)


def test_equal_pictures_are_read_alike_in_any_order():
    everyone = [person(track, height=60.0 + 10 * track) for track in range(1, 12)]

    def listed(people):
        found = Reader(REALISTIC, PictureView("s", 30, 0.0, 480.0)).people(people)
        return [(one.identity, one.box, one.label("pose"), one.holds("action", "reading")) for one in found]

    assert listed(everyone) == listed(everyone[::-1])


def test_profiles():
    assert profile_of("simulated") == REALISTIC
    assert profile_of("simulated:perfect") == PERFECT
    assert profile_of("gpt-x") is None
    assert changed_errors(parse_errors(["seed=3", "box=0.1"])) == {"seed": 3, "box": 0.1}
    with pytest.raises(InputError, match="profiles are perfect, independent"):
        profile_of("simulated:other")
    for text in ("miss=2", "miss=a", "none=1", "miss"):
        with pytest.raises(InputError):
            parse_errors([text])
    with pytest.raises(InputError, match="set twice"):
        parse_errors(["seed=1", "seed=2"])


def test_wrong_values_of_the_independent_profile_are_new_in_each_picture():
    errors = PROFILES["independent"]
    rows = [[read(errors, track, 0, left).label("pose") for left in (0.0, 20.0)] for track in range(N)]
    wrong = [[one != "standing" for one in row] for row in rows]
    assert share(itertools.chain(*wrong)) == pytest.approx(0.1, abs=0.02)
    assert share(second for first, second in wrong if first) == pytest.approx(0.1, abs=0.07)
    assert {*itertools.chain(*rows)} <= {*POSES}
