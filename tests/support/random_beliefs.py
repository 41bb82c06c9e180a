"""Random episodes and random plans that have a fair chance to be solved in them."""

import itertools

from believed import CIRCLE, Story, planned

FRAMES = (0, 10, 15, 30, 31, 45, 60, 61, 75, 90)
POSES = ("walking", "standing", "sitting")
OTHERS = ("reading", "typing")
LABELS = ("conversation", "hugging", "in the same group as", "front left, close")
PLACES = ("first to the left of (robot view)", "within 30 degrees to the left of (robot view)")
SINGLE = {
    "group_size": (1, 2, 3),
    "sector": ("ahead", "left"),
    "shirt": ("red", "dark blue"),
    "distance": ("close", "far"),
    "distance_m": (3.0, 3.5, 4.0, 4.5, 5.5),
}


def random_story(rng):
    story = Story()
    for frame in FRAMES:
        lefts = [left + 137 * frame for left in CIRCLE]
        match rng.randrange(5):
            case 0:
                story.look(frame, *rng.sample(lefts, rng.randrange(1, 4)))
            case 1:
                story.panorama(frame)
            case 2 | 3:
                # A gap of one column, now and then.
                place = rng.randrange(8)
                lefts[place] += rng.choice((0, 0, 10, 11)) if place else 0
                story.look(frame, *rng.sample(lefts, 8))
    observed = {one["frame"] for one in story.rows["observations"]}
    people = [f"p{n}" for n in range(1, rng.randrange(2, 6))]
    habits = {who: rng.choice(POSES) for who in people}
    for who in people:
        if rng.random() < 0.1:
            habits[who] = None
        for frame in sorted(observed):
            if rng.random() < 0.75:
                sighting(rng, story, who, frame, habits)
        frames = sorted({one["frame"] for one in story.rows["sightings"] if one["entity"] == who})
        for name, values in (("gender", ("female", "male")), ("age", ("childhood", "young adulthood"))):
            if frames and rng.random() < 0.7:
                story.has(who, name, rng.choice(values), rng.choice(frames), current=False)
                story.has(who, name, rng.choice(values), rng.choice(frames))
    for frame in sorted(observed):
        there = sorted({one["entity"] for one in story.rows["sightings"] if one["frame"] == frame})
        for source in there:
            for target in there:
                if source != target and rng.random() < 0.25:
                    story.tie(source, rng.choice(LABELS + PLACES), target, frame, current=rng.random() < 0.85)
    return story


def sighting(rng, story, who, frame, habits):
    if rng.random() < 0.2:
        story.sees(who, frame, current=False)
    story.sees(who, frame)
    if rng.random() < 0.3:
        habits[who] = rng.choice((None, *POSES))
    if habits[who]:
        story.has(who, "action", habits[who], frame)
    for action in (*POSES, *OTHERS):
        if rng.random() < 0.15:
            # Of what was replaced nothing counts; two poses at once are no pose.
            story.has(who, "action", action, frame, current=action in OTHERS or rng.random() < 0.1)
    for name, values in SINGLE.items():
        if rng.random() < 0.6:
            story.has(who, name, rng.choice(values), frame)
        if rng.random() < 0.1:
            story.has(who, name, rng.choice(values), frame, current=False)
    if rng.random() < 0.2:
        story.has(who, "object", rng.choice(("holding: bag", "riding: bike")), frame)
    if rng.random() < 0.2:
        story.has(who, "interaction", rng.choice(LABELS[:2]), frame)


READS = ("action", "attribute", "presence", "distance_change", "next_action")
READS += ("start", "span", "start_view", "seconds_between")


def random_plan(rng, mind, read):
    """Conditions and edges are mostly true of somebody."""
    t0 = rng.choice(FRAMES[:5])
    there = [who for who, frame in mind.sighted if frame == t0]
    cast = [*rng.sample(there, len(there)), "p1", "p2", "p3", "p4"]
    names = "abcd"[: rng.choice((1, 1, 2, 2, 3, 4))]
    who = dict(zip(names, cast, strict=False))
    nodes = {name: [] for name in names}
    for name in names:
        wanted = (1, 2) if name == "a" else (0, 0, 1)
        nodes[name] = [random_condition(rng, mind, who[name], t0) for _ in range(rng.choice(wanted))]
    edges = []
    for source, target in itertools.pairwise(names):
        if len(names) == 4 and rng.random() < 0.5:
            break
        edges.append((source, true_label(rng, mind, who[source], who[target], t0), target, "t0"))
    else:
        if len(names) > 2 and rng.random() < 0.3:
            edges.append((names[0], true_label(rng, mind, who[names[0]], who[names[-1]], t0), names[-1], "t0"))
    if len(edges) < len(names) - 1:
        pairs = ("ab", "ac", "bd", "cd")
        edges = [(s, true_label(rng, mind, who[s], who[t], t0), t, "t0") for s, t in pairs]
    target = names[-1]
    times, at, relation = asked(rng, read, target, t0)
    plan = planned(read, at, {"t0": {"frame": t0}, **times}, nodes, edges, target, relation)
    if read == "attribute":
        plan["answer"]["attribute"] = rng.choice(("gender", "age", *(name for name in SINGLE if name != "distance_m")))
    return plan


def random_condition(rng, mind, who, frame):
    true = [a for a in mind.attributes if a["entity"] == who and a["first"] <= frame <= a["last"]]
    true = [a for a in true if a["name"] != "distance_m"]
    if not true or rng.random() < 0.1:
        return {"attribute": "gender", "value": rng.choice(("female", "male"))}
    fact = rng.choice(true)
    name, value = fact["name"], fact["value"]
    if name in ("gender", "age"):
        return {"attribute": name, "value": value}
    if name == "object":
        verb, _, thing = value.partition(": ")
        return {"object": thing, "verb": verb, "at": "t0"}
    if name in ("action", "interaction"):
        label = rng.choice(LABELS[:2]) if name == "interaction" else value
        return {name: label, "at": "t0"}
    if name == "shirt":
        value = rng.choice((value, value.upper(), value.replace(" ", "  ")))
    return {"attribute": name, "value": int(fact["number"]) if name == "group_size" else value, "at": "t0"}


def true_label(rng, mind, source, target, frame):
    true = [label for label in LABELS + PLACES if mind.related(source, label, target, frame)]
    return rng.choice(true or LABELS)


def asked(rng, read, who, t0):
    later = [frame for frame in FRAMES if frame > t0]
    t1, t2 = sorted(rng.sample(later, 2))
    action, other = rng.sample(POSES + OTHERS[:1], 2)
    start = {"event": "start", "of": who, "action": action, "after": "t0"}
    match read:
        case "action" | "attribute":
            return {"t1": {"frame": t1}}, rng.choice(("t0", "t1")), None
        case "presence" | "distance_change":
            return {"t1": {"frame": t1}, "t2": {"frame": t2}}, rng.choice((["t0", "t1"], ["t1", "t2"])), None
        case "next_action":
            return {"t1": {"event": "end", "of": who, "after": "t0"}}, "t1", None
        case "start" | "start_view":
            return {"t1": start}, "t1", None
        case "span":
            end = {"event": "end", "of": who, "action": action, "after": rng.choice(("t1", "t1", "t1", "t0"))}
            return {"t1": start, "t2": end}, ["t1", "t2"], None
        case "seconds_between" if rng.random() < 0.5:
            second = {"event": "start", "of": who, "action": other, "after": rng.choice(("t0", "t1"))}
            return {"t1": start, "t2": second}, ["t1", "t2"], None
        case "seconds_between":
            leaves = {"event": "leaves", "of": who, "after": "t0"}
            back = {"event": "returns", "of": who, "after": "t1"}
            return {"t1": leaves, "t2": back}, ["t1", "t2"], None
    return {"t1": {"frame": t1}, "t2": {"frame": t2}}, ["t1", "t2"], rng.choice(LABELS + PLACES)
