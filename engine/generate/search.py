"""The search for a template's candidates in a scene's graph, and their judgement by rule."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.candidates import (
    PASSED,
    UNKNOWN,
    Candidates,
    Codes,
    Counted,
    Perturbed,
    ask,
    codes,
    first_refusing,
    ints,
    proven_rules,
)
from jrdb_avr.engine.generate.chains import Paths, hop_proofs, in_blocks, paths_in_graph, program_proofs
from jrdb_avr.engine.generate.descriptions import Descriptions
from jrdb_avr.engine.generate.encounters import find_company
from jrdb_avr.engine.generate.fork_join import Joins, find_joins
from jrdb_avr.engine.generate.forks import find_forks, fork_proofs
from jrdb_avr.engine.generate.presence import find_presence
from jrdb_avr.engine.generate.relations import RELATIONS, STATED_POSES, Facts, find_steps
from jrdb_avr.engine.generate.scene import NOBODY, Ints, Scene, absence_tables, coded, flags
from jrdb_avr.engine.generate.search_graph import scene_graph
from jrdb_avr.engine.generate.time_shift import asked_proofs
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.arrays import Bools, Floats
from jrdb_avr.schema.relations import SAME_GROUP
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import Template

TIMES = ("t0", "t1", "t2")
EDGES = ("first", "last", "start", "end")


def search_graph(scene: Scene, facts: Facts, descriptions: Descriptions, rules: Rules) -> Graph:
    """A scene's graph with everything that the generators and the proofs walk along; the caller closes it."""
    tables = descriptions.tables(scene.keyframes) | find_steps(scene, facts).tables()
    tables |= absence_tables(scene, rules) | find_company(scene, facts, rules).tables(scene)
    return scene_graph(scene, tables, rules)


def find_candidates(
    scene: Scene, facts: Facts, descriptions: Descriptions, graph: Graph, template: Template, rules: Rules
) -> Candidates:
    """Search a scene's graph for a template and judge what is found; `facts` are the scene's relations."""
    if template.spec.read == "presence":
        return find_presence(scene, graph, template, rules)
    joins = find_joins(scene, facts, descriptions.conditions, rules) if template.joins else None
    found = ask(graph, "generators", template.query, rules) if joins is None else find_forks(graph, joins, rules)
    count = len(found)
    people = {node: ints(found, "at0" if node == "a" else node) for node in template.people}
    relations = {name: coded(found[name], RELATIONS) for name in template.relations}
    # Of the target, whose moment at t0 is named by its node.
    moments = {time: ints(found, f"at{time[1:]}") for time in TIMES[1:] if f"at{time[1:]}" in found.column_names}
    moments = {"t0": people[template.target], template.described: people[template.target], **moments}
    times = {name: scene.frames(moment) for name, moment in moments.items()}
    segment, segment2 = (_column(found, name) for name in ("segment", "segment2"))
    for suffix, rows in (("", segment), ("2", segment2)):
        for name in EDGES:
            if f"segment{suffix}" in found.column_names:
                times[name + suffix] = scene.segments[name].to_numpy().astype(np.int64)[rows]
    for name in ("leaves", "returns"):
        if name in found.column_names:
            times[name] = ints(found, name)
    answer = codes(found["answer"]) if template.answer is None else np.full(count, NOBODY, dtype=np.int8)
    holds = _alone(found)
    if template.pose_answer and count:
        holds["stated"] = ~_stated(descriptions, ints(found, "name"), relations, answer)
    if template.counts:
        # Whoever is said to be in a group of six is with five others, at that moment at least.
        group = relations["r1"] == RELATIONS.index(SAME_GROUP)
        holds["stated"] = ~(group & descriptions.stated_sizes[ints(found, "name")])
    perturbed: tuple[Perturbed, ...] = ()
    if template.edges and count:
        open_rows = np.flatnonzero(first_refusing(holds, count) == PASSED)
        paths = Paths(
            template,
            descriptions.texts[1][ints(found, "name")],
            people,
            relations,
            times,
            segment,
            answer,
        ).take(open_rows)
        if not template.single_view:
            holds["view.single"] = _needs_turning(scene, paths, open_rows, count, rules)
        proofs = in_blocks(paths, lambda some: _path_proofs(scene, graph, joins, some, rules))
        perturbed = tuple(_widened(proof, open_rows, count) for proof in proofs)
    if template.time_proof == "times" and count:
        perturbed += asked_proofs(scene, graph, template, rules, moments, answer)
    holds |= proven_rules(perturbed)
    rule = first_refusing(holds, count)
    return Candidates(
        template=template,
        name=ints(found, "name"),
        people=people,
        relations=relations,
        segment=segment,
        segment2=segment2,
        frames=times,
        answer=answer,
        value=_values(found),
        rule=rule,
        perturbed=perturbed,
        counted=_counted(graph, ints(found, "company"), rules) if template.counts else None,
    )


def _path_proofs(scene: Scene, graph: Graph, joins: Joins | None, paths: Paths, rules: Rules) -> tuple[Perturbed, ...]:
    """Everything that perturbed programs read of candidates with hops."""
    with paths_in_graph(graph, paths):
        if joins is not None:
            return fork_proofs(scene, graph, joins, paths, rules)
        proofs = hop_proofs(scene, graph, paths, rules)
        if paths.template.time_proof == "program":
            proofs += program_proofs(scene, graph, paths, rules)
        return proofs


def _column(found: pa.Table, name: str) -> Ints:
    """A column of whole numbers; NOBODY where the query has none of this name."""
    return ints(found, name) if name in found.column_names else np.full(len(found), NOBODY)


def _counted(graph: Graph, number: Ints, rules: Rules) -> Counted:
    met = ask(graph, "generators", "gap_count_people", rules)
    return Counted(number, *(ints(met, name) for name in ("company", "person", "met", "seen")))


def _values(found: pa.Table) -> Floats:
    """Seconds or people, where a number is asked for; else NaN."""
    if "value" not in found.column_names:
        return np.full(len(found), np.nan)
    return np.asarray(found["value"].to_numpy(), dtype=np.float64)


def _alone(found: pa.Table) -> dict[str, Bools]:
    """The rules that the generator itself tells of."""
    return {
        "anchor": flags(found, "anchor"),
        "evidence": flags(found, "evidence"),
        "image": flags(found, "image"),
        "view.ahead": ~flags(found, "ahead"),
    }


def _stated(descriptions: Descriptions, names: Ints, relations: Mapping[str, Ints], answer: Codes) -> Bools:
    """Where the question's own words name the pose that is asked for."""
    poses = answer.astype(np.int64)
    stated = descriptions.stated_poses[names, poses]
    for codes_of in relations.values():
        stated = stated | STATED_POSES[codes_of, poses]
    return np.asarray(stated, dtype=bool)


def _needs_turning(scene: Scene, paths: Paths, rows: Ints, count: int, rules: Rules) -> Bools:
    """Where no one view shows everybody at t0 and the target when it is read; true of those not looked at."""
    needed = [scene.moment_rows[moments] for moments in paths.people.values()]
    target = scene.persons(paths.people[paths.template.target])
    needed += [scene.box_rows(target, paths.frames[name]) for name in paths.template.decisive if name != "t0"]
    boxes = np.stack(needed, axis=1) if len(rows) else np.zeros((0, 1), np.int64)
    turns = np.ones(count, dtype=bool)
    for row, lines in zip(rows.tolist(), boxes, strict=True):
        x, w = scene.geometry["x"][lines], scene.geometry["w"][lines]
        turns[row] = not views.single_view(x, w, rules.visible_share)
    return turns


def _widened(proof: Perturbed, rows: Ints, count: int) -> Perturbed:
    """The same for all candidates; those that an earlier rule refuses are not looked at, and stay unknown."""
    outcome, answer = np.full(count, UNKNOWN, dtype=np.int8), np.full(count, NOBODY, dtype=np.int8)
    outcome[rows], answer[rows] = proof.outcome, proof.answer
    return Perturbed(proof.kind, proof.variant, outcome, answer, proof.either)
