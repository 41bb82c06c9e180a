"""A run of a scripted believer, and the questions it answers."""

from believing import Believer
from segments import opened, segment_of

from jrdb_avr.engine.run import answering
from jrdb_avr.engine.run import journal as journals
from jrdb_avr.engine.run.methods import open_world
from jrdb_avr.queries.runs import RunManifest, write_run_manifest
from jrdb_avr.schema.method import Question, SequenceInfo

ASKED = [Question(f"{n:016x}", "yard-1_0", f"Question {n}?", ("a", "b"), "multiple_choice") for n in range(6)]


INFO = {"yard-1_0": SequenceInfo("yard-1_0", 15.0, 46, (0, 15, 30, 45))}


def run(store, run_id, asked=ASKED, path=None, finish=True, turns=20, **options):
    """A run of the believer, in the store's graph or one of its own."""
    write_run_manifest(
        store, RunManifest(run_id, "believer", "m", "0" * 64, tuple(q.question_id for q in asked), True, {}, "")
    )
    with opened(segment_of(store.run_path(run_id))) as journal:
        record = journals.world_rows(run_id, journal.finished)
        with open_world(path or store.graph_path, run_id, record) as world:
            answering.answer_all(Believer(world, turns, **options), asked, INFO, None, None, journal, 4)
        if finish:
            journals.write_tables(store, run_id, journal.finished)
