"""Only the graph decides: without its rows, every question of a store ends in a guess."""

import pytest
from painted import asked_sight
from reference_play import text_of

from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.agent.reference.method import ReferenceAgent
from jrdb_avr.agent.simulated.profiles import PERFECT
from jrdb_avr.agent.simulated.server import simulated_server
from jrdb_avr.agent.world.episode import WorldModel
from jrdb_avr.engine.run.bench import Bench
from jrdb_avr.queries.beliefs.graph import WorldGraph


class Chat:
    """A chat that empties the graph before the model gives its answer."""

    def __init__(self, client, graph, empties):
        self.client, self.graph, self.empties = client, graph, empties

    def complete(self, messages, schema=None):
        if self.empties and "Looks: []" in text_of(messages):
            self.graph.graph.execute("MATCH (n) DETACH DELETE n")
        return self.client.complete(messages, schema)


@pytest.mark.parametrize("empties", [True, False])
def test_an_emptied_graph_leaves_a_guess(asked_world, empties):
    bench = Bench.open(asked_world / "store", images=asked_world / "images")
    with simulated_server(asked_sight(), PERFECT) as url, WorldGraph.memory() as graph:
        chat = Chat(Client(url, "simulated", EndpointOptions(simulated=True)), graph, empties)
        agent = ReferenceAgent(chat, world=WorldModel(graph, "run"))
        predictions = [agent.answer(bench.task(question.question_id)) for question in bench.questions]
    assert len(predictions) == 12
    assert {prediction.verdict == "guess" for prediction in predictions} == {empties}
    assert {prediction.evidence is None for prediction in predictions} == {empties}
    assert {prediction.answer is None for prediction in predictions} == {False}
