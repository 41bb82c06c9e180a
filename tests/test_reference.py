"""The reference agent's loop, played by scripted models: turns, budgets, refusals, and what the model is shown."""

from pathlib import Path

import pytest
from painted_world import World, still
from reference_play import GRAPH, PLANS, attribute, entity, final, look, play, proposed, text_of, turn

SNAPSHOTS = Path(__file__).parent / "snapshots"
MODES = ("multiple_choice", "frame", "span", "frame_viewpoint", "number")


@pytest.fixture
def world(tmp_path):
    return World(tmp_path, [still(1845, 7, pose="standing"), still(-40, 8, pose="sitting")], tuple(range(0, 300, 5)))


def kept(name, told):
    """The texts are part of the benchmark: to change one, delete its snapshot, run twice and read the new one."""
    path = SNAPSHOTS / f"{name}.txt"
    if not path.exists():
        path.write_text(told)
        pytest.fail(f"wrote {path}: read it, then run again")
    assert told == path.read_text()


@pytest.mark.parametrize("mode", MODES)
def test_prompts_are_as_they_were(world, mode):
    replies = [
        {"root": "a"},
        PLANS[mode],
        turn(look()),
        turn(entity(node="a"), attribute("gender", "female"), look(155), look(155, 180.5), GRAPH),
        "I look left",
        turn(final()),
        "no more",
    ]
    game = play(world, replies, mode)
    plan, turn_shown = text_of(game.requests[1]), text_of(game.requests[5])
    kept(f"agent_{mode}", f"{plan}\n=====\n{turn_shown}\n")


@pytest.mark.parametrize("name", ["agent_passive", "agent_no_world", "agent_passive_no_world"])
def test_variants_show_what_they_showed(world, name):
    remembers, looks = name == "agent_passive", name == "agent_no_world"
    script = [PLANS["frame"]] if remembers else []
    script += [turn(look()) if looks else turn(final()), "hm", turn(proposed({"frame_id": "000900"})), turn(look(155))]
    game = play(world, [*script, "no more"], "frame", looks=looks, remembers=remembers)
    kept(name, text_of(game.requests[-1]) + "\n")
