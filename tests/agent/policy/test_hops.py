"""The marker model's hops: whom a relation leads to, on people placed by hand."""

from jrdb_avr.agent.policy.explorer import Sighting
from jrdb_avr.agent.policy.hops import path, related
from jrdb_avr.schema.markers import Mark
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import AnswerSpec, Edge, Node, Plan, Time
from jrdb_avr.schema.relations import FIRST_LEFT, FIRST_RIGHT


def seen(identity, angle, metres=3.0, heading=None, **more):
    """Somebody at a panorama angle (180 ahead, 90 left of the robot) and distance, heading as marks tell it."""
    mark = Mark(identity, distance_dm=round(metres * 10), heading_deg=heading, **more)
    return Sighting(0, mark, Box(100, 100, 50, 200), True, angle)


def test_the_first_to_the_left_is_at_most_sixty_degrees_away():
    a, b = seen(1, 200.0), seen(2, 139.0)
    assert not related(FIRST_LEFT, a, b, [a, b])
    assert related("within 90 degrees to the left of (robot view)", a, b, [a, b])
    assert not related("within 60 degrees to the left of (robot view)", a, b, [a, b])
    assert not related("within 90 degrees to the right of (robot view)", a, b, [a, b])


def test_a_relation_may_stand_on_either_mark():
    a = seen(1, 180.0, partner=2, interaction="conversation")
    b, c = seen(2, 190.0), seen(3, 200.0)
    assert related("conversation", a, b, [a, b, c]) and related("conversation", b, a, [a, b, c])
    assert not related("conversation", a, c, [a, b, c]) and not related("hugging", a, b, [a, b, c])


def plan(*edges):
    ids = sorted({"a", *(target for _, _, target in edges)})
    return Plan(
        root="a",
        target=ids[-1],
        times={"t0": Time(frame=0)},
        nodes=tuple(Node(id=node) for node in ids),
        edges=tuple(Edge(source=s, relation=r, target=t, at="t0") for s, r, t in edges),
        answer=AnswerSpec(mode="multiple_choice", read="action", of=ids[-1], at="t0"),
    )


def target(plan, root, people):
    return path(plan, root, people).get(plan.target)


def test_a_walk_goes_on_from_everybody_reached_and_never_back():
    people = [seen(1, 200.0), seen(2, 180.0), seen(3, 150.0), seen(4, 230.0)]
    there = plan(("a", FIRST_LEFT, "b"), ("b", FIRST_LEFT, "c"))
    assert target(there, people[0], people).mark.identity == 3
    assert target(plan(("a", FIRST_LEFT, "b"), ("b", FIRST_RIGHT, "c")), people[0], people) is None
