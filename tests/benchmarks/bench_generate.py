"""How long generation takes and what memory it holds, whether its time grows with the boxes alone, and how the search
for chains compares with networkx.

    python tests/benchmarks/bench_generate.py [--store STORE] [--workers 2] [--scale 0.25] [--only generate|networkx]

STORE is a loaded store, which is only read; without it a synthetic one of every layer is made (scale 1: 27 sequences,
about 957,000 boxes). Printed, all of it measured in one run:

- `generate` of all sequences, of a third and of a ninth of them (every third and every ninth by size): the keyframe
  layer by itself, then the rest: seconds, seconds per million boxes, the highest resident memory of all processes
  together, sampled fifty times a second;
- where the time goes, one process: by step, and by template with everything that is done for it;
- two_hop and three_hop from the same described people, in networkx and here, in processor seconds; both must find the
  same rows: the chains, what is seen of their people, and what every program of hop.stop and hop.skip answers.
  networkx holds the same relations twice: as one MultiDiGraph of a sequence with timed edges, as the annotations tell
  them (and as the scene's graph stores them), and as a MultiDiGraph per keyframe; a person's steps at a keyframe are
  worked out once. Timed are the searches alone, and with what they search: there the building of the graphs, here all
  rows of the keyframe layer.

On a machine that is busy with other things processor seconds hold better than wall seconds.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import tempfile
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import msgspec
import networkx as nx
import numpy as np
import pyarrow.parquet as pq
from bench_load import Clock, Memory, sample

from jrdb_avr.engine.generate import context as contexts
from jrdb_avr.engine.generate import records, search, views
from jrdb_avr.engine.generate import sequence as shard
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.keyframe_graph import derived_tables, ensure_layer
from jrdb_avr.engine.generate.keyframes import keyframe_tables
from jrdb_avr.engine.generate.relations import KIND, RELATIONS
from jrdb_avr.engine.generate.run import generate
from jrdb_avr.engine.generate.scene import NOBODY, coded, ints, load_scene
from jrdb_avr.loaders.graph import build_scene
from jrdb_avr.loaders.load import load
from jrdb_avr.loaders.root import find_root
from jrdb_avr.queries.graph.handle import Graph, build_graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.graph import KEYFRAME_RELS
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.relations import SAME_GROUP
from jrdb_avr.schema.rules import LoadRules, Rules

RULES = Rules()
CODE = {relation: code for code, relation in enumerate(RELATIONS)}
KINDS = KIND.tolist()


# -- generation -------------------------------------------------------------------------------------------------


def part_of(store, names, folder):
    """A store of some of the sequences whose tables are those of another one."""
    folder.mkdir()
    for name in ("annotations", "intervals"):
        (folder / name).symlink_to((store.path / name).resolve())
    part = Store(folder)
    whole = store.manifest()
    part.write_manifest(msgspec.structs.replace(whole, sequences={name: whole.sequences[name] for name in names}))
    with build_graph(part.graph_path) as graph:
        build_scene(graph, part, names)
    return part


def boxes(store, sequence):
    return pq.read_metadata(store.interval_path("sightings", sequence)).num_rows


def measure_generate(store, workers, folder):
    """Whole generations of all sequences, of a third and of a ninth of them."""
    by_size = sorted(store.manifest().sequences, key=lambda name: (boxes(store, name), name))
    print(
        f"{'sequences':>9}{'boxes':>11}{'':>7}{'wall s':>9}{'cpu s':>9}{'cpu s / million':>17}"
        f"{'peak MB':>9}{'questions':>11}"
    )
    for step in (1, 3, 9):
        names = by_size[step // 2 :: step]
        # In a process of its own, as this one would keep the memory that it took.
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            part = pool.submit(part_of, store, names, folder / f"every-{step}").result()
        clock, memories = Clock(), {}
        with Memory() as memories["layer"], clock("layer"):
            ensure_layer(part, RULES, workers)
        with Memory() as memories["rest"], clock("rest"):
            report = generate(part, RULES, workers=workers)
        number = sum(boxes(store, name) for name in names)
        questions = {"rest": f"{sum(row['questions'] for row in report.templates):,}"}
        for step, memory in memories.items():
            wall, busy = clock.seconds[step]
            line = f"{len(names):9}{number:11,}{step:>7}{wall:9.1f}{busy:9.1f}{busy / number * 1e6:17.1f}"
            print(f"{line}{memory.all:9.0f}{questions.get(step, ''):>11}")
        assert not report.faults, report.faults[0]


def measure_steps(store):
    """Every step of every sequence, one after another in this process; a step's seconds are its own alone."""
    steps, templates = Exclusive(), Exclusive()
    rows = defaultdict(int)

    def found(context, template):
        with templates(template.name), steps("search and proofs"):
            result = search.find_candidates(context, template)
        rows[template.name] += len(result)
        return result

    def judged(self, forms, judge=shard._Search.judge):
        with templates(forms[0].template.name), steps("examples, thinning out, the rest"):
            judge(self, forms)

    named = {
        (contexts, "load_scene"): "tables of the sequence",
        (contexts, "find_facts"): "relations and descriptions",
        (contexts, "find_conditions"): "relations and descriptions",
        (contexts, "describe_people"): "relations and descriptions",
        (shard, "to_table"): "plans and keys",
        (shard, "rederive"): "second path",
        (shard, "make_record"): "records and choices",
        (records, "make_choices"): "records and choices",
    }
    with contextlib.ExitStack() as stack:
        stack.enter_context(mock.patch.object(shard, "find_candidates", found))
        stack.enter_context(mock.patch.object(shard._Search, "judge", judged))
        read = steps.timed("second path: its tables", shard.Annotations.read)
        stack.enter_context(mock.patch.object(shard.Annotations, "read", read))
        for (module, name), step in named.items():
            stack.enter_context(mock.patch.object(module, name, steps.timed(step, getattr(module, name))))
        lows = ensure_layer(store, RULES, 1)
        stack.enter_context(Graph.open(store.graph_path, read_only=True))
        for sequence, low in lows.items():
            with templates("(for all)"), steps("examples, thinning out, the rest"):
                shard.search_sequence(shard.SequenceJob(store.path, sequence, low, RULES))
    for title, clock in (("step", steps), ("template", templates)):
        whole = sum(clock.seconds.values())
        print(f"\n{title:36}{'cpu s':>9}{'share':>9}" + ("" if clock is steps else f"{'candidates':>13}"))
        order = sorted(clock.seconds, key=lambda name: -clock.seconds[name]) if clock is steps else clock.seconds
        for name in order:
            more = f"{rows[name]:13,}" if rows.get(name) else ""
            print(f"{name:36}{clock.seconds[name]:9.2f}{clock.seconds[name] / whole:9.1%}{more}")


class Exclusive:
    """Processor seconds of this process by name, without those of what is timed inside."""

    def __init__(self):
        self.seconds = defaultdict(float)
        self._inside = [0.0]

    @contextlib.contextmanager
    def __call__(self, name):
        begin = time.process_time()
        self._inside.append(0.0)
        yield
        spent = time.process_time() - begin
        self.seconds[name] += spent - self._inside.pop()
        self._inside[-1] += spent

    def timed(self, name, function):
        def call(*arguments, **more):
            with self(name):
                return function(*arguments, **more)

        return call


# -- chains -----------------------------------------------------------------------------------------------------


class Timed:
    """A sequence's people in one MultiDiGraph whose edges hold from one frame to another."""

    def __init__(self, scene, facts):
        self.frames, self.there = scene.keyframes.tolist(), people_there(scene, facts)
        self.silent = [silent_of(there) for there in self.there]
        self.graph = nx.MultiDiGraph()
        number = {track: person for person, track in enumerate(scene.tracks.tolist())}
        self.graph.add_nodes_from(number.values())
        columns = ("source", "target", "label", "first", "last", "certain")
        for table in (scene.interactions, scene.beside):
            for a, b, label, first, last, sure in zip(*(table[name].to_pylist() for name in columns), strict=True):
                if label in CODE:
                    self._add(number[a], number[b], CODE[label], first, last, sure)
        clusters = defaultdict(list)
        columns = ("cluster", "track", "first", "last", "certain")
        rows = zip(*(scene.memberships[name].to_pylist() for name in columns), strict=True)
        for cluster, track, first, last, sure in rows:
            clusters[cluster].append((number[track], first, last, sure))
        for members in clusters.values():
            for a, *span in members:
                for b, *other in members:
                    first, last = max(span[0], other[0]), min(span[1], other[1])
                    if a != b and first <= last:
                        self._add(a, b, CODE[SAME_GROUP], first, last, span[2] and other[2])

    def _add(self, a, b, relation, first, last, sure):
        self.graph.add_edge(a, b, relation=relation, first=first, last=last, sure=sure)

    def edges(self, person, keyframe):
        frame, there = self.frames[keyframe], self.there[keyframe]
        for _, other, edge in self.graph.out_edges(person, data=True):
            if edge["first"] <= frame <= edge["last"] and other in there:
                yield other, edge


class PerKeyframe:
    """A MultiDiGraph of the people of every keyframe."""

    def __init__(self, scene, facts):
        self.there = people_there(scene, facts)
        self.silent = [silent_of(there) for there in self.there]
        self.graphs = [nx.MultiDiGraph() for _ in self.there]
        count = len(self.there)
        for graph, there in zip(self.graphs, self.there, strict=True):
            graph.add_nodes_from(there)
        columns = (facts.source, facts.target, facts.relation, facts.certain)
        for source, target, relation, sure in zip(*(column.tolist() for column in columns), strict=True):
            graph = self.graphs[source % count]
            graph.add_edge(source // count, target // count, relation=relation, sure=sure)

    def edges(self, person, keyframe):
        for _, other, edge in self.graphs[keyframe].out_edges(person, data=True):
            yield other, edge


class Person(NamedTuple):
    """A person with a box at a keyframe; told: by kind of relation, whether the labels list all that the person has."""

    pose: str | None
    clear: bool
    ahead: bool
    told: list[bool]


def people_there(scene, facts):
    """Everybody with a box, per keyframe."""
    count = len(scene.keyframes)
    there = [{} for _ in range(count)]
    in_front = views.ahead(scene.geometry["x"], scene.geometry["w"], RULES.visible_share)
    for moment in scene.seen_moments.tolist():
        row, pose = scene.moment_rows[moment], scene.moment_poses[moment]
        seen = bool(scene.clear[row]), bool(in_front[row])
        person = Person(POSES[pose] if pose != NOBODY else None, *seen, facts.known[:, moment].tolist())
        there[moment % count][moment // count] = person
    return there


def silent_of(there):
    """By kind of relation, everybody of whom it is not told."""
    return [{one for one, person in there.items() if not person.told[kind]} for kind in range(max(KINDS) + 1)]


def steps_of(graph, person, keyframe):
    """By relation, the one other person who certainly has it while nobody else could, or why there is none."""
    partners = defaultdict(dict)
    for other, edge in graph.edges(person, keyframe):
        of_relation = partners[edge["relation"]]
        of_relation[other] = of_relation.get(other, False) or edge["sure"]
    there, found = graph.there[keyframe], {}
    for relation, others in partners.items():
        certain = [other for other, sure in others.items() if sure]
        if len(certain) == len(others) == 1 and not _others_could(graph, there, person, keyframe, relation, certain):
            found[relation] = certain[0]
        else:
            found[relation] = "ambiguous" if len(certain) > 1 else "unknown"
    return found


def _others_could(graph, there, person, keyframe, relation, besides=()):
    """Whether labels leave it open that a person has a relation with somebody else."""
    kind = KINDS[relation]
    if there[person].told[kind]:
        return bool(graph.silent[keyframe][kind] - {person, *besides})
    return len(there) > 1 + len(besides)


class Chain(NamedTuple):
    """A row of `two_hop` or `three_hop`, with numbers of people and relations in place of tracks and texts."""

    name: int
    keyframe: int
    people: tuple[int, ...]
    relations: tuple[int, ...]
    answer: str
    anchor: bool
    evidence: bool
    image: bool
    ahead: bool
    stops: tuple[str, ...]
    hop_stop: bool
    skips: tuple[str, ...]
    hop_skip: bool


def chains(graph, starts, images, hops):
    """Every chain of so many steps, with its proofs, from the people described: (name, person, keyframe, anchor)."""
    known, found = {}, []

    def steps(person, keyframe):
        place = person, keyframe
        if place not in known:
            known[place] = steps_of(graph, person, keyframe)
        return known[place]

    def read(people, relations, keyframe):
        """The pose at the end of a walk that goes on from these people, or why there is none."""
        there = graph.there[keyframe]
        for relation in relations:
            other = steps(people[-1], keyframe).get(relation)
            if other is None:
                return "unknown" if _others_could(graph, there, people[-1], keyframe, relation) else "empty"
            if isinstance(other, str):
                return other
            if other in people:
                return "empty"
            people = (*people, other)
        return there[people[-1]].pose or "unknown"

    def walk(name, anchor, keyframe, people, relations):
        for relation, other in steps(people[-1], keyframe).items():
            if isinstance(other, str) or other in people:
                continue
            longer, roads = (*people, other), (*relations, relation)
            if len(people) < hops:
                walk(name, anchor, keyframe, longer, roads)
            elif graph.there[keyframe][other].pose is not None:
                found.append(proven(name, anchor, keyframe, longer, roads))

    def proven(name, anchor, keyframe, people, relations):
        everybody = [graph.there[keyframe][person] for person in people]
        answer, ahead = everybody[-1].pose, everybody[-1].ahead
        stops = tuple(person.pose or "unknown" for person in everybody[:-1])
        skips = tuple(read(people[:hop], relations[hop:], keyframe) for hop in range(1, hops))
        proves = [not {"unknown", answer}.intersection(answers) for answers in (stops, skips)]
        evidence, image = all(person.clear for person in everybody), images[keyframe]
        seen = anchor, evidence, image, ahead
        return Chain(name, keyframe, people, relations, answer, *seen, stops, proves[0], skips, proves[1])

    for name, person, keyframe, anchor in starts:
        walk(name, anchor, keyframe, (person,), ())
    return found


def stored_chains(scene, table, hops):
    """The rows of a statement as chains."""
    times = ints(table, "t0")
    columns = {
        "people": [scene.people(scene.moments(ints(table, node), times)).tolist() for node in "abcd"[: hops + 1]],
        "relations": [coded(table[f"r{hop}"], RELATIONS).tolist() for hop in range(1, hops + 1)],
        "stops": [table[f"stop_{place}"].to_pylist() for place in range(hops)],
        "skips": [table[f"skip_{hop}"].to_pylist() for hop in range(1, hops)],
    }
    rows = {name: list(zip(*parts, strict=True)) for name, parts in columns.items()}
    rows["keyframe"] = np.searchsorted(scene.keyframes, times).tolist()
    rows |= {name: table[name].to_pylist() for name in Chain._fields if name not in rows}
    return [Chain(*row) for row in zip(*(rows[name] for name in Chain._fields), strict=True)]


HOPS = {"two_hop": 2, "three_hop": 3}
ARRANGEMENTS = {"timed edges": Timed, "a graph per keyframe": PerKeyframe}


def measure_chains(store):
    seconds, rows, edges = defaultdict(float), defaultdict(int), defaultdict(int)

    @contextlib.contextmanager
    def clock(*name):
        begin = time.process_time()
        yield
        seconds[name] += time.process_time() - begin

    lows = ensure_layer(store, RULES, 1)
    # As a worker of `generate` holds it: open, with statements parsed once.
    with Graph.open(store.graph_path, read_only=True, prepares=True) as graph:
        for sequence, low in lows.items():
            context = SearchContext(load_scene(store, sequence), RULES, low, graph)
            scene, facts, names = context.scene, context.facts, context.descriptions
            described = context.query("generators", "described")
            anchors = dict(zip(described["name"].to_pylist(), described["anchor"].to_pylist(), strict=True))
            moments = {name: int(names.moment[name]) for name in np.flatnonzero(names.general).tolist()}
            count, images = len(scene.keyframes), scene.has_image(scene.keyframes).tolist()
            starts = [(name, moment // count, moment % count, anchors[name]) for name, moment in moments.items()]
            graphs = {}
            for kind, arrangement in ARRANGEMENTS.items():
                with clock(kind, "built"):
                    graphs[kind] = arrangement(scene, facts)
            edges["timed edges"] += graphs["timed edges"].graph.number_of_edges()
            edges["a graph per keyframe"] += len(facts.source)
            with clock("layer"):
                made = dict(keyframe_tables(context)) | derived_tables(context)
            edges["keyframe layer"] += sum(len(table) for name, table in made.items() if name in KEYFRAME_RELS)
            for template, hops in HOPS.items():
                with clock("here", template):
                    table = context.query("generators", template)
                here = sorted(stored_chains(scene, table, hops))
                rows[template] += len(here)
                for kind, there in graphs.items():
                    with clock(kind, template):
                        found = chains(there, starts, images, hops)
                    assert sorted(found) == here, f"{sequence}: networkx finds other chains"
        rows["starts"] += len(starts)
    print(f"\n{rows['starts']:,} people described")
    print(f"{'cpu s':12}{'chains':>8}{'query':>8}{'+ layer':>9}", end="")
    print(*(f"{kind:>22}{'+ built':>9}{'ratios':>12}" for kind in ARRANGEMENTS))
    for template in HOPS:
        own = seconds["here", template], seconds["here", template] + seconds["layer",]
        line = f"{template:12}{rows[template]:8,}{own[0]:8.2f}{own[1]:9.2f}"
        for kind in ARRANGEMENTS:
            other = seconds[kind, template], seconds[kind, template] + seconds[kind, "built"]
            line += f"{other[0]:22.2f}{other[1]:9.2f}{other[0] / own[0]:7.1f}{other[1] / own[1]:6.1f}"
        print(line)
    print("edges: " + ", ".join(f"{kind} {number:,}" for kind, number in edges.items()))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--scale", type=float, default=0.25)
    parser.add_argument("--only", choices=("generate", "steps", "networkx"))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        store = Store(options.store) if options.store else sampled(folder, options.scale, options.workers)
        if options.only in (None, "generate"):
            measure_generate(store, options.workers, folder)
        if options.only != "generate":
            whole = part_of(store, sorted(store.manifest().sequences), folder / "whole")
        if options.only in (None, "steps"):
            measure_steps(whole)
        if options.only in (None, "networkx"):
            measure_chains(whole)


def sampled(folder, scale, workers):
    """A loaded store of a synthetic root."""
    sample(folder / "root", scale, workers)
    store = Store(folder / "store")
    load(find_root(folder / "root"), store, LoadRules(), workers)
    return store


if __name__ == "__main__":
    main()
