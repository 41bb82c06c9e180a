"""Each read over beliefs, in small episodes; who is found, what is legal, what is missing, and who is likely."""

import itertools
import json

import msgspec
import pytest
from belief_stories import CIRCLE, Story, parsed, planned, write
from hypothesis import given
from hypothesis import strategies as st

from jrdb_avr.agent.beliefs.solver import BeliefSolver
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.compiler.believed import find_believed
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.answers import Choice, FrameAnswer, FrameViewpoint, Number, Span
from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS
from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.graph import table_ddl

KEYS = itertools.count()
OFFERED = ("sitting", "walking", "standing", "looking into something (a screen, a phone, a book)")
WOMAN = {"attribute": "gender", "value": "female"}


class Site:
    def __init__(self):
        self.graph = Graph.memory(prepares=True)
        for statement in table_ddl(WORLD_NODES, WORLD_RELS):
            self.graph.execute(statement)

    def begun(self, story):
        key = f"run/{next(KEYS)}"
        write(self.graph, {key: story})
        return key

    def solve(self, story, plan):
        return BeliefSolver(self.graph, self.begun(story), OFFERED).solve(parsed(plan))

    def answer(self, story, plan):
        answer = self.solve(story, plan).answer
        return json.loads(answer) if answer is not None and answer.startswith("{") else answer

    def guess(self, story, plan):
        belief = BeliefSolver(self.graph, self.begun(story), OFFERED).guess(parsed(plan))
        return None if belief is None else belief.seen


def legal(plan, belief, proposed, entity, choices):
    return BeliefSolver(None, "", choices).fault(plan, belief, proposed, entity)


@pytest.fixture(scope="module")
def site():
    made = Site()
    yield made
    made.graph.close()


def woman(*frames, **attributes):
    """A story of p1, a woman, who is seen at frame 0 and at others."""
    return Story().sees("p1", 0, gender="female").sees("p1", *frames, **attributes)


# -- who --------------------------------------------------------------------------------------------------------------


def test_only_what_was_written_down_matches(site):
    story = woman(30, action="walking").sees("p2", 0)
    assert dict(site.solve(story, planned()).people) == {"a": "p1"}
    man = planned(nodes={"a": [{"attribute": "gender", "value": "male"}]})
    belief = site.solve(story, man)
    assert belief.outcome == "empty" and belief.missing == (
        "a: nobody is known to be it",
        "a: gender male is not known",
    )


def test_what_was_replaced_counts_no_more(site):
    story = woman(30).has("p1", "action", "walking", 30, current=False).has("p1", "action", "sitting", 30)
    assert site.answer(story, planned()) == "sitting"
    story.has("p1", "age", "childhood", 0, current=False).has("p1", "age", "young adulthood", 0)
    child = planned(nodes={"a": [{"attribute": "age", "value": "childhood"}]})
    assert site.solve(story, child).outcome == "empty"


def test_two_who_fit_are_several_and_are_named(site):
    belief = site.solve(woman(30).sees("p2", 0, gender="female"), planned())
    assert belief.outcome == "ambiguous" and belief.missing == (
        "several fit as a: p1, p2; what tells them apart is missing",
    )


@pytest.mark.parametrize("label", ["conversation", "in the same group as"])
def test_social_relations_hold_shift_frames(site, label):
    story = woman().sees("p2", 0, action="sitting").tie("p2", label, "p1", 0)
    plan = planned(at="t0", nodes={"a": [WOMAN], "b": []}, edges=[("a", label, "b", "t0")])
    assert site.answer(story, plan) == "sitting"


@pytest.mark.parametrize(
    "label", ["first to the left of (robot view)", "within 30 degrees to the left of (robot view)", "front left, close"]
)
def test_places_hold_one_way_at_one_frame(site, label):
    plan = planned(at="t0", nodes={"a": [WOMAN], "b": []}, edges=[("a", label, "b", "t0")])
    there = woman(30).sees("p2", 0, 30, action="sitting")
    assert site.solve(there.tie("p2", label, "p1", 0).tie("p1", label, "p2", 30), plan).outcome == "empty"
    assert site.answer(there.tie("p1", label, "p2", 0), plan) == "sitting"


def test_all_nodes_are_different_people(site):
    """A way there and back would end where it began."""
    story = woman().sees("p2", 0, action="sitting").tie("p1", "conversation", "p2", 0)
    edges = [("a", "conversation", "b", "t0"), ("b", "conversation", "c", "t0")]
    plan = planned(at="t0", nodes={"a": [WOMAN], "b": [], "c": []}, edges=edges)
    belief = site.solve(story, plan)
    assert belief.outcome == "empty"
    assert belief.missing == (
        "c: nobody is known to be it",
        "edge b (p2) -> c: conversation is not known at frame 000000",
    )
    assert site.answer(story.sees("p3", 0, action="walking").tie("p3", "conversation", "p2", 0), plan) == "walking"


def test_another_episode_tells_nothing(site):
    write(site.graph, {"run/one": woman(30, action="walking"), "run/one/2": woman(30, action="sitting")})
    write(site.graph, {"other/one": woman(30, action="bending").sees("p9", 0, gender="female")})
    assert BeliefSolver(site.graph, "run/one", OFFERED).solve(parsed(planned())).answer == "walking"


def test_what_holds_at_an_event_is_refused_by_name():
    times = {"t0": {"frame": 0}, "t1": {"event": "start", "of": "a", "action": "walking", "after": "t0"}}
    with pytest.raises(PlanError, match=r"times\.t1"):
        find_believed(parsed(planned("start", "t1", times, {"a": [{"action": "walking", "at": "t1"}]})))


def test_every_statement_passes_the_world_models_door():
    with WorldGraph.memory() as world:
        plan = planned("presence", ["t1", "t2"], BOTH, {"a": [WOMAN], "b": []}, [("a", "conversation", "b", "t0")])
        plan["nodes"][0]["conditions"] += [{"object": "bag", "verb": "holding", "at": "t0"}]
        belief = BeliefSolver(world, "none").solve(parsed(plan))
        assert belief.outcome == "empty" and BeliefSolver(world, "none").guess(parsed(plan)) is None
        for name in ("sighted", "attributes", "relations", "looks", "entities"):
            assert world.query(read_statement(f"reads/world/{name}.cypher"), {"scope": "none"}).num_rows == 0


# -- what is read -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("actions", "answer"),
    [
        (["walking", "reading"], "walking"),
        (["walking", "looking into sth", "reading"], None),
        ("looking into sth", "looking into sth"),
        ("reading", None),
        (["walking", "sitting"], None),
    ],
)
def test_of_the_offered_actions_the_only_known_one_is_read(site, actions, answer):
    belief = site.solve(woman(30, action=actions), planned())
    missing = () if answer else ("the answer: the action of p1 at frame 000030 is not known",)
    assert (belief.answer, belief.seen[0], belief.missing) == (answer, 30, missing)


def test_no_action_is_read_of_a_frame_without_the_person(site):
    belief = site.solve(woman(45, action="walking"), planned())
    assert belief.missing == ("the answer: p1 is not seen at frame 000030",)


BOTH = {"t0": {"frame": 0}, "t1": {"frame": 30}, "t2": {"frame": 60}}


@pytest.mark.parametrize(
    ("seen", "answer", "shown"),
    [
        ((30, 60), "both times", 60),
        ((30,), "only at the first time", 30),
        ((60,), "only at the second time", 60),
        ((), "neither time", 0),
    ],
)
def test_presence_needs_the_person_or_the_whole_panorama(site, seen, answer, shown):
    plan = planned("presence", ["t1", "t2"], BOTH)
    story = woman(*seen).look(30, *CIRCLE).panorama(60)
    belief = site.solve(story, plan)
    assert (belief.answer, belief.seen[0]) == (answer, shown)
    # Of whom is not seen, part of the panorama tells nothing.
    if len(seen) < 2:
        belief = site.solve(woman(*seen).look(30, *CIRCLE[1:]).look(60, *CIRCLE[:7]), plan)
        assert belief.outcome == "unknown" and len(belief.missing) == 2 - len(seen)
        assert "nor is the whole panorama observed" in belief.missing[0]


@pytest.mark.parametrize("turn", [0, 1, 235, 470, 3759])
@pytest.mark.parametrize(("moved", "answer"), [(0, "neither time"), (10, "neither time"), (11, None)])
def test_a_gap_of_one_column_leaves_absence_open_also_at_the_seam(site, turn, moved, answer):
    """A crop that begins where the one before ends leaves none; one column later it leaves one."""
    lefts = [left + turn for left in CIRCLE]
    lefts[4] += moved
    story = woman().look(30, *lefts).panorama(60)
    assert site.answer(story, planned("presence", ["t1", "t2"], BOTH)) == answer


@pytest.mark.parametrize(
    ("first", "second", "answer"),
    [
        (5.0, 4.0, "closer to the robot"),
        (5.3, 4.3, "closer to the robot"),
        (4.0, 5.0, "farther from the robot"),
        (5.0, 4.01, "about the same distance"),
        (4.0, 4.99, "about the same distance"),
        (None, 4.0, None),
        (4.0, None, None),
    ],
)
def test_a_change_of_distance_is_cut_at_one_metre(site, first, second, answer):
    story = woman(30)
    for frame, metres in ((0, first), (30, second)):
        if metres is not None:
            story.has("p1", "distance_m", metres, frame)
    belief = site.solve(story, planned("distance_change", ["t0", "t1"]))
    assert (belief.answer, belief.seen[0]) == (answer, 30)
    if answer is None:
        frame = 30 if second is None else 0
        assert belief.missing == (f"the answer: distance_m of p1 at frame {frame:06d} is not known",)


def test_the_next_posture_is_the_first_other_one_seen_later(site):
    times = {"t0": {"frame": 0}, "t1": {"event": "end", "of": "a", "after": "t0"}}
    plan = planned("next_action", "t1", times)
    story = woman().has("p1", "action", "sitting", 0).sees("p1", 30, action="sitting").sees("p1", 45)
    story.sees("p1", 60, action=["walking", "standing"])
    story.sees("p1", 90, action=["standing", "reading"]).sees("p1", 100, action="walking")
    belief = site.solve(story, plan)
    assert (belief.answer, belief.seen[0], belief.times["t1"]) == ("standing", 90, 30)
    belief = site.solve(woman(90, action="standing"), plan)
    assert belief.missing == ("the answer: the posture of p1 at frame 000000 is not known",)


START = {"t0": {"frame": 0}, "t1": {"event": "start", "of": "a", "action": "walking", "after": "t0"}}


@pytest.mark.parametrize(("first", "answer"), [(60, {"frame": 45}), (59, {"frame": 44}), (61, None)])
def test_a_start_lies_between_two_looks_at_most_thirty_frames_apart(site, first, answer):
    story = woman(30).sees("p1", first, first + 40, action="walking")
    belief = site.solve(story, planned("start", "t1", START))
    assert (json.loads(belief.answer) if belief.answer else None, belief.seen[0]) == (answer, first)
    if answer is None:
        how = "to 31 frames only, from 000030 to 000061; 30 are needed"
        assert belief.missing == (f"the answer: the start of walking is known {how}",)


def test_a_start_is_seen_before_and_after(site):
    plan = planned("start", "t1", START)
    story = woman().has("p1", "action", "walking", 0).sees("p1", 15, 30, action="walking")
    assert "not seen before it is walking" in site.solve(story, plan).missing[0]
    story = woman().has("p1", "action", "walking", 0).sees("p1", 15).sees("p1", 30, action="walking")
    assert "not seen before it is walking" in site.solve(story, plan).missing[0]
    assert site.solve(woman(15), plan).missing == ("the answer: p1 is not seen walking from frame 000000 on",)
    # What was seen before the time it waits for does not matter.
    story = Story().sees("p1", 0, action="walking").sees("p1", 10, gender="female").sees("p1", 20, action="walking")
    assert site.answer(story, planned("start", "t1", START | {"t0": {"frame": 10}})) == {"frame": 15}


SPAN = START | {"t2": {"event": "end", "of": "a", "action": "walking", "after": "t1"}}


@pytest.mark.parametrize(("gone", "answer"), [(90, {"start_frame": 25, "end_frame": 75}), (91, None), (None, None)])
def test_a_span_needs_its_end_as_well(site, gone, answer):
    story = woman(20).sees("p1", 30, 60, action="walking")
    story = story if gone is None else story.sees("p1", gone).sees("p1", 200, action="walking")
    belief = site.solve(story, planned("span", ["t1", "t2"], SPAN))
    assert (json.loads(belief.answer) if belief.answer else None) == answer
    if answer is None:
        assert belief.times["t1"] == 25 and "t2" not in belief.times
        assert ("31 frames only" if gone else "not seen to have ended") in belief.missing[0]


def test_an_end_without_its_start_is_said_to_be_none(site):
    times = SPAN | {"t2": SPAN["t2"] | {"after": "t0"}}
    belief = site.solve(woman(20).sees("p1", 30, action="walking").sees("p1", 40), planned("span", ["t1", "t2"], times))
    assert belief.missing == ("the answer: time t2: an end is read only after the start of the same action",)


def test_different_people_are_counted_at_all_observed_frames(site):
    story = woman(30, 60, 90)
    for frame, other in ((0, "p8"), (30, "p2"), (60, "p2"), (60, "p3"), (90, "p4"), (91, "p9")):
        story.sees(other, frame)
        if frame <= 90:
            source, target = ("p1", other) if frame < 60 else (other, "p1")
            story.tie(source, "conversation", target, frame)
    story.tie("p2", "hugging", "p1", 30).tie("p2", "conversation", "p3", 60)
    times = {"t0": {"frame": 30}, "t1": {"frame": 90}}
    belief = site.solve(story, planned("count", ["t0", "t1"], times, relation="conversation"))
    assert json.loads(belief.answer) == {"value": 3.0} and belief.seen[0] == 30
    place = planned("count", ["t0", "t1"], times, relation="front, close")
    assert site.answer(story.tie("p1", "front, close", "p2", 60).tie("p3", "front, close", "p1", 60), place) == {
        "value": 1
    }
    belief = site.solve(story, planned("count", ["t0", "t1"], times, relation="sitting together"))
    assert belief.missing[0].startswith("the answer: nobody is known to be in 'sitting together' with p1")


# -- what is missing, and who is likely -------------------------------------------------------------------------------


def test_missing_follows_who_is_said_to_be_which_node(site):
    nodes = {"a": [WOMAN, {"action": "sitting", "at": "t0"}], "b": []}
    plan = planned(at="t0", nodes=nodes, edges=[("a", "conversation", "b", "t0")])
    story = Story().sees("p1", 0, gender="female", action="sitting").sees("p2", 0).sees("p3", 0)
    story.is_node("p2", "a").is_node("p3", "b")
    assert site.solve(story, plan).missing == (
        "a (p2): gender female is not known",
        "a (p2): action sitting is not known at frame 000000",
        "edge a (p2) -> b (p3): conversation is not known at frame 000000",
    )


def test_the_likeliest_target_fits_most_then_is_seen_most_then_has_the_smallest_name(site):
    nodes = {"a": [WOMAN], "b": [{"action": "sitting", "at": "t0"}]}
    plan = planned(at="t0", nodes=nodes, edges=[("a", "conversation", "b", "t0")])
    story = Story().sees("p3", 0, 15).sees("p2", 0, 15).sees("p4", 0, 15, 30).sees("p5", 0, action="sitting")
    newest = story.rows["sightings"][-1]
    assert site.guess(story, plan) == (0, newest["box"])
    story.sees("p3", 45, 60, 5, action="reading").tie("p4", "conversation", "p3", 0)
    # Both fit in one part; p3 is seen more often, and was seen at frame 5 last.
    assert site.guess(story, plan) == (5, story.rows["sightings"][-1]["box"])
    none = Story().sees("p3", 0).sees("p2", 0, 15)
    assert site.guess(none, plan) == (15, none.rows["sightings"][-1]["box"])
    even = Story().sees("p2", 0, 15).sees("p10", 0, 15)
    assert site.guess(even, plan) == (15, even.rows["sightings"][-1]["box"])
    assert site.guess(Story(), plan) is None


def test_a_guess_may_be_of_one_entity(site):
    nodes = {"a": [WOMAN, {"action": "sitting", "at": "t0"}]}
    story = Story().sees("p1", 0, gender="female", action="sitting").sees("p2", 0, gender="female", action="walking")
    solver, plan = BeliefSolver(site.graph, site.begun(story), OFFERED), parsed(planned(at="t0", nodes=nodes))
    assert [(g.people["a"], g.answer, g.held) for g in (solver.guess(plan), solver.guess(plan, entity="p2"))] == [
        ("p1", "sitting", 1.0),
        ("p2", "walking", 0.5),
    ]
    assert solver.guess(plan, entity="p3") is None


FRAME = st.integers(0, 120)
ROUND = [{"edge": n * 470, "width": 480} for n in range(8)]


@given(st.sets(FRAME, max_size=6), st.sets(FRAME, max_size=3), st.sets(FRAME, max_size=3), FRAME, FRAME, st.booleans())
def test_a_stated_frame_is_met_by_the_nearest_one_within_a_second(sighted, whole, partly, first, second, anywhere):
    """Of those where somebody was seen, or the whole panorama; without one it stays, or the nearest of all stands."""
    looks = [look | {"frame": frame} for frame in whole for look in ROUND]
    looks += [look | {"frame": frame} for frame in partly - whole for look in ROUND[:7]]
    rows = {"looks": looks, "sighted": [{"frame": frame} for frame in sighted]}
    times = {"t0": {"frame": first}, "t1": {"frame": second}, "t2": {"event": "leaves", "of": "a", "after": "t0"}}
    plan = parsed(planned("presence", ["t0", "t1"], times))
    placed = BeliefSolver(None, "").placements(plan, rows, anywhere)
    known = sighted | whole

    def away(one):
        return sum(abs(one.times[name].frame - plan.times[name].frame) for name in ("t0", "t1"))

    for one in placed:
        assert one.times["t2"] == plan.times["t2"]
        assert (one.nodes, one.edges, one.answer) == (plan.nodes, plan.edges, plan.answer)
        for name, frame in (("t0", first), ("t1", second)):
            near = {other for other in known if abs(other - frame) <= 15}
            nearest = {min(known, key=lambda other: (abs(other - frame), other))} if known and anywhere else {frame}
            assert one.times[name].frame in (near or nearest)
    assert [away(one) for one in placed] == sorted(map(away, placed))
    for name, frame in (("t0", first), ("t1", second)):
        near = min([abs(other - frame) for other in known if abs(other - frame) <= 15 or anywhere], default=0)
        assert abs(placed[0].times[name].frame - frame) == near
    assert len({msgspec.json.encode(one) for one in placed}) == len(placed) <= 8


# -- what is legal ----------------------------------------------------------------------------------------------------


def test_a_choice_is_legal_by_its_text(site):
    plan = planned()
    belief = site.solve(woman(30, action="walking"), plan)
    choices = ("sitting", "walking", "standing", "bending")
    assert legal(parsed(plan), belief, Choice(2), "p1", choices) == ""
    assert "choice 2, 'walking'" in legal(parsed(plan), belief, Choice(1), "p1", choices)
    assert "target in the graph is p1, not p2" in legal(parsed(plan), belief, Choice(2), "p2", choices)
    assert "none of the choices" in legal(parsed(plan), belief, Choice(2), "p1", ("lying", "sitting"))
    assert legal(parsed(plan), belief, FrameAnswer(2), "p1", choices)


def test_no_answer_is_legal_that_the_graph_does_not_give(site):
    plan = parsed(planned())
    for story, reason in (
        (Story().sees("p1", 0), "nobody in the graph fits the plan; missing: a: nobody is known to be it"),
        (woman().sees("p2", 0, gender="female"), "no single target; several fit as a: p1, p2"),
        (woman(30), "does not give the answer; missing: the answer: the action of p1"),
    ):
        belief = site.solve(story, planned())
        assert reason in legal(plan, belief, Choice(1), "p1", ("walking", "sitting"))


@pytest.mark.parametrize(
    ("read", "inside", "outside"),
    [
        ("start", [FrameAnswer(30), FrameAnswer(60)], [FrameAnswer(29), FrameAnswer(61), Number(45.0)]),
        (
            "start_view",
            [FrameViewpoint(60, 350.0), FrameViewpoint(45, 30.0)],
            [FrameViewpoint(61, 10.0), FrameViewpoint(45, 349.9), FrameViewpoint(45, 30.1)],
        ),
        ("span", [Span(45, 75), Span(45, 60)], [Span(45, 59), Span(75, 45)]),
        ("count", [Number(0.5), Number(2.0)], [Number(0.49), Number(2.01), Number(0.0)]),
    ],
)
def test_an_answer_is_legal_up_to_the_bounds_of_the_scores(site, read, inside, outside):
    story = woman(40).sees("p1", 50, 70, action="walking").sees("p1", 80).sees("p2", 50).tie("p1", "hugging", "p2", 50)
    story.rows["sightings"][2]["angle"] = 10.0
    times = {"start": START, "start_view": START, "span": SPAN}.get(read, {"t0": {"frame": 0}, "t1": {"frame": 90}})
    at = {"span": ["t1", "t2"], "count": ["t0", "t1"]}.get(read, "t1")
    plan = planned(read, at, times, relation="hugging" if read == "count" else None)
    belief = site.solve(story, plan)
    for answer in inside:
        assert legal(parsed(plan), belief, answer, "p1", ()) == "", answer
    for answer in outside:
        assert legal(parsed(plan), belief, answer, "p1", ()), answer
