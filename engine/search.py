"""The search for a template's candidates in a scene's graph, and their judgement by rule."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from jrdb_avr.queries.handle import Graph
from jrdb_avr.schema.rules import Rules

from . import views
from .asked import asked_proofs
from .candidates import (
    PASSED,
    SAME,
    UNKNOWN,
    Candidates,
    Codes,
    Perturbed,
    ask,
    codes,
    first_refusing,
    flags,
    ints,
)
from .descriptions import Descriptions
from .paths import Paths, hop_proofs, program_proofs
from .relations import RELATIONS, STATED_POSES, Facts
from .scene import NOBODY, Bools, Ints, Scene, coded
from .templates import Template

TIMES = ("t0", "t1", "t2")
EDGES = ("first", "last", "start", "end")


def find_candidates(
    scene: Scene, facts: Facts, descriptions: Descriptions, graph: Graph, template: Template, rules: Rules
) -> Candidates:
    """Search a scene's graph for a template and judge what is found; `facts` are the scene's relations."""
    found = ask(graph, "generators", template.name, rules)
    count = len(found)
    people = {node: ints(found, "at0" if node == "a" else node) for node in template.people}
    relations = {name: coded(found[name], RELATIONS) for name in template.relations}
    # Of the target, whose moment at t0 is named by its node.
    moments = {time: ints(found, f"at{time[1:]}") for time in TIMES[1:] if f"at{time[1:]}" in found.column_names}
    moments = {"t0": people[template.target], **moments}
    times = {name: scene.frames(moment) for name, moment in moments.items()}
    segment = np.full(count, NOBODY)
    if "segment" in found.column_names:
        segment = ints(found, "segment")
        for name in EDGES:
            times[name] = scene.segments[name].to_numpy().astype(np.int64)[segment]
    answer = codes(found["answer"]) if template.answer is None else np.full(count, NOBODY, dtype=np.int8)
    holds = _alone(found)
    if template.pose_answer and count:
        holds["stated"] = ~_stated(descriptions, ints(found, "name"), relations, answer)
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
        proofs = hop_proofs(scene, graph, paths, rules)
        if template.time_proof == "program":
            proofs += program_proofs(scene, graph, paths, rules)
        perturbed = tuple(_widened(proof, open_rows, count) for proof in proofs)
    if template.time_proof == "asked" and count:
        perturbed += asked_proofs(scene, graph, template, rules, moments, answer)
    holds |= _proven(perturbed)
    rule = first_refusing(holds, count)
    return Candidates(template, ints(found, "name"), people, relations, segment, times, answer, rule, perturbed)


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


def _proven(perturbed: tuple[Perturbed, ...]) -> dict[str, Bools]:
    """Per rule, where its perturbed programs prove what they must."""
    holds: dict[str, Bools] = {}
    for proof in perturbed:
        if proof.kind == "time.shift":
            # One of the two is enough.
            holds[proof.kind] = holds.get(proof.kind, np.zeros(len(proof.outcome), dtype=bool)) | proof.proves()
        elif proof.kind == "time.drop":
            holds[proof.kind] = proof.outcome != SAME
        else:
            fails = ~np.isin(proof.outcome, (SAME, UNKNOWN))
            holds[proof.kind] = holds.get(proof.kind, np.ones(len(proof.outcome), dtype=bool)) & fails
    return holds


def _widened(proof: Perturbed, rows: Ints, count: int) -> Perturbed:
    """The same for all candidates; those that an earlier rule refuses are not looked at, and stay unknown."""
    outcome, answer = np.full(count, UNKNOWN, dtype=np.int8), np.full(count, NOBODY, dtype=np.int8)
    outcome[rows], answer[rows] = proof.outcome, proof.answer
    return Perturbed(proof.kind, proof.variant, outcome, answer)
