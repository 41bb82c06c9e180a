"""Words that the oracle knows: written out again from the definitions, as data."""

from __future__ import annotations

import json
import math
import re
from functools import lru_cache, partial
from pathlib import Path

POSES = {
    "walking",
    "standing",
    "sitting",
    "cycling",
    "going upstairs",
    "going downstairs",
    "bending",
    "skating",
    "scootering",
    "running",
    "lying",
}
OTHERS = {
    "holding sth",
    "listening to someone",
    "talking to someone",
    "looking at robot",
    "looking into sth",
    "looking at sth",
    "typing",
    "interaction with door",
    "eating sth",
    "talking on the phone",
    "pointing at sth",
    "reading",
    "pushing",
    "greeting gestures",
    "writing",
    "pulling",
}
ACTIONS = POSES | OTHERS
TOGETHER = tuple(
    """walking together|standing together|conversation|sitting together|going upstairs together|moving together|
    looking at robot together|looking at sth together|walking toward each other|eating together|
    going downstairs together|bending together|holding sth together|cycling together|interaction with door together|
    hugging|looking into sth together|shaking hand|waving hand together|pointing at sth together""".replace(
        "\n    ", ""
    ).split("|")
)
VERBS = set(
    """working|opening|closing|entering|exiting|touching|cleaning|watering|pruning|planting|pushing|pulling|carrying|
    holding|looking at|looking into|looking out|presenting|organizing|leaning|painting|installing|removing|repairing|
    riding|parking|mounting|depositing|placing|warning|blocking|adjusting|constructing|maintaining|
    handling/manipulating|accessing|inspecting|storing|pressing|switching|drinking|refilling|moving|operating|
    displaying|arranging|talking on|browsing/engaging|loading|unloading|transporting|connecting|using|configuring|
    disconnecting|printing/copying|identifying|locating|promoting|advertising|finding_something|putting_something|
    directing|attracting|investigating|exploring|utilizing|understanding|observing|turning|wearing|adorning|replacing|
    matching|collecting|folding|servicing|feeding|climbing|going down|going up""".replace("\n    ", "").split("|")
)
POSTURES = {"sitting", "walking", "standing", "running"}
"""Verbs of the files that no question uses."""
PERSON_CATEGORIES = {"pedestrian", "bicyclist/rider", "child"}
AGES = ("childhood", "adolescence", "young adulthood", "middle adulthood", "late adulthood")

_SAID_TOO = """
going upstairs: walking
going downstairs: walking
running: walking
walking: running
bending: walking, standing, sitting
cycling: sitting
scootering: standing
skating: standing
looking at robot: looking at sth
looking into sth: looking at sth
reading: looking at sth, looking into sth, holding sth
eating sth: holding sth
pushing: holding sth
pulling: holding sth
interaction with door: holding sth
pointing at sth: looking at sth
talking on the phone: holding sth, talking to someone, listening to someone
walking together: moving together
cycling together: moving together
going upstairs together: moving together, walking together
going downstairs together: moving together, walking together
looking at robot together: looking at sth together
looking into sth together: looking at sth together
carrying: holding, handling/manipulating
holding: carrying, using, handling/manipulating
using: handling/manipulating, utilizing
utilizing: using
transporting: carrying
observing: looking at
looking at: observing
handling/manipulating: using
looking into: looking at
"""
SAID_TOO = {
    label: others.split(", ") for label, others in (line.split(": ") for line in _SAID_TOO.strip().splitlines())
}
"""What else may be said in ordinary words of whoever has a label: of them it is unknown, if it is not written."""


def said_too(difficulties):
    """{label: difficulty} as written, and what may be said beside it, which nobody can be sure of."""
    also = {other: None for label in difficulties for other in SAID_TOO.get(label, ())}
    return also | difficulties


TRACK_MAX = 2**31 - 2
PIXEL_MAX = 1e5
METRE_MAX = 1e4
RECORDS_MAX = 1000

FOLDERS = {
    "2d": ("labels_2d_stitched",),
    "social": ("labels_2d_activity_social_stitched", "labels_2d_social"),
    "reasoning": ("labels_2d_stitched_new_version", "labels_2d_stitched_test_new_version1"),
    "3d": ("labels_3d",),
    "pose": ("labels_2d_pose_stitched_coco", "pose_stitched"),
    "panoptic": ("labels_2d_panoptic_stitched_CW", "labels_2d_panoptic_stitched_OW"),
}


class RefusedError(Exception):
    """The file as a whole cannot be used."""


class Found:
    """Rows per annotation table, known frames per layer, and the boxes of a file whose boxes are not its facts."""

    def __init__(self, every=False):
        self.every = every
        self.tables = {}
        self.frames = {}
        self.boxes = {}

    def add(self, table, **row):
        self.tables.setdefault(table, []).append(row)

    def rows(self, table):
        return self.tables.get(table, [])

    def keep(self, records):
        """Of (key, ...) the first of equal keys, or all of them; sorted by key."""
        kept, seen = [], set()
        for record in records:
            if self.every or record[0] not in seen:
                kept.append(record)
            seen.add(record[0])
        return sorted(kept, key=lambda record: record[0])


# -- text to values ------------------------------------------------------------------------------------------------


def parse(data, last=False):
    """Return the value of a JSON text; of equal keys of an object the first counts, or the last.

    Raises RefusedError if the text is not JSON.
    """
    try:
        return json.loads(data.decode("utf-8-sig"), object_pairs_hook=lambda pairs: _members(pairs, last))
    except (ValueError, RecursionError):
        raise RefusedError("not JSON") from None


def _members(pairs, last):
    if last:
        return dict(pairs)
    return dict(reversed(pairs)) if len({key for key, _ in pairs}) < len(pairs) else dict(pairs)


# -- single fields ---------------------------------------------------------------------------------------------------


def number(value):
    """A finite float, else None."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        value = float(value)
    except OverflowError:
        return None
    return value if math.isfinite(value) else None


def whole(value):
    """An int, also from 7.0 and "7", else None."""
    if isinstance(value, str):
        return int(value) if re.fullmatch(r"-?[0-9]{1,19}", value) else None
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    value = number(value)
    return int(value) if value is not None and value == math.floor(value) else None


def code(value):
    """A difficulty 1..3, None if unreadable."""
    value = whole(value)
    return value if value in (1, 2, 3) else None


def flag(value):
    """A bool, also from "true" and "false", else None."""
    if isinstance(value, str) and value.lower() in ("true", "false"):
        return value.lower() == "true"
    return value if isinstance(value, bool) else None


def clean(value):
    """Text that can be printed, else None."""
    return _printed(value) if isinstance(value, str) else None


@lru_cache(1000)
def _printed(text):
    text = "".join(c if c.isprintable() else " " for c in text).strip()
    return text if 0 < len(text) <= 100 else None


@lru_cache(1000)
def plain(label):
    """Lower case, one blank for any of blank, _ and -."""
    return " ".join(label.lower().replace("_", " ").replace("-", " ").split())


def track_of(value):
    """(N, True) of `pedestrian:N`; (None, True) for what is certainly a thing; else (None, False)."""
    if not isinstance(value, str):
        return None, False
    match = re.fullmatch(r"pedestrian:([0-9]{1,10})", value)
    if match and int(match[1]) <= TRACK_MAX:
        return int(match[1]), True
    kind, _, digits = value.partition(":")
    return None, plain(kind) in THINGS and re.fullmatch(r"-?[0-9]+", digits) is not None


def partner_of(value):
    """The N of a pair, as `pedestrian:N`, N or "N"."""
    if isinstance(value, str) and ":" in value:
        return track_of(value)[0]
    value = whole(value)
    return value if value is not None and 0 <= value <= TRACK_MAX else None


def box_of(value):
    """[x, y, w, h] of a usable 2D box, else None."""
    if not isinstance(value, list) or len(value) != 4:
        return None
    box = [number(v) for v in value]
    if any(v is None or abs(v) > PIXEL_MAX for v in box) or box[2] <= 0 or box[3] <= 0:
        return None
    return box


# -- spellings -------------------------------------------------------------------------------------------------------

DOORS = {"opening the door", "pushing the door", "holding the door"}
NOT_TOLD = {"impossible", "unknown"}
TOLD = {"gender": "gender", "age": "age", "race": "ethnicity"}
INFO = {"venue": "venue", "aim": "aim", "BPC": "bpc", "SSC": "ssc", "location_pre": "location", "inter": "inter"}


# The files' words for groups keep their underscores; a word of no list is written with blanks.
GROUP_WORDS = """
cafeteria/dining_hall/food_court open_area/campus open_space/corridor room/class study_space street
wandering discussing_an_object/matter studying/writing/reading/working waiting_for_someone/something socializing
excursion attending_class/lecture/seminar eating/ordering_food commuting navigating
floor chair stairs ground platform grass bike scooter balcony sofa skateboard sidewalk pathway desk street crosswalk
bench road counter pillar bin gate table wall fence door trolley coffee_machine shelves cafeteria room elevator board
stroller statue standboard poster show_case window crutches tree pole building food_truck bus robot baggage
stand_pillar screen forecourt shop cabinet light_street car copy_machine drink_fountain class at
"""
AGE_WORDS = {
    "child": "childhood",
    "adolescent": "adolescence",
    "young": "young adulthood",
    "middle aged": "middle adulthood",
    "elderly": "late adulthood",
}


def action_name(label):
    label = plain(label)
    return "interaction with door" if label in DOORS else label.replace(" something", " sth")


def interaction_name(label):
    label = plain(label).replace(" something", " sth")
    return "standing together" if label == "standing together together" else label


def verb_name(label):
    return {plain(v): v for v in ("finding_something", "putting_something")}.get(plain(label), plain(label))


def all_told(labels, spelled, words):
    """Whether every label of a label object is one of the words: then what it lacks is not so."""
    return isinstance(labels, dict) and all(clean(key) is not None and spelled(clean(key)) in words for key in labels)


def labels_of(value):
    """(label, difficulty) of the members of a label object, broken labels left out."""
    if not isinstance(value, dict):
        return []
    return [(name, code(c)) for name, c in ((clean(k), v) for k, v in value.items()) if name is not None]


# -- layers: file to rows --------------------------------------------------------------------------------------------


def label_frames(value, suffixes):
    """(frame, records) of a label file: the first of equal frames, those with a list."""
    if not isinstance(value, dict) or not isinstance(value.get("labels"), dict):
        raise RefusedError('no object "labels"')
    seen = set()
    for key, records in value["labels"].items():
        match = re.fullmatch(r"([0-9]{6})\.(" + suffixes + ")", key)
        if match and int(match[1]) not in seen:
            seen.add(int(match[1]))
            if isinstance(records, list) and len(records) <= RECORDS_MAX:
                yield int(match[1]), records


def read_2d(value, every=False):
    found = Found(every)
    known, people = {}, []
    for frame, records in label_frames(value, "jpg|jpeg|png"):
        unread, met = False, set()
        for record in records:
            track, told = track_of(record.get("label_id")) if isinstance(record, dict) else (None, False)
            box = box_of(record.get("box")) if track is not None else None
            # The second of two boxes of a person may be somebody else's.
            unread |= not told or (track is not None and box is None) or track in met
            if box is not None:
                met.add(track)
                people.append(((frame, track), record, box))
        if not unread:
            known[frame] = 0
    for (frame, track), record, box in found.keep(people):
        if frame in known:
            known[frame] += 1
        _read_person(found, frame, track, record, box)
    found.frames["2d"] = known
    for layer, flagged in (("actions", "actions"), ("groups", "groups")):
        found.frames[layer] = {}
        for frame in sorted({(row["frame"], row["track"]) for row in found.rows(flagged)}):
            found.frames[layer][frame[0]] = found.frames[layer].get(frame[0], 0) + 1
    return found


def _read_person(found, frame, track, record, box):
    here = {"frame": frame, "track": track}
    attributes = record.get("attributes")
    written = attributes is not None
    attributes = attributes if isinstance(attributes, dict) else {}
    evaluated = attributes.get("no_eval")
    # Who may be left out of evaluation is not known to be visible.
    occlusion = attributes.get("occlusion") if evaluated is None or flag(evaluated) is not None else None
    words = ("Fully_visible", "Mostly_visible", "Severely_occluded", "Fully_occluded")
    actions = [(n, c) for n, c in labels_of(record.get("action_label")) if plain(n) != "impossible"]
    found.add(
        "boxes_2d",
        **here,
        **dict(zip("xywh", box, strict=True)),
        has_attributes=written,
        occlusion=occlusion if isinstance(occlusion, str) and occlusion in words else None,
        truncated=flag(attributes.get("truncated")),
        interpolated=flag(attributes.get("interpolated")),
        no_eval=flag(attributes.get("no_eval")),
        has_actions=bool(actions) and all_told(record["action_label"], action_name, ACTIONS),
        file_id=clean(record.get("file_id")),
    )
    for name, difficulty in actions:
        found.add("actions", **here, action=action_name(name), raw=name, difficulty=difficulty)
    group = record.get("social_group")
    cluster = whole(group.get("cluster_ID")) if isinstance(group, dict) else None
    if cluster is not None and abs(cluster) <= 2**62:
        found.add("groups", **here, cluster=cluster, difficulty=code(group.get("cluster_stat")))
    activities = record.get("social_activity")
    for name, value in activities.items() if isinstance(activities, dict) else ():
        if clean(name) is not None:
            found.add("social_activities", **here, activity=action_name(clean(name)), value=number(value))


def read_3d(value, every=False):
    found = Found(every)
    known, people = {}, []
    for frame, records in label_frames(value, "pcd|pcb"):
        known[frame], unread, here = 0, False, {}
        for record in records:
            track, told = track_of(record.get("label_id")) if isinstance(record, dict) else (None, False)
            box = record.get("box") if track is not None else None
            sides = (
                [number(box.get(k)) for k in ("cx", "cy", "cz", "l", "w", "h", "rot_z")]
                if isinstance(box, dict)
                else []
            )
            usable = sides and all(v is not None and abs(v) <= METRE_MAX for v in sides) and min(sides[3:6]) > 0
            unread |= not told or (track is not None and not usable) or track in here
            if usable:
                here.setdefault(track, []).append(((frame, track), record, sides))
        # Any box may be that of somebody whose record is lost.
        if every or not unread:
            people += [one for records in here.values() for one in records]
    for (frame, track), record, sides in found.keep(people):
        known[frame] += 1
        attributes = record.get("attributes")
        attributes = attributes if isinstance(attributes, dict) else {}
        distance, points = number(attributes.get("distance")), number(attributes.get("num_points"))
        counted = points is not None and 0 <= points < 2**31 and points == math.floor(points)
        found.add(
            "boxes_3d",
            frame=frame,
            track=track,
            **dict(zip(("cx", "cy", "cz", "l", "w", "h", "rot_z"), sides, strict=True)),
            distance=distance if distance is not None and 0 <= distance <= METRE_MAX else None,
            num_points=int(points) if counted else None,
            interpolated=flag(attributes.get("interpolated")),
            no_eval=flag(attributes.get("no_eval")),
        )
    found.frames["3d"] = known
    return found


def read_social(value, every=False, reasoning=False):
    """Demographics, interactions and group info; of a reasoning file also handles.

    Each list is judged alone: a person-frame is listed for interactions (handles) where its list could be read to the
    last entry. A key that is not there means an empty list in a reasoning file, and unknown in a social file.
    """
    found, people, unread = Found(every), [], set()
    for frame, records in label_frames(value, "jpg|jpeg|png"):
        met = set()
        for record in records:
            track, told = track_of(record.get("label_id")) if isinstance(record, dict) else (None, False)
            # The second of two records of a person may be somebody else's.
            if not every and (not told or track in met):
                unread.add(frame)
            if track is not None:
                met.add(track)
                people.append(((frame, track), record))
    for (frame, track), record in found.keep(people):
        here = {"frame": frame, "track": track}
        box = box_of(record.get("box"))
        if box is not None:
            found.boxes[frame, track] = box
        for told in _objects(record.get("demographics_info"), every) if frame not in unread else ():
            for key, attribute in TOLD.items():
                _read_told(found, "demographics", here, attribute, told.get(key))
        for told in _objects(record.get("group_info"), every) if frame not in unread else ():
            for key, attribute in INFO.items():
                _read_told(found, "group_info", here, attribute, told.get(key))
        _read_interactions(found, here, record, reasoning)
        if reasoning:
            _read_handles(found, here, record)
    found.tables["listed"] = [row for row in found.rows("listed") if row["frame"] not in unread]
    for layer in ("demographics", "interactions", "group_info") + (("handles",) if reasoning else ()):
        listed = [row for row in found.rows("listed") if row["layer"] == layer]
        keys = {(row["frame"], row["track"]) for row in [*found.rows(layer), *listed]}
        found.frames[layer] = {}
        for frame, _ in sorted(keys):
            found.frames[layer][frame] = found.frames[layer].get(frame, 0) + 1
    return found


def _read_told(found, table, here, attribute, labels):
    for name, difficulty in labels_of(labels):
        for value in told_values(attribute, name):
            found.add(table, **here, attribute=attribute, value=value, raw=name, difficulty=difficulty)


def _objects(value, every):
    """The object of a list that should hold one at most: its first element."""
    elements = value if isinstance(value, list) else []
    return [item for item in (elements if every else elements[:1]) if isinstance(item, dict)]


@lru_cache(1000)
def told_values(attribute, name):
    """What a label of a person's or a group's attribute says: several aims may be joined; None cannot be told."""
    values = []
    for part in name.split("&") if attribute == "aim" else [name]:
        word = plain(part.replace(":", " ") if attribute == "venue" else part)
        if not word:
            continue
        value = {
            "gender": word,
            "age": AGE_WORDS.get(word, word),
            "ethnicity": word,
            "inter": interaction_name(word),
            "venue": re.sub("^(indoor|outdoor) (.*)", lambda m: f"{m[1]}_{_spelled(m[2])}", word),
        }.get(attribute, _spelled(word))
        values.append(None if word in NOT_TOLD else value)
    return tuple(dict.fromkeys(values))


def _spelled(word):
    return word.replace(" ", "_") if word.replace(" ", "_") in GROUP_WORDS.split() else word


def _read_interactions(found, here, record, reasoning):
    # Two names of one list, and a null says no more than a key that is not there.
    keys = [key for key in record if key in ("H-interaction", "HHI") and record[key] is not None]
    keys = keys if found.every else keys[:1]
    whole_list = bool(keys) or reasoning
    for key in keys:
        entries = record[key]
        whole_list &= isinstance(entries, list)
        for entry in entries if isinstance(entries, list) else ():
            partner = partner_of(entry.get("pair")) if isinstance(entry, dict) else None
            labels = entry.get("inter_labels") if isinstance(entry, dict) else None
            usable = partner is not None and partner != here["track"] and isinstance(labels, dict)
            whole_list &= usable and all_told(labels, interaction_name, TOGETHER)
            for name, difficulty in labels_of(labels) if usable else ():
                label = interaction_name(name)
                if label != "impossible":
                    found.add("interactions", **here, partner=partner, label=label, raw=name, difficulty=difficulty)
    if whole_list:
        found.add("listed", layer="interactions", **here)


def _read_handles(found, here, record):
    entries = [] if record.get("HOI") is None else record["HOI"]
    whole_list = isinstance(entries, list)
    for entry in entries if isinstance(entries, list) else ():
        pair = entry.get("pair") if isinstance(entry, dict) else None
        pair = [partner_of(v) for v in pair] if isinstance(pair, list) and len(pair) == 2 else [None]
        labels = entry.get("inter_labels") if isinstance(entry, dict) else None
        usable = None not in pair and isinstance(labels, dict)
        whole_list &= usable and all_told(labels, verb_name, VERBS | POSTURES)
        for name, difficulty in labels_of(labels) if usable else ():
            if plain(name) == "impossible":
                continue
            here_too = {"object": pair[0], "category_id": pair[1], "verb": verb_name(name)}
            found.add("handles", **here, **here_too, raw=name, difficulty=difficulty)
    if whole_list:
        found.add("listed", layer="handles", **here)


def coco(value):
    """{image id: frame} and the annotations of a COCO file."""
    if not isinstance(value, dict) or not isinstance(value.get("images"), list):
        raise RefusedError('no list "images"')
    if not isinstance(value.get("annotations"), list):
        raise RefusedError('no list "annotations"')
    frame_of = {}
    for image in value["images"]:
        name = image.get("file_name") if isinstance(image, dict) else None
        number_of = whole(image.get("id")) if isinstance(image, dict) else None
        match = re.fullmatch(r"(?:.*[/\\])?([0-9]{6})\.(jpg|jpeg|png)", name) if isinstance(name, str) else None
        if match and number_of is not None and number_of not in frame_of:
            frame_of[number_of] = int(match[1])
    return frame_of, [item for item in value["annotations"] if isinstance(item, dict)]


def read_pose(value, every=False):
    found, poses = Found(every), []
    frame_of, annotations = coco(value)
    for record in annotations:
        frame, track = frame_of.get(whole(record.get("image_id"))), whole(record.get("track_id"))
        points = record.get("keypoints")
        points = [number(v) for v in points] if isinstance(points, list) and len(points) == 51 else [None]
        if frame is None or track is None or not 0 <= track <= TRACK_MAX or None in points:
            continue
        if all(points[i] in (0, 1, 2) for i in range(2, 51, 3)):
            poses.append(((frame, track), points))
    known = dict.fromkeys(sorted(set(frame_of.values())), 0)
    for (frame, track), points in found.keep(poses):
        known[frame] += 1
        found.add("poses", frame=frame, track=track, keypoints=points)
    found.frames["pose"] = known
    return found


def read_panoptic(value, every=False):
    found = Found(every)
    frame_of, annotations = coco(value)
    for category in value["categories"] if isinstance(value.get("categories"), list) else ():
        number_of = whole(category.get("id")) if isinstance(category, dict) else None
        name = clean(category.get("name")) if isinstance(category, dict) else None
        if number_of is not None and name is not None:
            found.add("categories", category_id=number_of, category=category_name(name), raw=name)
    known = dict.fromkeys(sorted(set(frame_of.values())), 0)
    seen = set()
    for record in annotations:
        frame, category = frame_of.get(whole(record.get("image_id"))), whole(record.get("category_id"))
        if frame is None or category is None:
            continue
        inner = record.get("attributes") if isinstance(record.get("attributes"), dict) else {}
        written = [record.get("tracking_id"), inner.get("tracking_id"), inner.get("floor_id")]
        track = next((partner_of(v) for v in written if v is not None), None)
        if track is not None and (frame, category, track) in seen and not every:
            continue
        seen.add((frame, category, track))
        box = record.get("bbox")
        box = [number(v) for v in box] if isinstance(box, list) and len(box) == 4 else [None] * 4
        known[frame] += 1
        found.add(
            "panoptic",
            frame=frame,
            object=track,
            category_id=category,
            **dict(zip("xywh", [None] * 4 if None in box else box, strict=True)),
            area=number(record.get("area")),
        )
    found.frames["panoptic"] = known
    return found


def category_name(raw):
    """The standard name of a category, None outside the vocabulary: letter case and the prefixes t_ and m_ are lost."""
    return STANDARD.get(re.sub(r"^(t|m) ", "", plain(raw)))


CATEGORIES = """
road terrain sky vegetation wall column building stair ceiling barrier/fence crutch fire_extinguisher
big_socket/button airpot controller umbrella animal monitor carpet cabinet jacket emergency_pole helmet peripheral
curtain box document television light_pole board manhole phone ladder waterbottle picture_frames standee store_sign
statues cargo tableware accessory other clock golfcart wall_panel decoration hanging_light window poster lift vent
fountain door_handle floor/walking_path machines child trash_bin shelf car bicycle/scooter bag big_vehicle
chair/sofa pedestrian sign trolley pole/trafficcone bicyclist/rider table skateboard/segway/hoverboard glass
door
"""
STANDARD = {plain(name): name for name in CATEGORIES.split()}
THINGS = {
    plain(word)
    for name in CATEGORIES.split()
    if name not in ("pedestrian", "child", "bicyclist/rider", "other")
    for word in (name, *name.split("/"))
}
"""What the number of a record may be of that is no person."""


def read_stamps(value, sensor, every=False):
    """Timestamps of one sensor: the first of equal frames."""
    found, stamps = Found(every), []
    if not isinstance(value, dict) or not isinstance(value.get("data"), list):
        raise RefusedError('no list "data"')
    for record in value["data"]:
        if isinstance(record, dict):
            stamp = record.get("timestamp")
            text = isinstance(stamp, str) and re.fullmatch(r"[0-9]{1,11}(\.[0-9]{1,20})?", stamp)
            stamp = float(stamp) if text else number(stamp)
            frames = [whole(record.get("frame_id")), *_frames_of_files(record)]
            frames = [f for f in frames if f is not None and 0 <= f <= 999_999]
            if stamp is not None:
                stamps += [(frame, stamp) for frame in (frames if every else frames[:1])]
    for frame, stamp in found.keep(stamps):
        found.add("timestamps", sensor=sensor, frame=frame, timestamp=stamp)
    found.frames["timestamps"] = dict.fromkeys((frame for frame, _ in found.keep(stamps)), 1)
    return found


def _frames_of_files(record):
    """Frames by the names of the pictures or clouds of an entry."""
    for key in ("cameras", "pointclouds"):
        for item in record[key] if isinstance(record.get(key), list) else ():
            url = item.get("url") if isinstance(item, dict) else None
            match = re.fullmatch(r"(?:.*/)?([0-9]{6})\.[a-z]+", url, re.DOTALL) if isinstance(url, str) else None
            if match:
                yield int(match[1])


READ = {
    "2d": read_2d,
    "3d": read_3d,
    "social": read_social,
    "reasoning": partial(read_social, reasoning=True),
    "pose": read_pose,
    "panoptic": read_panoptic,
    "images": partial(read_stamps, sensor="images"),
    "clouds": partial(read_stamps, sensor="clouds"),
}


def read(layer, data, last=False, every=False):
    """The facts of one file. RefusedError where it cannot be used at all."""
    return READ[layer](parse(data, last), every=every)


def read_root(root, sequence):
    """All facts of a sequence under the usual directory names, each layer from the first directory that has it."""
    root, whole_found, files = Path(root), Found(), {}
    # The richer files hold the 2D boxes too, for roots that have no others.
    for layer, folders in {**FOLDERS, "2d": (*FOLDERS["2d"], *FOLDERS["social"], *FOLDERS["reasoning"])}.items():
        paths = [base / name / f"{sequence}.json" for name in folders for base in (root / "labels", root)]
        path = next((p for p in paths if p.exists()), None)
        if path is not None:
            try:
                files[layer] = read(layer, path.read_bytes())
            except RefusedError:
                continue
    for sensor, name in (("images", "frames_img.json"), ("clouds", "frames_pc.json")):
        path = root / "timestamps" / sequence / name
        if path.exists():
            files[sensor] = read(sensor, path.read_bytes())
    if "reasoning" in files and any(files["social"].frames.values() if "social" in files else ()):
        # Where both say something, the social file has the word on everything but handles.
        second = files["reasoning"]
        second.tables = {"handles": second.rows("handles"), "listed": second.rows("listed")}
        second.tables["listed"] = [row for row in second.rows("listed") if row["layer"] == "handles"]
        second.frames = {"handles": second.frames["handles"]}
    for found in files.values():
        for table, rows in found.tables.items():
            whole_found.tables.setdefault(table, []).extend(rows)
        for layer, known in found.frames.items():
            whole_found.frames.setdefault(layer, {}).update(known)
    folder = root / "images" / "image_stitched" / sequence
    if folder.exists():
        whole_found.frames["images"] = {int(p.stem): 1 for p in sorted(folder.glob("*.jpg"))}
    return whole_found
