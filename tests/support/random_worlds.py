"""Worlds for `worlds.write_root`: random ones, ones in synonymous labels, and ones built from lines of text."""

from __future__ import annotations

import itertools
import math
import random
import re

from worlds import CATEGORIES, member, person, person_3d, pose, thing

POSES = ("walking", "standing", "sitting")
EXTRA = ("talking to someone", "Opening_the_door", "pushing the door", "impossible", "waving")
OCCLUSION = ("Fully_visible", "Mostly_visible", "Severely_occluded", "Fully_occluded")


def random_world(rng, name="yard-2020-01-01_0"):
    """A world of one sequence; at 15 frames per second, or at one."""
    slow = rng.random() < 0.4
    step = 15 if slow else 1
    first = rng.choice((0, 15, 13)) if slow else rng.randrange(0, 20)
    length = rng.randrange(1, 26) if slow else rng.randrange(1, 300)
    frames = [first + i * step for i in range(length)]
    lost = {f for f in frames if rng.random() < rng.choice((0.0, 0.0, 0.0, 0.03))}
    bare = rng.random() < 0.15
    people = [_life(rng, track, frames) for track in rng.sample((0, 1, 2, 3, 7, 19, 40), rng.randrange(1, 6))]
    layers = {}
    if rng.random() < 0.93:
        layers["2d"] = {f: _frame_2d(rng, f, people, bare) for f in frames if f not in lost}
    if rng.random() < 0.8 or not layers:
        every = 15 if rng.random() < 0.2 else 1
        layers["3d"] = {f: _frame_3d(rng, f, people) for f in frames if f not in lost and f % every == first % every}
        if not layers["3d"]:
            layers["3d"] = {frames[0]: []}
    if rng.random() < 0.2:
        layers["images"] = sorted(rng.sample(range(first + length * step), min(2, length)))
    if not any(layers.get(layer) for layer in ("2d", "3d")):
        layers["2d"] = {frames[0]: []}
    # A source of its own: the layers above do not depend on those below.
    layers |= _more_layers(random.Random(rng.getrandbits(64)), frames, lost, people, "2d" in layers)
    return {name: layers}


def _more_layers(rng, frames, lost, people, boxed):
    layers = {}
    lives = [_social_life(rng, frames, life) for life in people]
    known = [f for f in frames if f not in lost or rng.random() < 0.5]
    if rng.random() < 0.6:
        step = rng.choice((1, 1, 15))
        layers["social"] = {f: _frame_social(rng, f, people, lives, "H-interaction") for f in known[::step]}
    # Only beside 2D boxes of their own: a reasoning file alone is tested by name.
    if rng.random() < 0.5 and boxed:
        step = rng.choice((1, 1, 15))
        alias = rng.choice(("HHI", "H-interaction"))
        layers["reasoning"] = {f: _frame_reasoning(rng, f, people, lives, alias) for f in known[::step]}
    if rng.random() < 0.5:
        layers["pose"] = {f: _frame_pose(rng, f, people) for f in frames[:-1] or frames}
    if rng.random() < 0.5:
        layers["panoptic"] = {f: _frame_panoptic(rng) for f in frames[:: 15 if frames[-1] - frames[0] > 30 else 1]}
    if rng.random() < 0.5:
        start, pace = rng.choice((0.0, 1549500000.0)), rng.choice((1 / 15, 0.07))
        late = rng.choice((0, 0, 3))
        times = {f: start + f * pace + rng.choice((0.0, 0.001)) for f in range(late, frames[-1] + 5)}
        layers["timestamps"] = {"images": {f: t for f, t in times.items() if rng.random() < 0.95}}
        layers["timestamps"] |= {"clouds": times} if rng.random() < 0.5 else {}
        if not layers["timestamps"]["images"]:
            del layers["timestamps"]
    return {layer: content for layer, content in layers.items() if content}


GENDERS = ({"Male": "1"}, {"Female": "1"}, {"Female": 2}, {"Male": "3"}, {"impossible": "1"}, {}, {"Male": "x"})
AGES = ({"Young_Adulthood": "1"}, {"Middle_Adulthood": 1.0}, {"young": "2"}, {"Late_Adulthood": "3"}, {"Ageless": "1"})
RACES = ({"Others": "2"}, {"Caucasian/White": "1"}, {"impossible": "1"})
TALK = ("conversation", "walking together", "standing together together", "looking_at something together", "juggling")
VENUES = ({"indoor_room/class": "1"}, {"indoor:room/class": "2"}, {"outdoor_street": "1"}, {"indoor_street": "3"})
AIMS = ({"socializing": "1"}, {"socializing&commuting": "1"}, {"unknown": "1"}, {"navigating": 2, "wandering": "3"})
AROUND = ({"table": "1", "board": "2"}, {"food-truck": "1"}, {"food_truck": 1, "food truck": "2"}, {})
VERBS = ("holding", "looking_into", "looking into", "finding something", "polishing")


def _social_life(rng, frames, life):
    """Per frame of a person: what the social and reasoning files say. Most of it stays, some flickers."""
    scale = 1 if len(frames) < 2 or frames[1] - frames[0] == 1 else 0.15
    mine = {"gender": rng.choice(GENDERS), "age": rng.choice(AGES), "race": rng.choice(RACES)}
    others = [{**mine, "gender": rng.choice(GENDERS)}, {**mine, "age": rng.choice(AGES)}, {"gender": mine["gender"]}]
    group = {"venue": rng.choice(VENUES), "aim": rng.choice(AIMS), "SSC": rng.choice(AROUND), "BPC": {"floor": "1"}}
    groups = [group | {"venue": rng.choice(VENUES)}, group | {"aim": rng.choice(AIMS)}, {"location_pre": {"at": "1"}}]
    friends = (0, 1, 2, 3, 7, 19, 40)
    talks = [
        [(rng.choice(friends), {rng.choice(TALK): rng.choice(("1", 2, "3"))}) for _ in range(rng.randrange(1, 4))]
        for _ in range(2)
    ]
    talks.append([*talks[0], *talks[0], (rng.choice(friends), {"conversation": "x", "hugging": "1"})])
    holds = [
        [((rng.randrange(3), rng.choice((*CATEGORIES, 12))), {rng.choice(VERBS): rng.choice(("1", "2", "3"))})]
        for _ in range(3)
    ]
    holds.append([*holds[0], *holds[1], (("1", "40"), {"holding": "1", "touching": 2})])
    pieces = {
        "told": _pieces(rng, frames, (mine,) * 8 + (*others, [], None), (5, 60), scale),
        "info": _pieces(rng, frames, (group,) * 6 + (*groups, [], None), (5, 60), scale),
        "talk": _pieces(rng, frames, (*talks * 3, [], [], None), (1, 25), scale),
        "hold": _pieces(rng, frames, (*holds * 2, [], [], None), (1, 25), scale),
    }
    return {
        frame: {key: values[i] for key, values in pieces.items()} for i, frame in enumerate(frames) if frame in life
    }


def _entries(track, talks):
    """What a record says of its partners: nobody is one's own."""
    return None if talks is None else [(partner, labels) for partner, labels in talks if partner != track]


def _frame_social(rng, frame, people, lives, alias):
    rows = []
    for life, social in zip(people, lives, strict=True):
        if frame in life and rng.random() < 0.99:
            here, said = life[frame], social[frame]
            talk = _entries(here["track"], said["talk"])
            rows.append(member(here["track"], here["box"], said["told"], talk, said["info"], alias=alias))
    return rows


def _frame_reasoning(rng, frame, people, lives, alias):
    rows = []
    for life, social in zip(people, lives, strict=True):
        if frame in life and rng.random() < 0.99:
            here, said = life[frame], social[frame]
            told = None if rng.random() < 0.5 else said["told"]
            talk = _entries(here["track"], said["talk"])
            rows.append(member(here["track"], here["box"], told, talk, said["info"], said["hold"], alias=alias))
    return rows + rows[:1] if frame % 50 == 3 else rows


def _frame_pose(rng, frame, people):
    codes = [0] * 17
    rows = []
    for life in people:
        if frame in life and rng.random() < 0.7:
            head = rng.choice(((2, 2, 2), (0, 1, 0), (1, 0, 2), (0, 0, 0)))
            rows.append(pose(life[frame]["track"], float(life[frame]["box"][0]), 100.0, [*head, *codes[3:]]))
    return rows


def _frame_panoptic(rng):
    rows = [thing(None, 4)]
    for track in range(3):
        where = rng.choice(("tracking_id", "attributes.tracking_id", "attributes.floor_id"))
        for category in rng.sample((40, 57, 63, 71, 900), rng.randrange(0, 3)):
            box = {} if category != 71 or track else {"bbox": None}
            rows.append(thing(track, category, (1900 * track - 20, 20, 30, 40), where, **box))
    return rows


def _life(rng, track, frames):
    """Per frame of a person: None, or a dict of what holds there. Things change by pieces, as in life."""
    calm = rng.random() < 0.6
    step = frames[1] - frames[0] if len(frames) > 1 else 1
    scale = 1 if step == 1 else 0.15
    x, spot = rng.uniform(-100, 3800), [rng.uniform(-4, 4), rng.uniform(-4, 4), rng.choice((0.0, 0.0, 0.1, 2.0))]
    heading, drift = rng.uniform(-4, 4), rng.choice((0.0, 0.5, 3.0, -3.0))
    pieces = {
        "present": _pieces(rng, frames, (True,) * (12 if calm else 3) + (False,), (6, 120), scale),
        "blink": _pieces(rng, frames, (True,) * (200 if calm else 20) + (False,), (1, 9), scale),
        "pose": _pieces(rng, frames, POSES[: rng.randrange(2, 4)], (25, 80), scale),
        "code": _pieces(rng, frames, (1, 1, 2, "1", 2.0) + (() if calm else (3, "x")), (4, 60), scale),
        "extra": _pieces(rng, frames, (None, *rng.sample(EXTRA[:3] if calm else EXTRA, 2)), (5, 60), scale),
        "slip": _pieces(rng, frames, (None,) * (200 if calm else 12) + ("no pose", "two", "none"), (1, 10), scale),
        "cluster": _pieces(rng, frames, (5, 6, rng.randrange(7, 9), None) if not calm else (5,), (10, 80), scale),
        "stat": _pieces(rng, frames, (1, 1, 2, 3), (10, 80), scale),
        "hidden": _pieces(rng, frames, (*OCCLUSION[:2] * (30 if calm else 2), *OCCLUSION[2:], None), (5, 60), scale),
        "points": _pieces(rng, frames, (120, 40, 1, 0, None), (5, 40), scale),
    }
    size = (60, 200) if calm else rng.choice(((60, 200), (12, 40), (480, 480), (481, 200), (30, 39), (50, 120)))
    life = {}
    for i, frame in enumerate(frames):
        x += drift * step + rng.choice((0, 0.5, -0.5))
        spot[0] += rng.choice((0.0, 0.01, -0.01)) * step
        heading += rng.choice((0.0, 0.02, -0.02)) * step
        if not pieces["present"][i] or not pieces["blink"][i]:
            continue
        here = {key: values[i] for key, values in pieces.items()}
        column = round((x + 200) % 4000 - 200, 1)
        life[frame] = here | {"box": (column, 90 if calm or rng.random() < 0.99 else -1, *size)}
        life[frame] |= {"spot": tuple(spot), "heading": heading, "track": track}
    return life


def _pieces(rng, frames, values, lengths, scale):
    out = []
    while len(out) < len(frames):
        count = max(1, round(rng.randrange(*lengths) * scale))
        out += [rng.choice(values)] * count
    return out


def _frame_2d(rng, frame, people, bare):
    rows = [_record_2d(rng, life[frame], bare) for life in people if frame in life]
    rng.shuffle(rows)
    if rng.random() < 0.01:
        rows.append({"label_id": "person:-1", "box": [1, 1, 50, 50]})
    if rows and rng.random() < 0.01:
        rows.append(rows[0] | {"box": [9, 9, 99, 99]})
    if rng.random() < 0.003:
        rows.append({"label_id": "pedestrian:77", "box": [1, 1, rng.choice((0, -5)), 50]})
    return rows


def _record_2d(rng, here, bare):
    actions = {here["pose"]: here["code"]}
    if here["slip"] == "no pose":
        actions = {"talking to someone": 1}
    if here["slip"] == "two":
        actions = {"bending": 1, "sitting": here["code"]}
    if here["extra"]:
        actions[here["extra"]] = rng.choice((1, 2, 3)) if rng.random() < 0.05 else 1
    if here["slip"] == "none":
        actions = rng.choice(({}, None))
    attributes = {"interpolated": False, "no_eval": rng.random() < 0.01, "occlusion": here["hidden"]}
    if here["hidden"] is None:
        del attributes["occlusion"]
    group = None if here["cluster"] is None else (here["cluster"], here["stat"])
    return person(here["track"], here["box"], actions, group, None if bare else attributes)


def _frame_3d(rng, frame, people):
    rows = []
    for life in people:
        if frame in life and rng.random() < 0.98:
            here = life[frame]
            distance = None if rng.random() < 0.3 else round(math.hypot(*here["spot"][:2]), 2)
            x, y, z = here["spot"]
            rows.append(person_3d(here["track"], x, y, z, here["heading"], here["points"], distance))
    return [*rows, rows[0] | {"label_id": "Pedestrian:1"}] if rows and frame % 50 == 7 else rows


def lively_world(rng, name):
    """A world annotated once a second in which much can be asked: few words, many changes, people who come and go."""
    frames = [15 * i for i in range(rng.randrange(12, 30)) if rng.random() < 0.99]
    layers = {"2d": {frame: [] for frame in frames}, "3d": {frame: [] for frame in frames}}
    for track in range(1, rng.randrange(3, 7)):
        x, radius = rng.uniform(0, 3760), rng.uniform(2, 9)
        pose, extra, code, here, group = "standing", None, 1, rng.random() < 0.7, 1
        for frame in frames:
            here = here if rng.random() < 0.93 else not here
            pose = rng.choice(("walking", "standing", "sitting")) if rng.random() < 0.15 else pose
            extra = rng.choice((None, "reading", "eating sth")) if rng.random() < 0.12 else extra
            code = 3 if rng.random() < 0.02 else 1
            group = rng.choice((1, 1, 2)) if rng.random() < 0.1 else group
            x, radius = x + rng.uniform(-30, 30), max(0.6, radius + rng.choice((0, 0, 0.1, 0.7, -0.7)))
            if not here:
                continue
            actions = {pose: code} | ({extra: 1} if extra else {})
            box = (round(x % 3760, 1), 100, 50, 37 if rng.random() < 0.02 else 150)
            layers["2d"][frame].append(person(track, box, actions, (group, 1)))
            if rng.random() < 0.95:
                layers["3d"][frame].append(person_3d(track, round(radius, 2), 0.0, distance=round(radius, 2)))
    if rng.random() < 0.2:
        layers["images"] = sorted(rng.sample(frames, len(frames) - 2))
    return {name: layers}


def sociable_world(rng, name):
    """A world annotated once a second in which people move, keep their postures for long, meet and hold things."""
    frames = [15 * i for i in range(rng.randrange(18, 32)) if rng.random() < 0.995]
    world = {layer: {frame: [] for frame in frames} for layer in ("2d", "3d", "social", "reasoning", "pose")}
    tracks = range(1, rng.randrange(5, 9))
    meets = {}  # (frame, pair) -> label
    for pair in itertools.combinations(tracks, 2):
        label = None
        for frame in frames:
            if rng.random() < 0.12:
                label = rng.choice((None, None, None, "conversation", "conversation", "walking together"))
            meets[frame, pair] = label
    for track in tracks:
        x, drift = rng.uniform(0, 3760), 0
        spot, heading = [rng.uniform(-5, 5), rng.uniform(-5, 5)], rng.uniform(-3, 3)
        poses = []
        while len(poses) < 60:
            poses += [rng.choice(("walking", "standing", "sitting", "bending"))] * rng.choice((4, 6, 12, 14))
        poses = poses[rng.randrange(10) :]
        told = {"gender": {rng.choice(("Male", "Female")): "1"}, "age": {"Young_Adulthood": rng.choice(("1", "3"))}}
        extra, thing, group, away = None, None, rng.randrange(1, 5), 0
        for second, frame in enumerate(frames):
            drift = rng.choice((0, 0, 0, 40, -40, 110)) if rng.random() < 0.15 else drift
            x, heading = x + drift, heading + rng.uniform(-0.2, 0.2)
            spot = [value + rng.uniform(-0.3, 0.3) for value in spot]
            extra = rng.choice((None, None, "reading", "eating sth")) if rng.random() < 0.12 else extra
            thing = rng.choice((None, None, ((1, 57), {"holding": "1"}))) if rng.random() < 0.1 else thing
            group = rng.randrange(1, 5) if rng.random() < 0.03 else group
            away = away - 1 if away else rng.choice((1, 5)) if rng.random() < 0.02 else 0
            if away:
                continue
            code = 3 if rng.random() < 0.01 else 1
            box = (round(x % 3760, 1), 100, 50, 37 if rng.random() < 0.01 else 150)
            actions = {poses[second]: code} | ({extra: 1} if extra else {})
            world["2d"][frame].append(person(track, box, actions, (group, 3 if rng.random() < 0.01 else 1)))
            world["3d"][frame].append(person_3d(track, *spot, 0.0, heading, 0 if rng.random() < 0.02 else 90))
            with_whom = [
                (other, {label: "3" if rng.random() < 0.02 else "1"})
                for other in tracks
                if other != track and (label := meets[frame, (min(track, other), max(track, other))])
            ]
            listed = None if rng.random() < 0.01 else with_whom
            world["social"][frame].append(member(track, box, told, listed))
            world["reasoning"][frame].append(member(track, box, handles=[thing] if thing else []))
            if rng.random() < 0.7:
                world["pose"][frame].append(pose(track, float(box[0])))
    return {name: world}


def form(template, program):
    """The template, with the form where it has several."""
    forms = {'"read":"count"': "gap_count", '"event":"leaves"': "gap_absence"}
    return next((name for mark, name in forms.items() if template == "gap" and mark in program), template)


WORDINGS = {
    "walking": ("walking", "running", "going upstairs", "bending", "going downstairs"),
    "standing": ("standing", "standing", "bending", "scootering", "skating"),
    "sitting": ("sitting", "sitting", "cycling", "bending"),
    "reading": ("reading", "looking at sth", "holding sth", "looking at robot", "talking on the phone"),
    "eating sth": ("eating sth", "holding sth", "looking into sth"),
    "talking to someone": ("talking to someone", "talking on the phone"),
    "conversation": ("conversation", "looking at robot together", "looking at sth together"),
    "walking together": ("walking together", "moving together", "going upstairs together", "cycling together"),
    "looking_at something together": ("looking_at something together", "looking into sth together"),
    "holding": ("holding", "carrying", "using", "handling/manipulating"),
    "looking_into": ("looking_into", "looking_at"),
    "Young_Adulthood": ("Young_Adulthood", "adolescent", "middle_aged", "Late_Adulthood"),
    "Middle_Adulthood": ("Middle_Adulthood", "Late_Adulthood", "child"),
}


def in_other_words(make):
    """A maker of worlds that calls what people do by other words of the same family."""

    def made(rng, name):
        world = make(rng, name)
        words = random.Random(rng.getrandbits(64))
        wordings = {}

        def said(track, label):
            if label not in WORDINGS:
                return label
            if (track, label) not in wordings:
                wordings[track, label] = words.choice(WORDINGS[label])
            return wordings[track, label]

        def worded(value, track):
            if isinstance(value, list):
                return [worded(one, track) for one in value]
            if not isinstance(value, dict):
                return value
            return {said(track, key): worded(one, track) for key, one in value.items()}

        layers = {
            layer: {frame: [worded(row, row.get("label_id")) for row in rows] for frame, rows in content.items()}
            if layer in ("2d", "social", "reasoning")
            else content
            for layer, content in world[name].items()
        }
        return {name: layers}

    return made


def with_chorus(make):
    """A maker of worlds with people who do one thing each in the last frame, so that all these may be choices."""

    def made(rng, name):
        world = make(rng, name)
        frames = world[name]["2d"]
        for n, action in enumerate(("walking", "standing", "sitting", "lying", "skating", "cycling", "pushing")):
            record = person(60 + n, (470 * n + 300, 100, 50, 150), {action: 1})
            frames[max(frames)].append(record)
        return world

    return made


def in_crowds(make):
    """A maker of worlds in which people are occluded for a while, and look at the robot now and then."""

    def made(rng, name):
        world = make(rng, name)
        chance, hidden = random.Random(rng.getrandbits(64)), {}
        for rows in world[name].get("2d", {}).values():
            for row in rows:
                track = row["label_id"]
                if chance.random() < 0.15:
                    hidden[track] = chance.choice((*OCCLUSION[:1] * 4, *OCCLUSION[2:], None))
                if "attributes" in row and track in hidden:
                    row["attributes"] = {**row["attributes"], "occlusion": hidden[track]}
                if row.get("action_label") and chance.random() < 0.2:
                    row["action_label"] = {**row["action_label"], "looking at robot": chance.choice((1, 1, 3))}
        return world

    return made


SEQUENCE = "yard-2020-01-01_0"


LETTERS = {"w": {"walking": 1}, "t": {"standing": 1}, "s": {"sitting": 1}, "?": {"standing": 3}}
LETTERS |= {"u": {"going upstairs": 1}, "b": {"bending": 1}}


def seconds(text):
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def build(lines):
    """The JRDB world of a fixture's lines about people, images and lost seconds."""
    layers = {"2d": {}}
    lost, met, told, lists = (), {}, {}, {}
    for line in lines:
        if line.startswith("images "):
            layers["images"] = [15 * second for second in seconds(line.split()[1])]
        if line.startswith("lost "):
            lost = seconds(line.split()[1])
        if not re.match(r"\d+ \|", line):
            continue
        track, letters, *facts = (part.strip() for part in line.split("|"))
        columns, group, metres, tiny, more = [400.0], None, None, (), {}
        for fact in facts:
            word, _, rest = fact.partition(" ")
            if word == "column":
                columns = [float(part) for part in rest.split()]
            elif word == "group":
                group = (int(rest), 1)
            elif word == "metres":
                metres = rest.split()
            elif word in ("gender", "age"):
                value, when = rest.split()
                told |= {(int(track), second): {word: {value: 1}} for second in seconds(when)}
            elif word == "tiny":
                tiny = seconds(rest)
            else:
                action, when = fact.rsplit(" ", 1)
                if match := re.fullmatch(r"(hard )?(.+) with (\d+)", action):
                    for second in seconds(when):
                        label = {match[2]: 3 if match[1] else 1}
                        met.setdefault((int(track), second), []).append((int(match[3]), label))
                else:
                    more |= {(action, second): 1 for second in seconds(when)}
        for second, letter in enumerate(letters):
            rows = layers["2d"].setdefault(15 * second, [])
            if letter == "-":
                continue
            actions = LETTERS[letter] | {action: 1 for action, when in more if when == second}
            # Whoever has fewer columns than seconds stays at the last.
            column = columns[min(second, len(columns) - 1)]
            box = (column - 25, 100, 50, 20 if second in tiny else 150)
            rows.append(person(int(track), box, actions, group))
            here = int(track), second
            lists.setdefault(15 * second, []).append(member(here[0], box, told.get(here), met.get(here, [])))
            if metres is not None and metres[second] != "x":
                away = float(metres[second])
                solid = layers.setdefault("3d", {}).setdefault(15 * second, [])
                solid.append(person_3d(int(track), away, 0.0, distance=away))
    if met or told:
        layers["social"] = lists
    for layer in {"2d", "3d", "social"} & layers.keys():
        layers[layer] = {frame: rows for frame, rows in layers[layer].items() if frame // 15 not in lost}
    return {SEQUENCE: layers}
