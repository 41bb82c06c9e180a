"""The loop of the reference agent, played by scripted models: writes, looks, refusals, limits, and the end."""

import itertools
import json
import re

import pytest
from environment import SNAPSHOTS
from reference_play import (
    ADVISED,
    CHOICES,
    GRAPH,
    LEFT_BOX,
    MAN,
    MODES,
    PAIR,
    PLAN,
    PLANS,
    RIGHT_BOX,
    WOMAN,
    attribute,
    chat_final,
    entity,
    final,
    line_of,
    look,
    people,
    person,
    pictures_of,
    play,
    relation,
    results_of,
    text_of,
    turn,
    writes,
)

from jrdb_avr.agent.look.answer import guess_choice
from jrdb_avr.agent.reference.loop import Limits
from jrdb_avr.agent.reference.method import ReferenceAgent
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.panorama import FOV_DEG, angle_error

SEEN = [PLAN, turn(look()), writes(WOMAN, MAN)]


def kept(name, told):
    """The texts are part of the benchmark. To change one, delete its snapshot, run twice, and read the new one."""
    path = SNAPSHOTS / f"{name}.txt"
    if not path.exists():
        path.write_text(told)
        pytest.fail(f"wrote {path}: read it, then run again")
    assert told == path.read_text()


def world_of(game, number=-1):
    return line_of(text_of(game.requests[number]), "World")


# -- what the model gets ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_prompts_are_as_they_were(world, mode):
    game = play([{"root": "a"}, PLANS[mode], turn(look()), writes(WOMAN), "no more"], mode, world=world)
    plan, first, second = (text_of(game.requests[number]) for number in (1, 3, 4))
    kept(f"agent_{mode}", f"{plan}\n=====\n{first}\n=====\n{second.rpartition('World: ')[2]}\n")


@pytest.mark.parametrize("name", ["agent_passive", "agent_no_world", "agent_passive_no_world", "agent_advice_off"])
def test_variants_show_what_they_showed(world, name):
    looks, remembers = "passive" not in name, "no_world" not in name
    script = [*([PLANS["frame"]] if remembers else []), turn(look()) if looks else "hm", turn(chat_final(7)), "hm"]
    game = play(script, "frame", looks=looks, world=world if remembers else None, advice="off" not in name)
    kept(name, text_of(game.requests[len(script) - 1]) + "\n")


def test_a_picture_is_sent_until_its_people_are_written(world):
    game = play([PLAN, turn(look()), turn(GRAPH), writes(WOMAN), turn(look(155)), "x"], world=world)
    first, second = ["s 000150 180"], ["s 000155 180"]
    assert [pictures_of(request) for request in game.requests[:6]] == [[], [], first, first, [], second]


def test_the_passive_agent_gets_all_panoramas_in_every_turn(world):
    game = play([PLAN, writes(person(box=[495, 250, 505, 700], gender="female"), observation="o5"), "x"], looks=False,
                world=world)  # fmt: skip
    assert {len(pictures_of(request)) for request in game.requests[1:]} == {8}
    assert world_of(game)["people"] == {"p1": "female, 000170 at 180"}
    assert "observe" not in json.dumps(game.schemas[1])


def test_a_chat_keeps_all_messages():
    said = [turn(look()), turn(look(155)), "hm", turn(chat_final())]
    game = play(said)
    assert [len(request) for request in game.requests] == [2, 4, 6, 8]
    assert pictures_of(game.requests[3]) == ["s 000150 180", "s 000155 180"]
    assert "World: " not in text_of(game.requests[3])


# -- the graph decides ------------------------------------------------------------------------------------------------


def test_the_graph_supports_what_was_written(world):
    game = play([*SEEN, turn(final(2))], world=world)
    shown = world_of(game)
    assert shown["people"] == {"p1": "female, 000150 at 165", "p2": "male, 000150 at 188"}
    assert shown["likely"][0]["nodes"] == {"a": "p1"}
    # While a look is advised, a turn states no answer.
    assert shown["supported"] is None
    without = world_of(play([*SEEN, turn(final(2))], world=world, advice=False))
    assert (without["supported"]["answer"], without["supported"]["entity"]) == (2, "p1")
    told = game.prediction
    assert (told.status, told.answer, told.reason) == ("answered", Choice(2), "")
    # The rest of the frame was not searched.
    assert (told.evidence.frame, told.verdict) == (150, "supported")
    assert (told.n_model_calls, told.n_observations) == (4, 1)


@pytest.mark.parametrize("proposed", [final(3), final(2, "p2"), final(1, "p9")])
def test_an_unsupported_answer_is_refused_once(world, proposed):
    game = play([*SEEN, turn(proposed), turn(proposed), AssertionError], world=world)
    assert results_of(text_of(game.requests[4]))[0].startswith(
        "final_answer: refused: the graph supports the answer 2 of p1 ("
    )
    told = game.prediction
    assert (told.answer, told.evidence.frame) == (Choice(2), 150)
    assert told.reason.startswith("the graph supports the answer 2 of p1")
    assert told.proposed == json.dumps({"choice": proposed["answer"]}, separators=(",", ":"))
    decision = json.loads([step.response for step in game.steps if step.kind == "solve"][-1])
    assert decision["bindings"][0]["nodes"] == {"a": "p1"}
    assert decision["parts"][0]["part"] == "a gender female"
    assert (decision["conclusion"]["entity"], decision["proposed"]) == ("p1", {"choice": proposed["answer"]})
    slots, pairs = decision["statements"]
    assert {row["entity"] for row in slots["rows"]} == {one["nodes"]["a"] for one in decision["bindings"]}
    assert (slots["name"], pairs["rows"]) == ("reads/world/slots.cypher", [])


def test_a_refused_answer_names_the_best_look(world):
    game = play([PLAN, turn(final()), "x"], world=world)
    refused = results_of(text_of(game.requests[2]))[0]
    assert "the graph supports no answer" in refused
    assert 'the best look: {"frame_id":"000150","angle_deg":' in refused


def test_without_people_the_answer_is_a_guess_by_the_choices(world):
    told = [play([PLAN, turn(final(n)), turn(final(n)), AssertionError], world=world).prediction for n in (1, 2, 3)]
    assert {one.answer for one in told} == {guess_choice(CHOICES)}
    assert len({guess_choice((text, *CHOICES)).choice for text in "abcdefgh"}) > 2
    assert {(one.verdict, one.evidence, one.status) for one in told} == {("guess", None, "answered")}


@pytest.mark.parametrize("mode", MODES)
def test_the_smallest_plan_proves_nothing(world, mode):
    game = play([*[{"root": "a"}] * 4, turn(look()), writes(WOMAN), "x"], mode, world=world)
    assert [write.accepted for write in game.writes if write.tool == "plan"] == [False] * 4 + [True]
    assert (game.prediction.verdict, game.prediction.evidence.frame) == ("guess", 150)


def test_a_chat_answers_with_its_own_box():
    told = play([turn(look(150, 360)), turn(chat_final(3))]).prediction
    assert (told.status, told.answer, told.verdict) == ("answered", Choice(3), None)
    assert told.evidence.box == pytest.approx((3568, 120, 72, 216))


def test_a_chat_keeps_what_can_be_read():
    game = play([turn(look()), turn(chat_final(9)), turn(chat_final(2, "o7")), "x"])
    assert "answer must be the number of a choice" in results_of(text_of(game.requests[2]))[0]
    assert (game.prediction.status, game.prediction.answer) == ("answered", Choice(2))
    assert game.prediction.evidence.frame == 150
    told = play([turn(look()), turn(chat_final(9))]).prediction
    assert (told.status, told.answer) == ("invalid", None)


# -- writes -----------------------------------------------------------------------------------------------------------


def test_people_are_refused_one_at_a_time(world):
    same_box = person("p2", gender="male")
    bad_field = person("p3", RIGHT_BOX, gender="woman")
    no_name = person("p 4", RIGHT_BOX)
    game = play([PLAN, turn(look()), writes(WOMAN, same_box, bad_field, no_name, WOMAN, MAN), "x"], world=world)
    result = results_of(text_of(game.requests[3]))[0]
    assert result.startswith("add_people: o1: p1, p2 written; refused: people[1]: ") is False
    assert result.startswith("add_people: o1: p1")
    for text in ("people[1]: p2 has the box of p1", "people[2]: gender must be", "people[3]: id must have",
                 "people[4]: p1 is in the list twice"):  # fmt: skip
        assert text in result
    assert [write.accepted for write in game.writes if write.tool == "add_people"].count(False) >= 4
    assert "p1" in world_of(game)["people"] and "p3" not in world_of(game)["people"]


def test_a_person_has_one_box_in_a_picture(world):
    game = play([PLAN, turn(look()), writes(WOMAN), turn(look(155)), writes(WOMAN, MAN), "x"], world=world)
    result = results_of(text_of(game.requests[5]))[0]
    assert result == "add_people: o1: p2 written; refused: p1 already has a box in o1"
    assert world_of(game)["people"] == {"p1": "female, 000150 at 165", "p2": "male, 000150 at 188"}


def test_a_refused_person_keeps_its_number(world):
    """A relation to a refused person is no relation to the next person of the picture."""
    talking = person("p1", gender="female", **{"relation conversation": ["p2"]})
    refused, other = person("p2", RIGHT_BOX, gender="woman"), person("p3", RIGHT_BOX, gender="male")
    game = play([PAIR, turn(look()), writes(talking, refused), writes(other), "x"], world=world)
    facts = [json.loads(write.fact) for write in game.writes if write.tool == "add_people" and write.accepted]
    assert [fact["sighted"][0]["number"] for fact in facts] == [1, 3]


UNGROUNDED = [
    people(observation="o7"),
    people(observation=None),
    entity(observation="o2"),
    attribute("gender", "male", observation="o9"),
    attribute("gender", "male", entity="p9"),
    attribute("gender", "cannot tell"),
    attribute("gender", "woman"),
    attribute("shirt", "red"),
    relation(target="p9"),
    relation(target="p1"),
    relation("relation hugging"),
    relation(observation="o3"),
    entity(box=[500, 250, 400, 700]),
    entity(name="x" * 33),
    {"tool": "add_people", "observation": "o1"},
    {"tool": "add_people", "observation": "o1", "people": [{}] * 40},
    {"tool": "add_entity", "id": "p1", "observation": "o1", "box": LEFT_BOX, "node": "a"},
]


@pytest.mark.parametrize("call", UNGROUNDED)
def test_a_refused_write_changes_nothing(world, call):
    script = [PAIR, turn(look()), writes(WOMAN, MAN), turn(GRAPH), turn(call), "x"]
    game = play(script, world=world)
    assert results_of(text_of(game.requests[5]))[0].startswith(f"{call['tool']}: refused: ")
    assert world_of(game, 5) == world_of(game, 4)
    refused = [write for write in game.writes if not write.accepted]
    assert [(write.tool, bool(write.reason), write.fact) for write in refused[:1]] == [(call["tool"], True, "")]


def test_single_facts_count_like_a_batch(world):
    batch = play([PAIR, turn(look()), writes(WOMAN, MAN, then=[relation()]), "x"], world=world)
    facts = [entity(), entity("p2", box=RIGHT_BOX), attribute("gender", "female"), attribute("pose", "standing")]
    facts += [attribute("gender", "male", "p2"), attribute("pose", "sitting", "p2"), relation()]
    single = play([PAIR, turn(look()), turn(*facts), "x"], world=world)
    done = [f"{fact['tool']}: done" for fact in facts[2:]]
    assert results_of(text_of(single.requests[3])) == [
        "add_entity: o1: p1 written",
        "add_entity: o1: p2 written",
        *done,
    ]
    assert world_of(single)["likely"] == world_of(batch)["likely"]
    assert world_of(single)["supported"] == world_of(batch)["supported"]


def test_get_graph_lists_everybody(world):
    boxes = [[10 + 90 * n, 200, 80 + 90 * n, 700] for n in range(10)]
    first, second = ([person(f"{name}{n}", box) for n, box in enumerate(boxes)] for name in "pq")
    script = [PLAN, turn(look()), writes(*first), turn(look(150, 90)), writes(*second, observation="o2"), turn(GRAPH)]
    game = play([*script, "x"], world=world)
    assert len(world_of(game)["people"]) == 12
    assert len(json.loads(results_of(text_of(game.requests[6]))[0].partition(": ")[2])) == 20


# -- looks ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (look() | {"frame_id": "../../etc"}, 'frame_id must be a string of six digits, like "000150"'),
        (look() | {"frame_id": 150}, 'frame_id must be a string of six digits, like "000150"'),
        (look() | {"angle_deg": "left"}, "angle_deg must be a number of degrees"),
        (look() | {"sequence": "other"}, "observe has keys that the contract does not know: sequence"),
        (look(150, 180.9), "within 1 degree of the earlier look at angle 180"),
        (look(150, 539.5), "within 1 degree of the earlier look at angle 180"),
    ],
)
def test_looks_that_are_refused(world, call, reason):
    game = play([PLAN, turn(look(), call), "x"], world=world)
    assert results_of(text_of(game.requests[2])) == ["observe: o1", f"observe: refused: {reason}"]
    assert game.prediction.n_observations == 1


def test_an_advised_agent_may_name_any_frame(world):
    game = play([PLAN, turn(look(151)), turn(look(9999)), "x"], world=world)
    assert pictures_of(game.requests[3]) == ["s 000150 180", "s 000295 180"]
    game = play([PLAN, turn(look(151)), "x"], world=world, advice=False)
    assert "none of the legal frames" in results_of(text_of(game.requests[2]))[0]


def test_the_graph_chooses_the_look_after_the_writes_of_the_turn(world):
    """Three searches of a frame are made at once. When the target is read, the next looks serve the answer."""
    game = play([PLAN, turn(ADVISED), "x"], world=world)
    pictures = pictures_of(game.requests[2])
    assert len(pictures) == 3 and all(name.startswith("s 000150 ") for name in pictures)
    advised = line_of(text_of(game.requests[1]), "Looks")
    assert [float(pictures[0].split()[-1])] == pytest.approx([advised[0]["angle_deg"]], abs=0.1)
    assert all(set(one) == {"frame_id", "angle_deg", "reason"} for one in advised) and len(advised) <= 3
    due = json.loads(next(step.response for step in game.steps if step.kind == "solve"))
    assert [one["frame_id"] for one in due] == ["000150"] * 3 and all(one["reason"] for one in due)


def test_without_advice_a_look_needs_frame_and_angle(world):
    game = play([PLAN, turn(ADVISED), "x"], world=world, advice=False)
    assert results_of(text_of(game.requests[2])) == ["observe: refused: observe lacks angle_deg, frame_id"]
    assert "Looks: " not in text_of(game.requests[2])
    observe = game.schemas[1]["properties"]["calls"]["items"]["anyOf"][0]
    assert observe["required"] == ["tool", "frame_id", "angle_deg"]


def test_looks_end_with_the_budget(world):
    game = play([PLAN, turn(*[look(150, 14 * n) for n in range(25)]), "x"], world=world)
    assert results_of(text_of(game.requests[2]))[23:] == [
        "observe: o24",
        "observe: refused: no looks are left: give the final answer",
    ]
    assert "Looks made: 24, left: 0" in text_of(game.requests[2])


# -- limits -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "reply",
    [
        "",
        "I look left",
        '{"calls": []}',
        '{"calls": {}}',
        turn(*[GRAPH] * 33),
        json.dumps({"calls": [GRAPH], "why": "x"}),
        json.dumps(GRAPH),
        '{"calls": [' * 5000,
        turn({"tool": "look"}),
        turn({"tool": 3}),
        turn("observe"),
        turn(entity(name="x" * 13_000)),
        turn(entity(box=[[[[[[1]]]]]])),
    ],
)
def test_four_turns_without_an_accepted_call_end_the_question(world, reply):
    game = play([PLAN, reply, reply, reply, turn(look()), reply], world=world)
    assert len(game.requests) == 9
    assert game.prediction.reason
    assert game.prediction.verdict == "guess"


def test_turns_end(world):
    game = play([PLAN, turn(GRAPH)], world=world, limits=Limits(turns=5))
    assert (len(game.requests), game.prediction.reason) == (6, "no final answer within 5 turns")
    assert "Turns made: 4, left: 1" in text_of(game.requests[5])


def test_at_the_end_the_graph_answers(world):
    told = play([*SEEN, turn(final(3)), turn(GRAPH)], world=world, limits=Limits(turns=4)).prediction
    assert (told.answer, told.evidence.frame) == (Choice(2), 150)


def test_a_final_answer_is_the_last_call(world):
    game = play([*SEEN, turn(final(2), GRAPH), turn(final(2))], world=world)
    assert results_of(text_of(game.requests[4]))[0] == "final_answer: refused: it must be the last call of its turn"


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (final(5), "answer must be the number of a choice, an integer from 1 to 4"),
        (final(2, 7), "entity must be the id of the plan's target"),
        ({"tool": "final_answer", "answer": 2}, "the call lacks entity"),
    ],
)
def test_an_unreadable_final_answer_does_not_count_as_refused_once(world, call, reason):
    game = play([*SEEN, turn(call), turn(final(3)), turn(final(2)), AssertionError], world=world)
    assert results_of(text_of(game.requests[4])) == [f"final_answer: refused: {reason}"]
    assert (game.prediction.answer, game.prediction.reason) == (Choice(2), "")


def test_settings_name_every_limit():
    agents = [ReferenceAgent(None, world=w, looks=looks) for w in (object(), None) for looks in (True, False)]
    told = {agent.name: agent.settings() for agent in agents}
    assert list(told) == ["agent", "agent-passive", "agent-no-world", "agent-passive-no-world"]
    names = ("looks", "turns", "refusals", "calls_per_turn", "repairs", "panoramas", "advice")
    assert [told["agent"].get(name) for name in names] == [24, 50, 4, 32, 3, None, True]
    assert [told["agent-passive-no-world"].get(name) for name in names] == [None, 50, 4, 32, None, 8, None]
    json.dumps(told)


@pytest.mark.parametrize("gender", ["female", "cannot tell"])
def test_a_turn_searches_a_frame_with_up_to_three_looks(world, gender):
    def write_nobody(text):
        names = re.findall(r"observation (o\d+)", text.rpartition("Results:")[2])
        return turn(*(people(observation=name) for name in names), ADVISED)

    later = PLAN | {"times": {"t0": {"frame": 150}, "t1": {"frame": 240}}, "answer": PLAN["answer"] | {"at": "t1"}}
    woman = person("p1", gender=gender, pose="standing")
    game = play([later, turn(look()), writes(woman, then=(ADVISED,)), write_nobody], world=world)
    turns = [
        [json.loads(step.request) for step in steps]
        for kind, steps in itertools.groupby(game.steps, key=lambda step: step.kind)
        if kind == "observe"
    ]
    frames = [[made["frame_index"] for made in looks] for looks in turns]
    assert all(len(set(at)) == 1 and len(at) <= 3 for at in frames)
    # The first look at the frame of the answer is alone, because it usually shows the person.
    assert frames[0] == [150] and len(frames[1]) > 1
    assert [at for at in frames if at[0] == 240][:2] == [[240], [240] * 3]
    # No turn shows one place twice.
    for looks in turns:
        for first, second in itertools.combinations(looks, 2):
            assert angle_error(first["angle_deg"], second["angle_deg"]) >= FOV_DEG / 2
