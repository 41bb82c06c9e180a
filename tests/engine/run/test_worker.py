"""A worker's world models, which are in memory."""

from jrdb_avr.engine.run import worker


class Method:
    name = "method"

    def __init__(self, world):
        self.world = world

    def settings(self):
        return {}

    def answer(self, task):
        self.world.graph.counts["reads"] += 1
        return task(self.world.graph.graph)


def test_a_world_in_memory_is_made_anew_and_closed_once_nobody_is_at_work_in_it(monkeypatch):
    monkeypatch.setattr(worker, "_PER_WORLD", 2)
    seen = []

    def outer(graph):
        for _ in range(3):
            worlds.answer(seen.append)
        assert seen[0] is graph is not seen[1] is seen[2]
        # Others have begun in a new one meanwhile.
        assert graph.query("RETURN 1 AS n ORDER BY n").to_pylist() == [{"n": 1}]

    with worker._Worlds(Method, "r") as worlds:
        worlds.answer(outer)
        assert [graph._closed for graph in seen] == [True, False, False]
        worlds.answer(seen.append)
        assert seen[1]._closed and not seen[3]._closed
    assert seen[3]._closed and worlds.counts() == {"reads": 5, "writes": 0}
