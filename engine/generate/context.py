"""One sequence prepared for search: its facts, its descriptions, and the graph in which the generators run."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import pyarrow as pa

from jrdb_avr.engine.generate.action_onsets import ActionOnsets
from jrdb_avr.engine.generate.descriptions import Descriptions, describe_people
from jrdb_avr.engine.generate.encounters import encounter_tables
from jrdb_avr.engine.generate.relations import Facts, Steps, find_facts, find_steps
from jrdb_avr.engine.generate.scene import Scene, absence_tables
from jrdb_avr.engine.generate.search_graph import scene_graph
from jrdb_avr.engine.generate.templates import query_text, query_values
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.schema.rules import Rules


@dataclass(frozen=True)
class SearchContext(contextlib.AbstractContextManager["SearchContext"]):
    """Shared inputs of every search in one scene; a context manager, which closes the graph.

    facts: the scene's relations. Whatever else follows from these four is worked out when it is first used.
    """

    scene: Scene
    rules: Rules
    facts: Facts
    descriptions: Descriptions

    @classmethod
    def of(cls, scene: Scene, rules: Rules) -> Self:
        """The context with the descriptions that generation chooses."""
        facts = find_facts(scene)
        return cls(scene, rules, facts, describe_people(scene, facts, rules))

    @cached_property
    def steps(self) -> Steps:
        """Whom each relation leads to from each moment."""
        return find_steps(self.scene, self.facts)

    @cached_property
    def onsets(self) -> ActionOnsets:
        """Starts and states of the scene's actions."""
        return ActionOnsets(self.scene)

    @cached_property
    def graph(self) -> Graph:
        """The scene's graph with everything that the generators and the proofs walk along."""
        tables = self.descriptions.tables() | self.steps.tables()
        tables |= absence_tables(self.scene, self.rules) | encounter_tables(self.scene, self.facts, self.rules)
        return scene_graph(self.scene, tables, self.rules)

    def query(self, folder: str, name: str, **values: int) -> pa.Table:
        """Rows of a packaged query over the graph; besides `values` it may use those of the rules."""
        text = query_text(folder, name)
        known = query_values(self.rules) | values
        return self.graph.query(text, {key: known[key] for key in parameters(text)})

    @cached_property
    def people_met(self) -> pa.Table:
        """Everybody whom an encounter window meets: company, person, met, seen; sorted by the first two."""
        return self.query("generators", "gap_count_people")

    def __exit__(self, *error: object) -> None:
        if "graph" in self.__dict__:
            self.graph.close()
