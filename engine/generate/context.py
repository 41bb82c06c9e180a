"""One sequence prepared for search: its facts, its descriptions, and its part of the stored graph."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pyarrow as pa

from jrdb_avr.engine.generate.action_onsets import ActionOnsets
from jrdb_avr.engine.generate.conditions import Conditions, find_conditions
from jrdb_avr.engine.generate.descriptions import Descriptions, describe_people
from jrdb_avr.engine.generate.relations import RELATIONS, Facts, find_facts
from jrdb_avr.engine.generate.scene import Scene, box_count, coded, ints, load_scene
from jrdb_avr.queries.graph.handle import Graph, open_worker_graph
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.queries.keyframes import keyframe_values
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.rules import Rules


@dataclass(frozen=True)
class LayerJob:
    """A sequence for a worker: its store, the rules, and the first of its ids in the keyframe layer."""

    store: Path
    sequence: str
    low: int
    rules: Rules

    @contextlib.contextmanager
    def searching(self) -> Iterator[SearchContext]:
        """The sequence prepared for search. Raises StoreError where tables or graph are missing."""
        store = Store(self.store)
        with open_worker_graph(store.graph_path) as graph:
            yield SearchContext(load_scene(store, self.sequence), self.rules, self.low, graph)

    @property
    def weight(self) -> int:
        """By how much work the sequence is started earlier than others."""
        return box_count(Store(self.store), self.sequence)


@dataclass(frozen=True)
class SearchContext:
    """Shared inputs of every search in one scene.

    graph: the stored graph with its keyframe layer, in which the sequence's ids begin at `low`; None while the layer is
    made.
    """

    scene: Scene
    rules: Rules
    low: int = 0
    graph: Graph | None = None

    @cached_property
    def facts(self) -> Facts:
        """The scene's relations."""
        return find_facts(self.scene)

    @cached_property
    def conditions(self) -> Conditions:
        """What may describe the people of the scene."""
        return find_conditions(self.scene, self.facts, self.rules)

    @cached_property
    def descriptions(self) -> Descriptions:
        """The descriptions that generation chooses."""
        return describe_people(self.conditions, self.rules)

    @cached_property
    def onsets(self) -> ActionOnsets:
        """Starts and states of the scene's actions."""
        return ActionOnsets(self.scene)

    def query(self, folder: str, name: str, **values: int) -> pa.Table:
        """Rows of a packaged query over the sequence's part of the graph; besides `values` it may use those of the
        rules."""
        if self.graph is None:
            raise StoreError("the graph has no keyframe layer yet")
        text = read_statement(f"{folder}/{name}.cypher")
        known = keyframe_values(self.rules, self.low) | values
        return self.graph.query(text, {key: known[key] for key in parameters(text)})

    def query_once(self, folder: str, name: str, **values: int) -> pa.Table:
        """Rows of a packaged query as of `query`, kept for the other templates that read them."""
        key = (folder, name, *values.items())
        if key not in self._held:
            self._held[key] = self.query(folder, name, **values)
        return self._held[key]

    @cached_property
    def _held(self) -> dict[tuple[object, ...], pa.Table]:
        return {}

    @cached_property
    def leads(self) -> dict[tuple[int, int], int]:
        """The moment of whom a relation, as an index into RELATIONS, leads to from a moment."""
        found = self.query("search", "leads")
        frame, relation = ints(found, "frame"), coded(found["relation"], RELATIONS)
        source, target = (self.scene.moments(ints(found, end), frame) for end in ("source", "target"))
        return dict(zip(zip(source.tolist(), relation.tolist(), strict=True), target.tolist(), strict=True))

    @cached_property
    def people_met(self) -> pa.Table:
        """Everybody whom an encounter meets: encounter, person, met, clear_from; sorted by the first two."""
        return self.query("generators", "gap_count_people")
