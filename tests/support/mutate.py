"""Mutations of label files: what transfer errors, other tools, careless hands and ill will make of them.

    mutated, names = mutate(rng, data)

Everything comes from the given `random.Random`. Half of the mutations work on bytes and mostly break the
JSON; the others work on its values and keep it valid.
"""

from __future__ import annotations

import json
import re

_SCALAR = re.compile(rb'"(?:[^"\\]|\\.)*"|-?[0-9][0-9.eE+-]*|true|false|null|NaN')
_MEMBER = re.compile(rb'"((?:[^"\\]|\\.)*)": ?("(?:[^"\\]|\\.)*"|-?[0-9][0-9.eE+-]*|true|false|null)')

WILD = [
    b"NaN",
    b"Infinity",
    b"1e400",
    b"1" + b"0" * 400,
    b"-1",
    b"0",
    b"2147483647",
    b"9223372036854775808",
    b"1" * 5000,
    b"true",
    b"false",
    b"null",
    b'""',
    b'"1.0"',
    b'"x"',
    b'"pedestrian:1"',
    b'"pedestrian:01"',
    b'"pedestrian:99999999999"',
    b'"impossible"',
    b"[]",
    b"{}",
    b"[[]]",
    b'{"": 1}',
    b"01",
    b"undefined",
]
TEXTS = [
    "\u0000",
    "\ud800",
    "é" * 60,
    "😀",
    "\x1b[31m",
    " padded ",
    "/",
    "000000.jpg",
    "999999.jpg",
    "pedestrian:2",
    "Male",
    "walking",
]
JUNK = [b"\xff", b"\xc3\x28", b"\x00", b"\xef\xbb\xbf", b"\xed\xa0\x80", "é".encode(), "\u2028".encode(), b"\\u12"]
KEYS = [
    "label_id",
    "box",
    "attributes",
    "action_label",
    "social_group",
    "H-interaction",
    "HHI",
    "HOI",
    "pair",
    "inter_labels",
    "demographics_info",
    "gender",
    "group_info",
    "image_id",
    "track_id",
    "tracking_id",
    "keypoints",
    "category_id",
    "frame_id",
    "timestamp",
    "labels",
]


def mutate(rng, data):
    """The data after one to three mutations, and their names."""
    names = []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        change = rng.choice(MUTATIONS)
        data = change(rng, data) or b""
        names.append(change.__name__)
    return data, names


# -- bytes -----------------------------------------------------------------------------------------------------


def flip_bytes(rng, data):
    data = bytearray(data)
    for _ in range(rng.randrange(1, 4) if data else 0):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def truncate(rng, data):
    return data[: rng.randrange(len(data) + 1)]


def drop_slice(rng, data):
    at = rng.randrange(len(data) + 1)
    return data[:at] + data[at + rng.randrange(1, 60) :]


def insert_junk(rng, data):
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.choice(JUNK) + data[at:]


def change_scalar(rng, data):
    return _replaced(rng, data, lambda: rng.choice(WILD))


def change_text(rng, data):
    return _replaced(
        rng,
        data,
        lambda: json.dumps(rng.choice(TEXTS), ensure_ascii=rng.random() < 0.5).encode("utf-8", "surrogatepass"),
    )


def nest_deeply(rng, data):
    depth = rng.choice((3, 70, 600, 5000))
    brackets = rng.choice(((b"[", b"]"), (b'{"a":', b"}"), (b"[", b"")))
    return _replaced(rng, data, lambda: brackets[0] * depth + b"1" + brackets[1] * depth)


def repeat_key(rng, data):
    """A member with another value before or behind it."""
    members = list(_MEMBER.finditer(data))
    if not members:
        return data
    member = rng.choice(members)
    again = b'"' + member[1] + b'": ' + rng.choice((*WILD, member[2]))
    pair = [member[0], again]
    rng.shuffle(pair)
    return data[: member.start()] + b", ".join(pair) + data[member.end() :]


def _replaced(rng, data, value):
    scalars = list(_SCALAR.finditer(data))
    if not scalars:
        return data
    scalar = rng.choice(scalars)
    return data[: scalar.start()] + value() + data[scalar.end() :]


# -- values --------------------------------------------------------------------------------------------------------


def _structural(change):
    """A mutation of the parsed value; of what is no JSON (any more) a flip of bytes."""

    def mutation(rng, data):
        try:
            value = json.loads(data)
        except (ValueError, RecursionError):
            return flip_bytes(rng, data)
        places = list(places_of(value)) if isinstance(value, list | dict) else []
        if not places:
            return data
        change(rng, places)
        try:
            return json.dumps(value, ensure_ascii=rng.random() < 0.5).encode("utf-8", "surrogatepass")
        except (ValueError, RecursionError):
            return data

    mutation.__name__ = change.__name__
    return mutation


def places_of(value):
    """Every (container, key) of a value."""
    pending = [value]
    while pending:
        container = pending.pop()
        keys = range(len(container)) if isinstance(container, list) else container
        for key in keys:
            yield container, key
            if isinstance(container[key], list | dict):
                pending.append(container[key])


@_structural
def change_value(rng, places):
    container, key = rng.choice(places)
    others = [None, True, -1, 0, 1.5, 1e300, 10**40, "", "x", "2", [], {}, [1], {"a": 1}, float("nan"), 3, "3"]
    container[key] = rng.choice(others)


@_structural
def drop_value(rng, places):
    container, key = rng.choice(places)
    del container[key]


@_structural
def double_value(rng, places):
    lists = [(container, key) for container, key in places if isinstance(container, list)]
    container, key = rng.choice(lists or places)
    if isinstance(container, list):
        container.insert(rng.randrange(len(container) + 1), container[key])
    else:
        container[rng.choice(KEYS)] = container[key]


@_structural
def rename_key(rng, places):
    named = [(container, key) for container, key in places if isinstance(container, dict)]
    if named:
        container, key = rng.choice(named)
        container[rng.choice((*KEYS, *TEXTS))] = container.pop(key)


@_structural
def shift_number(rng, places):
    """A number a little off, or as another type: facts that look right and are others."""
    numbers = [(c, k) for c, k in places if isinstance(c[k], int | float) and abs(c[k]) < 2**53 and c[k] is not True]
    if numbers:
        container, key = rng.choice(numbers)
        value = container[key]
        container[key] = rng.choice((value + 1, -value, value * 10, value + 0.5, str(value), [value], value == 1))


MUTATIONS = [
    flip_bytes,
    truncate,
    drop_slice,
    insert_junk,
    change_scalar,
    change_scalar,
    change_text,
    nest_deeply,
    repeat_key,
    repeat_key,
    change_value,
    change_value,
    drop_value,
    double_value,
    rename_key,
    shift_number,
]
