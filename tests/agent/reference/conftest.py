import pytest

from jrdb_avr.agent.world.episode import WorldModel
from jrdb_avr.queries.beliefs.graph import WorldGraph


@pytest.fixture(scope="module")
def world():
    with WorldGraph.memory() as graph:
        yield WorldModel(graph, "run")
