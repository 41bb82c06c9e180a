"""The search for a template's candidates in the stored graph, and their judgement by rule."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.candidates import (
    PASSED,
    Candidates,
    PerturbationResult,
    choice_codes,
    first_refusing,
    proven_rules,
    stated_poses,
)
from jrdb_avr.engine.generate.chains import path_rows, program_proofs, start_proofs, text_proofs
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.fork_join import fork_proofs
from jrdb_avr.engine.generate.presence import find_presence
from jrdb_avr.engine.generate.relations import RELATIONS
from jrdb_avr.engine.generate.scene import NOBODY, coded, flags, ints, masked
from jrdb_avr.engine.generate.time_shift import held_person_proofs
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.relations import SAME_GROUP
from jrdb_avr.schema.templates import Template


def find_candidates(context: SearchContext, template: Template) -> Candidates:
    """Search a sequence's part of the graph for a template's candidates and judge them."""
    if template.spec.read == "presence":
        return find_presence(context, template)
    found = context.query("generators", template.query)
    candidates = list_candidates(context, template, found)
    if not len(candidates):
        return candidates
    holds = {rule: flags(found, rule) for rule in ("anchor", "evidence", "image")}
    holds |= {"view.ahead": ~flags(found, "ahead"), "stated": ~_stated(context, candidates)}
    perturbed: list[PerturbationResult] = []
    if template.edges:
        # Proofs about hops take long: candidates that another rule refuses are left out.
        rows = np.flatnonzero(first_refusing(holds, len(candidates)) == PASSED)
        paths, hops = candidates.take(rows), found.take(rows)
        if not template.single_view:
            holds["view.single"] = np.ones(len(candidates), dtype=bool)
            holds["view.single"][rows] = _needs_turning(context, paths)
        if template.time_proof == "times":
            hops = context.query("necessity", f"{template.query}_hops")
            hops = hops.take(masked(path_rows(paths, hops)))
        for name in ("hop.stop", "hop.skip"):
            if (column := name.replace(".", "_")) in hops.column_names:
                holds[name] = np.ones(len(candidates), dtype=bool)
                holds[name][rows] = flags(hops, column)
        perturbed += [result.at(rows, len(candidates)) for result in _hop_proofs(context, paths, hops)]
    if template.time_proof == "times":
        perturbed += held_person_proofs(context, candidates)
    rule = first_refusing(proven_rules(perturbed, context.rules) | holds, len(candidates))
    return replace(candidates, rule=rule, perturbed=tuple(perturbed))


def _hop_proofs(context: SearchContext, paths: Candidates, found: pa.Table) -> list[PerturbationResult]:
    """The proofs of paths that no other rule refuses, from the rows of their statement."""
    if paths.template.spec.read == "start_view":
        return start_proofs(context, found, paths)
    stops = text_proofs("hop.stop", found, paths)
    if paths.template.joins:
        return [*stops, *fork_proofs(context, paths)]
    later = program_proofs(context, paths) if paths.template.time_proof == "program" else []
    return [*stops, *text_proofs("hop.skip", found, paths), *later]


_TIMES: Final = ("t1", "t2", "leaves", "returns")


def list_candidates(context: SearchContext, template: Template, found: pa.Table) -> Candidates:
    """The rows of a generator's query as candidates, which no rule has judged yet."""
    scene, columns = context.scene, set(found.column_names)
    described = ints(found, template.described)
    people = {node: scene.moments(ints(found, node), described) for node in template.people}
    times = {"t0": described} | {name: ints(found, name) for name in _TIMES if name in columns}
    for suffix in [suffix for suffix in ("", "2") if f"segment{suffix}" in columns]:
        rows = ints(found, f"segment{suffix}")
        times |= {name + suffix: ints(scene.segments, name)[rows] for name in ("first", "last", "start", "end")}
    none = np.full(len(found), NOBODY)
    segment, segment2, window = (
        ints(found, name) if name in columns else none for name in ("segment", "segment2", "encounter")
    )
    return Candidates(
        template=template,
        name=ints(found, "name"),
        people=people,
        relations={name: coded(found[name], RELATIONS) for name in template.relations},
        segments=(segment, segment2),
        frames=times,
        answer=choice_codes(found["answer"]) if template.answer is None else none.astype(np.int8),
        value=found["value"].to_numpy() if "value" in columns else np.full(len(found), np.nan),
        window=window,
        rule=np.full(len(found), PASSED, dtype=np.int8),
    )


def _stated(context: SearchContext, candidates: Candidates) -> Bools:
    """Where the question's own words name the answer."""
    template = candidates.template
    if template.counts:
        # Whoever is described as in a group of six is with five others, at that moment at least.
        group = candidates.relations["r1"] == RELATIONS.index(SAME_GROUP)
        return np.asarray(group & context.descriptions.stated_sizes[candidates.name])
    if not template.pose_answer:
        return np.zeros(len(candidates), dtype=bool)
    return stated_poses(context, candidates)[np.arange(len(candidates)), candidates.answer]


def _needs_turning(context: SearchContext, paths: Candidates) -> Bools:
    """Where no one view shows everybody at t0 and the target when it is read."""
    scene, template = context.scene, paths.template
    target = scene.people(paths.people[template.target])
    needed = [scene.moment_rows[moments] for moments in paths.people.values()]
    needed += [scene.box_rows(target, paths.frames[name]) for name in template.decisive if name != "t0"]
    x, w, share = scene.geometry["x"], scene.geometry["w"], context.rules.visible_share
    return np.array([not views.single_view(x[rows], w[rows], share) for rows in np.stack(needed, axis=1)], dtype=bool)
