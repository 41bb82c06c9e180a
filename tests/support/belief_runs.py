"""A method that writes a world model at random, seeded by the question, and a run of it."""

import random

from scored_runs import opened, segment_of
from world_calls import CHOICES, PLAN, play

from jrdb_avr.engine.run import answering
from jrdb_avr.engine.run import journal as journals
from jrdb_avr.engine.run.methods import open_world
from jrdb_avr.queries.beliefs.graph import open_graph
from jrdb_avr.queries.beliefs.record import merge_world
from jrdb_avr.queries.runs import RunManifest, write_run_manifest
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.method import Prediction, Question, SequenceInfo

BELIEF_QUERIES = {
    *("world_runs", "writes", "refused_writes", "looks", "seen_when"),
    *("beliefs_at_step", "unresolved_at_step"),
    *("belief_plan", "belief_hypotheses", "belief_votes"),
}
"""The named queries about the world tables."""

ASKED = [Question(f"{n:016x}", "yard-1_0", f"Question {n}?", CHOICES, "multiple_choice") for n in range(6)]
INFO = {"yard-1_0": SequenceInfo("yard-1_0", 15.0, 151, tuple(range(0, 151, 15)))}


class Believer:
    """Makes `turns` turns in each question, with refused calls between them."""

    name = "believer"

    def __init__(self, world, turns=6):
        self.world, self.turns = world, turns

    def settings(self):
        return {"turns": self.turns}

    def answer(self, task):
        random_ = random.Random(task.question.question_id)
        episode = self.world.episode(task.question, task.record_write)
        episode.set_plan(PLAN, 0)
        for step in range(1, self.turns):
            play(episode, random_, step)
            episode.bindings()
            for tool in random_.sample(("add_people", "add_entity", "observe"), random_.randint(0, 2)):
                episode.refuse(tool, {"id": step % 2}, random_.choice(("no look", "no box")), step)
        frames = INFO["yard-1_0"].frames
        episode.answered(Choice(1), episode.conclude(task.question.choices, frames), self.turns)
        return Prediction("invalid")


def run(store, run_id, asked=ASKED, finish=True, turns=6):
    """A run of the believer, which is merged into the store's graph if it is finished."""
    write_run_manifest(
        store, RunManifest(run_id, "agent", "m", "0" * 64, tuple(q.question_id for q in asked), True, {}, "")
    )
    folder = store.run_path(run_id)
    with opened(segment_of(folder)) as journal:
        with open_world(folder, run_id) as world:
            answering.answer_all(Believer(world, turns), asked, INFO, None, None, journal, 4)
        if finish:
            with open_graph(store.graph_path) as graph:
                merge_world(graph, run_id, journals.world_rows(run_id, journal.finished))
            journals.write_tables(store, run_id, journal.finished)
