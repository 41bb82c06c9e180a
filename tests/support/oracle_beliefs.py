"""Plans over beliefs by brute force: every assignment of entities to nodes is tried over plain rows of Python.

Nothing of `queries` or `agent` is used. An episode is a dict of lists: observations (name, frame, left, width),
sightings (entity, frame, box, angle, write, current), attributes (entity, name, value, number, first, last, current)
and relations (source, target, name, frame, current).
"""

import itertools
import json

POSES = {"walking", "standing", "sitting"}
BOTH_WAYS = {"conversation", "hugging", "in the same group as"}
PRESENCE = {(1, 1): "both times", (1, 0): "only at the first time", (0, 1): "only at the second time"}


ENDS = {"after": -1, "before": 10**9}


class Mind:
    """What is believed in one episode; `resolved` frames at most lie between the looks that enclose a moment."""

    def __init__(self, episode, resolved=30, kinds=None):
        self.kinds = kinds or {}
        self.resolved = resolved
        self.sighted = {(s["entity"], s["frame"]): s for s in episode["sightings"] if s["current"]}
        self.people = sorted({entity for entity, _ in self.sighted})
        self.attributes = [a for a in episode["attributes"] if a["current"]]
        self.relations = [r for r in episode["relations"] if r["current"]]
        columns = {}
        for one in episode["observations"]:
            shown = {(one["left"] + k) % 3760 for k in range(one["width"])}
            columns[one["frame"]] = columns.get(one["frame"], set()) | shown
        self.whole = sorted(frame for frame, shown in columns.items() if len(shown) == 3760)

    # -- facts --------------------------------------------------------------------------------------------------------

    def frames(self, who):
        return sorted(frame for entity, frame in self.sighted if entity == who)

    def has(self, who, name, frame):
        return [
            a for a in self.attributes if a["entity"] == who and a["name"] == name and a["first"] <= frame <= a["last"]
        ]

    def does(self, who, frame):
        return {a["value"] for a in self.has(who, "action", frame)}

    def pose(self, who, frame):
        poses = self.does(who, frame) & POSES if (who, frame) in self.sighted else set()
        return poses.pop() if len(poses) == 1 else None

    def related(self, source, name, target, frame):
        pairs = [(source, target), (target, source)] if name in BOTH_WAYS else [(source, target)]
        return any(
            (r["source"], r["target"]) in pairs and (r["name"], r["frame"]) == (name, frame) for r in self.relations
        )

    def holds(self, who, condition, frame):
        if "attribute" in condition:
            key = "number" if condition["attribute"] == "group_size" else "value"
            if condition["attribute"] in ("shirt", "color"):
                wanted = " ".join(condition["value"].lower().split())
                return wanted in [a["value"] for a in self.has(who, condition["attribute"], frame)]
            return condition["value"] in [a[key] for a in self.has(who, condition["attribute"], frame)]
        if "action" in condition:
            return condition["action"] in self.does(who, frame)
        if "object" in condition:
            return f"{condition['verb']}: {condition['object']}" in [a["value"] for a in self.has(who, "object", frame)]
        label = condition["interaction"]
        ends = [(r["source"], r["target"]) for r in self.relations if (r["name"], r["frame"]) == (label, frame)]
        told = label in [a["value"] for a in self.has(who, "interaction", frame)]
        return told or any(who in pair for pair in ends)

    # -- who ----------------------------------------------------------------------------------------------------------

    def parts(self, plan, bound):
        """Truth of every condition and edge under a binding, which may leave nodes out."""
        frame_of = lambda name: plan["times"][name]["frame"]  # noqa: E731
        for node in plan["nodes"]:
            who = bound.get(node["id"])
            for condition in node["conditions"]:
                at = frame_of(condition["at"]) if "at" in condition else 0
                yield who is not None and self.holds(who, condition, at)
        for edge in plan["edges"]:
            a, b = bound.get(edge["source"]), bound.get(edge["target"])
            yield None not in (a, b) and self.related(a, edge["relation"], b, frame_of(edge["at"]))

    def at_moments(self, plan):
        """The plan with every frame that its moments may be, and with none."""
        moments = {name: time for name, time in plan["times"].items() if not {"frame", "event"} & {*time}}
        frames = []
        for time in moments.values():
            low, high = (plan["times"][time[key]]["frame"] if key in time else end for key, end in ENDS.items())
            frames.append([-5, *sorted({frame for _, frame in self.sighted if low < frame < high})])
        for chosen in itertools.product(*frames):
            stated = {name: {"frame": frame} for name, frame in zip(moments, chosen, strict=True)}
            yield {**plan, "times": plan["times"] | stated}

    def bindings(self, plan):
        found = [bound for one in self.at_moments(plan) for bound in self.bindings_at(one)]
        yield from [bound for place, bound in enumerate(found) if bound not in found[:place]]

    def bindings_at(self, plan):
        nodes = [node["id"] for node in plan["nodes"]]
        for people in itertools.permutations(self.people, len(nodes)):
            bound = dict(zip(nodes, people, strict=True))
            there = all((bound[node], frame) in self.sighted for node in nodes for frame in needed(plan, node))
            if there and all(self.parts(plan, bound)) and all(self.may_be(plan, *pair) for pair in bound.items()):
                yield bound

    def may_be(self, plan, node, who):
        kinds = {one["id"]: one["kind"] for one in plan["nodes"] if one.get("kind", "person") != "person"}
        kind = self.kinds.get(who, "person")
        return kind == kinds[node] if node in kinds else kind not in kinds.values()

    def likeliest(self, plan):
        """Who comes nearest to being the target."""
        nodes = [node["id"] for node in plan["nodes"]]
        fits = dict.fromkeys(self.people, 0)
        for people in itertools.product([None, *self.people], repeat=len(nodes)):
            named = [who for who in people if who is not None]
            bound = {node: who for node, who in zip(nodes, people, strict=True) if who is not None}
            if len(set(named)) == len(named) and plan["target"] in bound:
                who = bound[plan["target"]]
                fits[who] = max(fits[who], *(sum(self.parts(one, bound)) for one in self.at_moments(plan)))
        if not fits:
            return None
        return min(self.people, key=lambda who: (-fits[who], -len(self.frames(who)), who))

    def guess(self, plan):
        """The likeliest target and what is read of it: outcome, people, times and answer; None for nobody."""
        best = self.likeliest(plan)
        return None if best is None else self.read(plan, {plan["target"]: best})

    def newest(self, who):
        """Frame and box of the newest sighting."""
        newest = max((self.sighted[who, frame] for frame in self.frames(who)), key=lambda s: s["write"])
        return newest["frame"], newest["box"]

    # -- what ---------------------------------------------------------------------------------------------------------

    def solve(self, plan):
        """Outcome, people, times and answer (a text, or what the stored JSON holds)."""
        found = list(self.bindings(plan))
        targets = {bound[plan["target"]] for bound in found}
        if len(targets) != 1:
            return ("ambiguous" if targets else "empty"), {}, {}, None
        return self.read(plan, {node: who for node, who in found[0].items() if all(b[node] == who for b in found)})

    def read(self, plan, people):
        """What is read where these are the people."""
        times = {name: time["frame"] for name, time in plan["times"].items() if "frame" in time}
        for _ in plan["times"]:
            for name, time in plan["times"].items():
                if name not in times and time.get("of") in people:
                    frame = self.event(plan, people[time["of"]], time, times)
                    times |= {} if frame is None else {name: frame}
        answer = self.answer(plan, people, times) if plan["answer"]["of"] in people else None
        return ("unknown" if answer is None else "defined"), people, times, answer

    def event(self, plan, who, time, times):
        before = plan["times"][time["after"]]
        if time["event"] == "returns":
            left = (before.get("event"), before.get("of")) == ("leaves", time["of"]) and before["after"] in times
            return self.absence(who, times[before["after"]])[1] if left else None
        if time["after"] not in times:
            return None
        if time["event"] == "start":
            return self.start(who, time["action"], times[time["after"]])
        if time["event"] == "leaves":
            return self.absence(who, times[time["after"]])[0]
        # Only what starts at a time of the plan ends at one.
        if "action" not in time or (before.get("event"), before.get("action")) != ("start", time["action"]):
            return None
        return self.end(who, time["action"], times[before["after"]])

    def start(self, who, action, after):
        frames = [f for f in self.frames(who) if f >= after]
        first = next((f for f in frames if action in self.does(who, f)), None)
        if first is None or frames[0] == first:
            return None
        return self.middle(frames[frames.index(first) - 1], first)

    def first(self, who, action, after):
        return next(f for f in self.frames(who) if f >= after and action in self.does(who, f))

    def middle(self, before, after):
        """The moment between two looks, None where they are too far apart."""
        return None if after - before > self.resolved else (before + after) // 2

    def end(self, who, action, after):
        frames = self.frames(who)
        for last, gone in itertools.pairwise(frames[frames.index(self.first(who, action, after)) :]):
            if action not in self.does(who, gone):
                return self.middle(last, gone)
        return None

    def absence(self, who, after):
        seen = self.frames(who)
        gone = [f for f in self.whole if f > after and f not in seen]
        if not gone or not [f for f in seen if after <= f < gone[0]]:
            return None, None
        leaves = self.middle(max(f for f in seen if f < gone[0]), gone[0])
        back = [f for f in seen if f > gone[0]]
        return leaves, self.middle(max(f for f in gone if f < back[0]), back[0]) if back else None

    def answer(self, plan, people, times):
        spec = plan["answer"]
        who, read = people[spec["of"]], spec["read"]
        asked = spec["at"] if isinstance(spec["at"], list) else [spec["at"]]
        if read == "next_action":
            after = times[plan["times"][asked[0]]["after"]]
            held = self.pose(who, after)
            later = [f for f in self.frames(who) if f > after and self.pose(who, f)]
            other = [f for f in later if self.pose(who, f) != held]
            if held is None or not other:
                return None
            times[asked[0]] = max([after, *(f for f in later if f < other[0])])
            return self.pose(who, other[0])
        frames = [times.get(name) for name in asked]
        if None in frames:
            return None
        if read == "action":
            return self.pose(who, frames[0])
        if read == "attribute":
            values = {a["value"] for a in self.has(who, spec["attribute"], frames[0])}
            return values.pop() if len(values) == 1 and (who, frames[0]) in self.sighted else None
        if read in ("presence", "distance_change"):
            here = [1 if (who, f) in self.sighted else 0 if f in self.whole else None for f in frames]
            if read == "presence":
                return None if None in here else PRESENCE.get(tuple(here), "neither time")
            return self.change(who, frames, here)
        if read == "start":
            return {"frame": frames[0]}
        if read == "span":
            return {"start_frame": frames[0], "end_frame": frames[1]}
        if read == "start_view":
            time = plan["times"][asked[0]]
            seen = self.sighted[who, self.first(who, time["action"], times[time["after"]])]
            return {"frame": frames[0], "angle_deg": seen["angle"]}
        if read == "seconds_between":
            return {"value": (frames[1] - frames[0]) / 15}
        met = {
            other
            for other in self.people
            for frame in range(frames[0], frames[1] + 1)
            if other != who and self.related(who, spec["relation"], other, frame)
        }
        return {"value": float(len(met))} if met else None

    def change(self, who, frames, here):
        metres = [[a["number"] for a in self.has(who, "distance_m", f)] for f in frames]
        if not here[0] or not metres[0]:
            return None
        if here[1] == 0:
            return "not in view"
        if here[1] is None or not metres[1]:
            return None
        nearer = round((metres[0][0] - metres[1][0]) * 100)
        return (
            "about the same distance"
            if abs(nearer) < 100
            else f"{'closer to' if nearer > 0 else 'farther from'} the robot"
        )


def needed(plan, node):
    """Frames at which a node is to be seen."""
    own = next(n for n in plan["nodes"] if n["id"] == node)
    times = {c["at"] for c in own["conditions"] if "at" in c}
    times |= {e["at"] for e in plan["edges"] if node in (e["source"], e["target"])}
    stated = sorted(name for name, time in plan["times"].items() if "frame" in time)
    return {plan["times"][name]["frame"] for name in times or stated[:1]}


def plain(answer):
    """A solver's answer, as `Mind.solve` gives it."""
    return json.loads(answer) if answer is not None and answer.startswith("{") else answer
