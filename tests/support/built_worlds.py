"""Worlds built from steps of people, with a store."""

import re

from worlds import member, person, person_3d

SEQUENCE = "yard-2020-01-01_0"


POSES = {"w": {"walking": 1}, "t": {"standing": 1}, "s": {"sitting": 1}, "?": {"standing": 3}}
POSES |= {"u": {"going upstairs": 1}, "b": {"bending": 1}}


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
            actions = POSES[letter] | {action: 1 for action, when in more if when == second}
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
