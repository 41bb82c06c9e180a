"""Random worlds in which much happens, and the questions of them in a comparable form."""

import itertools

from worlds import member, person, person_3d, pose


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
