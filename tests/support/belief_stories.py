"""Episodes of beliefs: written straight into the world tables, readable ones and random ones, with plans for them."""

import itertools
import json
import uuid
from hashlib import sha256

import pyarrow as pa

from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS
from jrdb_avr.schema.plan import parse_plan

ALWAYS = 10_000_000
_TYPES = {"STRING": pa.string(), "INT64": pa.int64(), "DOUBLE": pa.float64(), "BOOLEAN": pa.bool_()}
_TYPES["UUID"] = pa.string()
_BOX = pa.struct([(name, pa.float64()) for name in "xywh"])
_EMPTY = {"STRING": "", "INT64": 0, "DOUBLE": 0.0, "BOOLEAN": True}
CIRCLE = tuple(470 * k for k in range(8))
"""Left columns of eight crops that show all round."""


class Story:
    """One episode, written a line at a time; its rows are those that `oracle_beliefs.Mind` reads."""

    def __init__(self):
        self.rows = {"observations": [], "sightings": [], "attributes": [], "relations": []}
        self.nodes = {}
        self.kinds = {}
        self._writes = 0

    def look(self, frame, *lefts, width=480):
        for left in lefts:
            name = f"o{len(self.rows['observations']) + 1}"
            self.rows["observations"].append({"name": name, "frame": frame, "left": left % 3760, "width": width})
        return self

    def panorama(self, frame):
        return self.look(frame, 0, width=3760)

    def sees(self, entity, *frames, box=None, current=True, **attributes):
        """Sightings of an entity, with attributes at each frame; a list holds several values."""
        for frame in frames:
            if all(one["frame"] != frame for one in self.rows["observations"]):
                self.look(frame, 1000)
            self._writes += 1
            place = box or (100.0 + self._writes, 50.0, 40.0, 120.0)
            row = {"box": place, "angle": 10.0 + self._writes, "write": self._writes, "current": current}
            self.rows["sightings"].append({"entity": entity, "frame": frame, **row})
            for name, values in attributes.items():
                for value in values if isinstance(values, list) else [values]:
                    self.has(entity, name, value, frame)
        return self

    def has(self, entity, name, value, frame, current=True):
        number = float(value) if isinstance(value, int | float) else 0.0
        always = name in ("gender", "age")
        span = {"first": 0 if always else frame, "last": ALWAYS if always else frame}
        row = {"entity": entity, "name": name, "value": str(value), "number": number, "seen": frame}
        self.rows["attributes"].append({**row, **span, "current": current})
        return self

    def tie(self, source, name, target, *frames, current=True):
        for frame in frames:
            row = {"source": source, "target": target, "name": name, "frame": frame, "current": current}
            self.rows["relations"].append(row)
        return self

    def is_a(self, entity, kind):
        self.kinds[entity] = kind
        return self

    def is_node(self, entity, node):
        self.nodes[entity] = node
        return self


def write(graph, stories):
    """Put episodes into the world tables of a graph: stories by key."""
    tables = {name: [] for name in (*WORLD_NODES, *WORLD_RELS)}
    for key, story in stories.items():
        tables["Episode"].append({"id": key})
        of_episode = {"episode": key, "episode_hash": hash_of(key)}
        at = {}
        for number, one in enumerate(story.rows["observations"], 1):
            name = f"{key}/{one['name']}"
            at.setdefault(one["frame"], name)
            row = {"id": name, **of_episode, "number": number, "frame": one["frame"], "left": one["left"]}
            tables["Observation"].append({**row, "width": one["width"]})
            tables["Made"].append({"from": key, "to": name})
        for number, name in enumerate(sorted({one["entity"] for one in story.rows["sightings"]})):
            row = {"id": f"{key}/{name}", **of_episode, "name": name, "number": number}
            tables["Entity"].append({**row, "node": story.nodes.get(name, ""), "kind": story.kinds.get(name, "person")})
            tables["Holds"].append({"from": key, "to": f"{key}/{name}"})
        for one in story.rows["sightings"]:
            box = dict(zip("xywh", one["box"], strict=True))
            edge = {"from": f"{key}/{one['entity']}", "to": at[one["frame"]], "episode": key, "who": one["entity"]}
            tables["Sighted"].append({**one, **edge, "box": box})
        for one in story.rows["attributes"]:
            edge = {"from": f"{key}/{one['entity']}", "to": at[one["seen"]], "episode": key, "who": one["entity"]}
            tables["Has"].append({**one, **edge})
        for one in story.rows["relations"]:
            edge = {"from": f"{key}/{one['source']}", "to": f"{key}/{one['target']}", "episode": key}
            span = {"first": one["frame"], "last": one["frame"], "observation": at[one["frame"]]}
            ends = {"who": one["source"], "whom": one["target"]}
            tables["Related"].append({**one, **edge, **span, **ends})
    for name, rows in tables.items():
        if rows:
            _add(graph, name, _table(name, rows))


def _add(graph, name, rows):
    """As `graph.copy`, which takes three times as long for a few rows, and has every plan looked at anew."""
    values = {c: f"CAST({c} AS UUID)" if c.endswith("_hash") else c for c in rows.column_names if c not in ENDS}
    made = ", ".join(f"{column}: {value}" for column, value in values.items())
    if name in WORLD_NODES:
        text = f"LOAD FROM $rows CREATE (:{name} {{{made}}})"
    else:
        source, target, _ = WORLD_RELS[name]
        rows = rows.rename_columns([ENDS.get(column, column) for column in rows.column_names])
        ends = f"(a:{source} {{id: source_id}}), (b:{target} {{id: target_id}})"
        text = f"LOAD FROM $rows MATCH {ends} CREATE (a)-[:{name} {{{made}}}]->(b)"
    with graph._writing():
        graph._run(text, {"rows": rows}, None)


ENDS = {"from": "source_id", "to": "target_id"}
"""The ends of an edge, under names that a statement may hold."""


def hash_of(key):
    """Half of an episode's SHA-256, written as a UUID."""
    return str(uuid.UUID(bytes=sha256(key.encode()).digest()[:16]))


def _table(name, rows):
    if name in WORLD_NODES:
        columns = [column.split()[:2] for column in WORLD_NODES[name].split(", ")]
    else:
        columns = [("from", "STRING"), ("to", "STRING"), *(c.split(" ", 1) for c in WORLD_RELS[name][2])]
    made = {}
    for column, kind in columns:
        values = [row.get(column, _EMPTY.get(kind)) for row in rows]
        made[column] = pa.array(values, _TYPES.get(kind, _BOX))
    return pa.table(made)


def planned(read="action", at="t1", times=None, nodes=None, edges=(), target=None, relation=None):
    """A plan as a dict. nodes: conditions by node, the root first; edges: (source, relation, target, time)."""
    nodes = nodes or {"a": [{"attribute": "gender", "value": "female"}]}
    times = {"t0": {"frame": 0}, "t1": {"frame": 30}} if times is None else times
    target = target or list(nodes)[-1]
    modes = {"start": "frame", "span": "span", "start_view": "frame_viewpoint"}
    modes |= {"seconds_between": "number", "count": "number"}
    answer = {"mode": modes.get(read, "multiple_choice"), "read": read, "of": target, "at": at}
    return {
        "root": next(iter(nodes)),
        "target": target,
        "times": times,
        "nodes": [{"id": node, "conditions": conditions} for node, conditions in nodes.items()],
        "edges": [{"source": a, "relation": r, "target": b, "at": t} for a, r, b, t in edges],
        "answer": answer if relation is None else answer | {"relation": relation},
    }


def parsed(plan):
    return parse_plan(json.dumps(plan))


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
