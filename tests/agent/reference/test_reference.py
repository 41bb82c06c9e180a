"""The reference agent's loop, played by scripted models: turns, budgets, refusals, and what the model is shown."""

import json

import pytest
from environment import SNAPSHOTS
from painted import World, still
from reference_play import (
    GRAPH,
    PLAN,
    PLANS,
    StubSolver,
    attribute,
    defined,
    entity,
    final,
    look,
    pictures_of,
    play,
    proposed,
    text_of,
    turn,
)

from jrdb_avr.agent.reference.method import ReferenceAgent
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.schema.answers import Choice, FrameAnswer, FrameViewpoint, Number, Span
from jrdb_avr.schema.panorama import Box, iou

MODES = ("multiple_choice", "frame", "span", "frame_viewpoint", "number")
FRAMES = tuple(range(0, 300, 5))


@pytest.fixture(scope="module")
def graph():
    with WorldGraph.memory() as graph:
        yield graph


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    people = [still(1845, 7, pose="standing"), still(-40, 8, pose="sitting")]
    return World(tmp_path_factory.mktemp("painted"), people, FRAMES)


def results(messages):
    """The results that a turn shows."""
    lines = text_of(messages).rpartition("Results of your last calls:\n")[2].split("\n")
    return [line for line in lines if line[:1].isdigit() or line == "none"]


def kept(name, told):
    """The texts are part of the benchmark: to change one, delete its snapshot, run twice and read the new one."""
    path = SNAPSHOTS / f"{name}.txt"
    if not path.exists():
        path.write_text(told)
        pytest.fail(f"wrote {path}: read it, then run again")
    assert told == path.read_text()


# -- what is shown ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_prompts_are_as_they_were(world, graph, mode):
    replies = [
        {"root": "a"},
        PLANS[mode],
        turn(look()),
        turn(entity(node="a"), attribute("gender", "female"), look(155), look(155, 180.5), GRAPH),
        "I look left",
        turn(final()),
        "no more",
    ]
    game = play(world, replies, mode, graph=graph)
    plan, shown = text_of(game.requests[1]), text_of(game.requests[4])
    kept(f"agent_{mode}", f"{plan}\n=====\n{shown}\n=====\n{text_of(game.requests[5]).rpartition('Graph: ')[2]}\n")


@pytest.mark.parametrize("name", ["agent_passive", "agent_no_world", "agent_passive_no_world"])
def test_variants_show_what_they_showed(world, graph, name):
    remembers, looks = name == "agent_passive", name == "agent_no_world"
    script = [PLANS["frame"]] if remembers else []
    script += [turn(look()) if looks else turn(final()), "hm", turn(proposed({"frame_id": "000900"})), turn(look(155))]
    game = play(world, [*script, "no more"], "frame", looks=looks, graph=graph if remembers else None)
    kept(name, text_of(game.requests[len(script)]) + "\n")


def test_the_graph_is_the_only_memory(world, graph):
    game = play(world, [PLAN, turn(look()), turn(entity(node="a")), turn(look(155)), turn(GRAPH), "x"], graph=graph)
    assert {len(request) for request in game.requests} == {2}
    assert [pictures_of(request) for request in game.requests[:6]] == [
        [],
        [],
        ["painted 000150 180"],
        ["painted 000150 180"],
        ["painted 000155 180"],
        ["painted 000155 180"],
    ]
    shown = json.loads(text_of(game.requests[5]).partition("\nGraph: ")[2].partition("\n")[0])
    (person,) = shown["entities"]
    assert (person["id"], person["node"]) == ("p1", "a")
    assert iou(Box(*person["sightings"][0]["box"]), Box(1845, 120, 70, 220)) > 0.95
    assert shown["missing"] == ["a: not found"]


def test_passive_shows_all_panoramas_in_every_turn(world, graph):
    game = play(world, [PLAN, turn(GRAPH), turn(entity(box=(495, 250, 505, 708))), "x"], graph=graph, looks=False)
    assert [len(pictures_of(request)) for request in game.requests] == [0, *[8] * 80]
    assert game.prediction.n_observations == 8
    shown = json.loads(text_of(game.requests[3]).partition("\nGraph: ")[2].partition("\n")[0])
    # Thousandths of the whole panorama: 3.76 columns each.
    assert shown["entities"][0]["sightings"][0]["box"][:2] == pytest.approx([1861.2, 120])
    assert "observe" not in json.dumps(game.schemas)


def test_no_world_sends_the_chat_so_far(world):
    said = [turn(look()), turn(look(155)), "hm", turn(proposed(2, "o1"))]
    game = play(world, said)
    roles = [[message.role for message in request] for request in game.requests]
    assert roles == [["system", "user", *["assistant", "user"] * n] for n in range(4)]
    assert [m.parts[0] for m in game.requests[3] if m.role == "assistant"] == said[:3]
    assert pictures_of(game.requests[3]) == ["painted 000150 180", "painted 000155 180"]
    for before, after in zip(game.requests, game.requests[1:], strict=False):
        assert after[: len(before)] == before
    assert not any("Plan: " in text_of(request) or "Graph: " in text_of(request) for request in game.requests)


# -- answering --------------------------------------------------------------------------------------------------------


def test_a_legal_final_answer(world, graph):
    seen = (150, (3780.0, 120.0, 70.0, 220.0))
    game = play(world, [PLAN, turn(look()), turn(final(2))], graph=graph, solver=defined("standing", seen))
    assert (game.prediction.status, game.prediction.answer) == ("answered", Choice(2))
    assert (game.prediction.evidence.frame, game.prediction.evidence.box) == (150, (20.0, 120.0, 70.0, 220.0))
    assert (game.prediction.n_model_calls, game.prediction.n_observations) == (3, 1)
    assert [step.kind for step in game.steps] == [
        "model",
        "tool",
        *("model", "observe", "tool"),
        "model",
        "solve",
        "tool",
    ]


def test_a_final_answer_that_is_not_legal_is_told_what_is_missing_and_kept(world, graph):
    game = play(world, [PLAN, turn(final(2)), turn(GRAPH)], graph=graph)
    assert results(game.requests[2]) == ["1. final_answer: refused: a: not found"]
    told = game.prediction
    assert (told.status, told.answer, told.evidence, told.verdict) == ("answered", Choice(2), None, "guess")
    assert told.reason == "a: not found"


def test_a_final_answer_that_is_sent_again_as_it_was_ends_the_question(world, graph):
    game = play(world, [PLAN, turn(final(2)), turn(GRAPH), turn(final(3)), turn(final(3)), AssertionError], graph=graph)
    assert (len(game.requests), game.prediction.answer) == (5, Choice(3))
    # What was seen or written in between may have made it another one.
    script = [PLAN, turn(look()), turn(final(2)), turn(entity()), turn(final(2)), turn(look(155)), turn(final(2))]
    assert len(play(world, [*script, turn(final(2)), AssertionError], graph=graph).requests) == 8
    # A write that is refused is none.
    again = [PLAN, turn(final(2)), turn(entity(), final(2)), AssertionError]
    assert len(play(world, again, graph=graph).requests) == 3


def test_the_kept_answer_has_the_box_of_its_entity(world, graph):
    """Both people fit, so that the graph has no single target; neither is seen to do anything."""
    other = [entity("p2", box=(10, 250, 156, 708)), attribute("gender", "female", "p2")]
    script = [PLAN, turn(look()), turn(*SEEN[:2], *other), turn(final(1, "p2")), turn(final(1, "p2"))]
    told = play(world, script, graph=graph, solver="real").prediction
    assert (told.status, told.answer, told.verdict) == ("answered", Choice(1), "guess")
    assert iou(Box(*told.evidence.box), Box(1640 + 4.8, 120, 70, 220)) > 0.95
    assert told.reason.startswith("the graph has no single target")


@pytest.mark.parametrize(
    "call, reason",
    [
        (final(5), "answer must be the number of a choice, an integer from 1 to 4"),
        (final("standing"), "answer must be the number of a choice, an integer from 1 to 4"),
        (final(2, 7), "entity must be the id of the plan's target"),
        ({"tool": "final_answer", "answer": 2}, "the call lacks entity"),
        (final(2) | {"box": [1, 2, 3, 4]}, "the call has keys that the contract does not know: box"),
    ],
)
def test_a_final_answer_that_cannot_be_read_is_refused(world, graph, call, reason):
    game = play(world, [PLAN, turn(call), "x"], graph=graph, solver=defined())
    assert results(game.requests[2]) == [f"1. final_answer: refused: {reason}"]
    assert game.prediction.answer == Choice(2)


def test_a_final_answer_stands_last(world, graph):
    game = play(world, [PLAN, turn(final(2), GRAPH), turn(final(2))], graph=graph, solver=defined())
    assert results(game.requests[2]) == [
        "1. final_answer: refused: it must be the last call of its turn",
        "2. get_graph: done",
    ]
    assert game.prediction.status == "answered"


@pytest.mark.parametrize("last", ["budget", "malformed"])
def test_at_the_end_the_graph_answers_by_itself(world, graph, last):
    script = [PLAN, turn(look()), *([turn(GRAPH)] if last == "budget" else ["x"])]
    game = play(world, script, graph=graph, solver=defined("sitting"))
    assert (game.prediction.status, game.prediction.answer) == ("answered", Choice(3))
    assert (game.prediction.evidence.frame, game.prediction.verdict) == (150, "certain")
    # What is missing is told in every turn without the engine; it solves once, at the end.
    assert [step.kind for step in game.steps].count("solve") == 1


def test_at_the_end_a_read_that_is_no_choice_gives_way_to_what_was_proposed(world, graph):
    guess = (155, (10.0, 20.0, 30.0, 40.0))
    solver = StubSolver(defined("cycling").belief, "the graph's answer is none of the choices", guess)
    told = play(world, [PLAN, turn(final(4)), "x"], graph=graph, solver=solver).prediction
    assert (told.status, told.answer, told.verdict, told.evidence.box) == ("answered", Choice(4), "guess", guess[1])


def test_at_the_end_somebody_who_was_seen_is_answered_of(world, graph):
    guess = (155, (10.0, 20.0, 30.0, 40.0))
    game = play(world, [PLAN, turn(look()), "x"], graph=graph, solver=StubSolver(box=guess))
    told = game.prediction
    assert (told.status, told.answer, told.verdict, told.evidence.box) == ("answered", Choice(1), "guess", guess[1])
    assert told.reason.startswith("the reply is not one JSON object")


@pytest.mark.parametrize(
    ("mode", "answer"),
    [
        ("frame", FrameAnswer(155)),
        ("span", Span(155, 155)),
        ("frame_viewpoint", FrameViewpoint(155, pytest.approx(180.0))),
        ("number", Number(1.0)),
    ],
)
def test_a_guess_in_every_mode(world, graph, mode, answer):
    solver = StubSolver(box=(155, Box(1870.0, 20.0, 20.0, 40.0)))
    told = play(world, [PLANS[mode], turn(GRAPH)], mode, graph=graph, solver=solver).prediction
    assert (told.answer, told.verdict) == (answer, "guess")


def test_at_the_end_the_proposed_answer_stands_before_what_is_read_of_a_stranger(world, graph):
    """Nobody is known to be a woman: what is read of the only person is not borne out."""
    game = play(world, [PLAN, turn(look()), turn(entity(), SEEN[2], final(3)), "x"], graph=graph, solver="real")
    assert "nobody in the graph fits the plan" in results(game.requests[3])[-1]
    told = game.prediction
    assert (told.status, told.answer, told.verdict) == ("answered", Choice(3), "guess")
    assert iou(Box(*told.evidence.box), Box(1845, 120, 70, 220)) > 0.95
    # Without a proposal it is all that there is.
    told = play(world, [PLAN, turn(look()), turn(entity(), SEEN[2]), "x"], graph=graph, solver="real").prediction
    assert (told.answer, told.verdict) == (Choice(2), "guess")


def test_at_the_end_the_person_who_fits_most_is_read_before_what_was_proposed(world, graph):
    """Of two conditions one holds of the first person, and both of nobody; of three two do."""
    adult = {"attribute": "age", "value": "young adulthood"}
    far = {"attribute": "distance", "value": "far", "at": "t0"}
    female = PLAN["nodes"][0]["conditions"][0]
    for conditions, answer, verdict in (
        ([female, far], Choice(3), "guess"),
        ([female, adult, far], Choice(2), "supported"),
    ):
        plan = PLAN | {"nodes": [{"id": "a", "conditions": conditions}]}
        calls = [*SEEN, attribute("age", "young adulthood"), final(3)]
        told = play(world, [plan, turn(look()), turn(*calls), "x"], graph=graph, solver="real").prediction
        assert (told.answer, told.verdict) == (answer, verdict)


def test_at_the_end_nobody_may_have_been_seen(world, graph):
    told = play(world, [PLAN, "x"], graph=graph).prediction
    assert (told.status, told.answer, told.evidence, told.verdict) == ("invalid", None, None, None)
    told = play(world, [PLAN, turn(GRAPH)], graph=graph).prediction
    assert (told.status, told.answer, told.reason) == ("answered", None, "no final answer within 80 calls")


def test_no_world_answers_with_its_own_box(world):
    game = play(world, [turn(look(150, 360)), turn(proposed(3, box=(417, 250, 563, 708)))])
    assert (game.prediction.status, game.prediction.answer) == ("answered", Choice(3))
    assert iou(Box(*game.prediction.evidence.box), Box(-40, 120, 70, 220)) > 0.95


def test_no_world_keeps_what_can_be_read_of_the_newest_answer(world):
    game = play(world, [turn(look()), turn(proposed(9)), "x"])
    assert results(game.requests[2])[0].startswith("1. final_answer: refused: answer must be the number of a choice")
    assert (game.prediction.status, game.prediction.answer) == ("invalid", None)
    assert game.prediction.evidence.frame == 150
    again = [turn(proposed(2, "o7"))] * 2
    game = play(world, [turn(look()), *again, AssertionError])
    assert (game.prediction.status, game.prediction.answer, game.prediction.evidence) == ("invalid", Choice(2), None)
    assert "observation must name one that has been made" in game.prediction.reason
    # Each part by the newest that could be read.
    game = play(world, [turn(look()), again[0], turn(proposed(9)), turn(proposed(9))])
    assert (game.prediction.status, game.prediction.answer) == ("answered", Choice(2))
    assert (game.prediction.evidence.frame, game.prediction.verdict) == (150, None)


# -- with the solver --------------------------------------------------------------------------------------------------

SEEN = [entity(node="a"), attribute("gender", "female"), attribute("action", "standing")]


def test_what_was_written_makes_the_answer_legal(world, graph):
    """Refused while something is missing, and told what; accepted once the graph gives the same answer."""
    script = [PLAN, turn(look()), turn(*SEEN[:2], final(2)), turn(SEEN[2], final(3)), turn(final(2, "p2"))]
    game = play(world, [*script, turn(final(2))], graph=graph, solver="real")
    told = [results(request)[-1].partition("refused: ")[2] for request in game.requests[3:6]]
    assert told[0].startswith("the graph does not give the answer; missing: the answer: the action of p1 at frame")
    assert told[1] == "the graph's answer is choice 2, 'standing', which the proposed one is not"
    assert told[2] == "the plan's target in the graph is p1, not p2"
    assert (game.prediction.status, game.prediction.answer) == ("answered", Choice(2))
    assert iou(Box(*game.prediction.evidence.box), Box(1845, 120, 70, 220)) > 0.95
    missing = [json.loads(text_of(r).partition("Graph: ")[2].partition("\n")[0])["missing"] for r in game.requests[1:]]
    assert missing[0] and not missing[-1]


def seen_in(name):
    """What makes the answer known, of an observation."""
    return [
        entity(node="a", observation=name, box=(495, 250, 505, 708)),
        attribute("gender", "female", observation=name),
        attribute("action", "standing", observation=name),
    ]


def planned_at(frame):
    return PLAN | {"times": {"t0": {"frame": frame}}}


@pytest.mark.parametrize(("frame", "verdict"), [(150, "certain"), (165, "certain"), (166, None), (134, None)])
def test_a_stated_frame_is_met_by_a_look_within_a_second(world, graph, frame, verdict):
    script = [planned_at(frame), turn(look()), turn(*seen_in("o1"), final(2)), turn(final(2))]
    game = play(world, script, graph=graph, solver="real")
    told = game.prediction
    assert (told.answer, told.evidence.frame) == (Choice(2), 150)
    if verdict is None:
        assert "nobody in the graph fits the plan" in results(game.requests[3])[-1]
        # The look is the nearest that there is, and the answer is read there at the end.
        assert (len(game.requests), told.verdict) == (4, "supported")
    else:
        assert (len(game.requests), told.verdict) == (3, verdict)


@pytest.mark.parametrize(("frame", "verdict"), [(170, "certain"), (160, "certain"), (150, "supported")])
def test_a_stated_frame_is_met_by_the_nearest_panorama(world, graph, frame, verdict):
    """The fifth is of frame 170, the fourth of 125: the answer is taken, and is certain within a second alone."""
    script = [planned_at(frame), turn(*seen_in("o5"), final(2)), AssertionError]
    told = play(world, script, graph=graph, solver="real", looks=False).prediction
    assert (told.status, told.answer, told.verdict, told.evidence.frame) == ("answered", Choice(2), verdict, 170)


def test_what_was_written_answers_at_the_end(world, graph):
    game = play(world, [PLAN, turn(look()), turn(*SEEN), "x"], graph=graph, solver="real")
    assert (game.prediction.status, game.prediction.answer) == ("answered", Choice(2))
    assert game.prediction.evidence.frame == 150


def test_a_plan_that_cannot_be_solved_is_repaired(world, graph):
    """Conditions hold at stated frames: the compiler's refusal is shown like any other."""
    condition = {"action": "sitting", "at": "t1"}
    plan = PLANS["frame"] | {"nodes": [{"id": "a", "conditions": [condition]}]}
    game = play(world, [plan, PLANS["frame"], "x"], "frame", graph=graph, solver="real")
    assert "Your plan was refused: times.t1: conditions and edges hold at stated frames" in text_of(game.requests[1])


# -- looks ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "call, reason",
    [
        (look(151), "frame_id 000151 is none of the legal frames"),
        (look() | {"frame_id": "../../etc"}, 'frame_id must be a string of six digits, like "000150"'),
        (look() | {"frame_id": 150}, 'frame_id must be a string of six digits, like "000150"'),
        (look() | {"angle_deg": "left"}, "angle_deg must be a number of degrees"),
        (look() | {"sequence": "other"}, "the call has keys that the contract does not know: sequence"),
        (look(150, 180.9), "within 1 degree of the earlier look at angle 180"),
        (look(150, 539.5), "within 1 degree of the earlier look at angle 180"),
    ],
)
def test_looks_that_are_refused(world, graph, call, reason):
    game = play(world, [PLAN, turn(look(), call), "x"], graph=graph)
    assert results(game.requests[2]) == ["1. observe: o1", f"2. observe: refused: {reason}"]
    assert game.prediction.n_observations == 1
    assert [(w.tool, w.accepted, w.reason) for w in game.writes[2:4]] == [
        ("observe", True, ""),
        ("observe", False, reason),
    ]


def test_the_24th_look_is_made_and_the_25th_is_not(world, graph):
    looks = [look(150, 14 * n) for n in range(25)]
    game = play(world, [PLAN, turn(*looks[:23]), turn(looks[23], looks[24]), "x"], graph=graph)
    assert results(game.requests[3]) == ["1. observe: o24", "2. observe: refused: no looks are left"]
    assert "Looks made: 24, left: 0\nTool calls made: 25, left: 55" in text_of(game.requests[3])
    assert game.prediction.n_observations == 24


# -- calls ------------------------------------------------------------------------------------------------------------


def test_the_80th_call_is_carried_out_and_the_81st_is_not(world, graph):
    many = [turn(*[GRAPH] * 32), turn(*[GRAPH] * 32), turn(*[GRAPH] * 15)]
    game = play(world, [PLAN, *many, turn(look(), look(155), final(2))], graph=graph, solver=defined())
    assert "Tool calls made: 79, left: 1" in text_of(game.requests[4])
    assert game.prediction.n_observations == 1
    assert len(game.requests) == 5
    # The final answer was not carried out: what stands is what the graph says.
    (committed,) = (write for write in game.writes if write.tool == "final_answer")
    assert json.loads(committed.arguments)["entity"] and json.loads(committed.fact)["episode"]["verdict"] == "certain"
    game = play(world, [PLAN, *many, turn(final(2))], graph=graph, solver=defined())
    assert [write.accepted for write in game.writes if write.tool == "final_answer"] == [True]


def test_an_answer_beyond_the_last_call_is_not_judged_but_kept(world, graph):
    many = [turn(*[GRAPH] * 32), turn(*[GRAPH] * 32), turn(*[GRAPH] * 15)]
    told = play(world, [PLAN, *many, turn(look(), final(2))], graph=graph).prediction
    assert (told.answer, told.verdict, told.reason) == (Choice(2), "guess", "no final answer within 80 calls")


WRITES = [
    (entity(observation="o7"), "add_entity", "observation 'o7' has not been made; made: o1"),
    (entity(box=(500, 0, 400, 10)), "add_entity", "box has no area or reversed corners"),
    (entity(box=("NaN", 0, 400, 10)), "add_entity", "box must be a list of four integers"),
    (entity(node="z"), "add_entity", "node 'z' is none of the plan's: a"),
    (attribute("gender", "female", "p9"), "add_attribute", "there is no entity 'p9'"),
    (attribute("gender", "women"), "add_attribute", "gender has no value 'women'; it is male, female"),
    (
        {"tool": "add_relation", "source": "p1", "name": "conversation", "target": "p1", "observation": "o1"},
        "add_relation",
        "a relation joins two different entities",
    ),
    (GRAPH | {"of": "o1"}, "get_graph", "get_graph has keys that the contract does not know: of"),
    ({"tool": "look"}, "?", 'there is no tool "look"; there are observe, add_entity, add_attribute'),
    ({"tool": 3}, "?", 'a call is an object that names its "tool"'),
    ("observe", "?", 'a call is an object that names its "tool"'),
    (entity(name="x" * 3000), "add_entity", "the call is too deep or too long"),
    (entity(node=[[[[["a"]]]]]), "add_entity", "the call is too deep or too long"),
]


@pytest.mark.parametrize("call, tool, reason", WRITES)
def test_a_bad_call_is_refused_by_itself(world, graph, call, tool, reason):
    game = play(world, [PLAN, turn(look(), entity(), call, attribute("gender", "female")), "x"], graph=graph)
    shown = results(game.requests[2])
    assert shown[2].startswith(f"3. {tool}: refused: {reason}")
    assert shown[3] == "4. add_attribute: done"
    refused = [write for write in game.writes if not write.accepted]
    assert [write.tool for write in refused] == ([] if tool == "?" else [tool])
    assert not tool.startswith("add_") or refused[0].reason.startswith(reason)


@pytest.mark.parametrize(
    "reply",
    [
        "",
        "I look left",
        '{"calls": []}',
        '{"calls": {}}',
        json.dumps({"calls": [GRAPH] * 33}),
        json.dumps({"calls": [{"junk": n} for n in range(10_000)]}),
        json.dumps({"calls": [GRAPH], "why": "x"}),
        json.dumps(GRAPH),
        '{"calls": [' * 5000,
    ],
)
def test_a_malformed_turn_costs_a_call(world, graph, reply):
    """However many there are, the question goes on."""
    game = play(world, [PLAN, reply, turn(look()), *[reply] * 9, turn(final(2))], graph=graph, solver=defined())
    assert len(game.requests) == 13
    told = "Your last turn was malformed, and cost a call: "
    assert told in text_of(game.requests[2])
    assert told not in text_of(game.requests[3])
    assert "Tool calls made: 11, left: 69" in text_of(game.requests[12])
    assert (game.prediction.status, game.prediction.answer, game.prediction.reason) == ("answered", Choice(2), "")
    ended = play(world, [PLAN, reply], graph=graph)
    assert (len(ended.requests), ended.prediction.status) == (81, "invalid")


# -- the plan ---------------------------------------------------------------------------------------------------------


def test_a_refused_plan_is_repaired(world, graph):
    bad = PLAN | {"target": "b"}
    game = play(world, [bad, PLAN, "x"], graph=graph)
    shown = text_of(game.requests[1])
    assert f"Your last plan: {json.dumps(bad, separators=(',', ':'))}\n" in shown
    assert "Your plan was refused: target: unknown node 'b'; known: a\nYour plan, as one JSON object:" in shown
    assert [(write.tool, write.accepted) for write in game.writes] == [("begin", True), ("plan", False), ("plan", True)]


@pytest.mark.parametrize("mode", MODES)
def test_after_three_repairs_the_smallest_plan_is_taken(world, graph, mode):
    """The target alone, and the read that the mode implies: it proves nothing, and what is proposed stands."""
    answer, meant = {
        "multiple_choice": (3, Choice(3)),
        "frame": ({"frame_id": "000100"}, FrameAnswer(100)),
        "span": ({"start_frame": "000100", "end_frame": "000200"}, Span(100, 200)),
        "frame_viewpoint": ({"frame_id": "000100", "angle_deg": 10.0}, FrameViewpoint(100, 10.0)),
        "number": ({"value": "4"}, Number(4.0)),
    }[mode]
    seen = [entity(node="a"), attribute("action", "standing")]
    script = [*[{"root": "a"}] * 4, turn(look(0)), turn(*seen), turn(final(answer)), turn(final(answer))]
    game = play(world, [*script, AssertionError], mode, graph=graph, solver="real")
    assert [(write.tool, write.accepted) for write in game.writes[:6]] == [
        ("begin", True),
        *[("plan", False)] * 4,
        ("plan", True),
    ]
    plan = json.loads(text_of(game.requests[4]).partition("\nPlan: ")[2].partition("\n")[0])
    assert (plan["root"], plan["target"], plan["edges"], plan["answer"]["mode"]) == ("a", "a", [], mode)
    assert plan["nodes"] == [{"id": "a", "conditions": []}]
    told = game.prediction
    assert (told.status, told.answer, told.verdict, told.evidence.frame) == ("answered", meant, "guess", 0)


# -- settings, and what is kept ---------------------------------------------------------------------------------------


def test_settings_print_every_budget():
    told = {
        agent.name: agent.settings()
        for agent in (ReferenceAgent(None, world=w, looks=looks) for w in (object(), None) for looks in (True, False))
    }
    assert list(told) == ["agent", "agent-passive", "agent-no-world", "agent-passive-no-world"]
    budgets = ("looks", "calls", "calls_per_turn", "repairs", "model_calls", "panoramas", "duplicate_deg")
    assert [told["agent"].get(name) for name in budgets] == [24, 80, 32, 3, 84, None, 1.0]
    assert [told["agent-passive-no-world"].get(name) for name in budgets] == [None, 80, 32, None, 80, 8, None]
    json.dumps(told)
