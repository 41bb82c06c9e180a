"""The search for a template's candidates in a scene's graph, and their judgement by rule."""

from __future__ import annotations

from dataclasses import replace

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
from jrdb_avr.engine.generate.chains import chain_proofs, in_blocks
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.fork_join import find_forks, find_joins, fork_proofs
from jrdb_avr.engine.generate.presence import find_presence
from jrdb_avr.engine.generate.relations import RELATIONS
from jrdb_avr.engine.generate.scene import NOBODY, coded, flags, ints
from jrdb_avr.engine.generate.time_shift import held_person_proofs
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.relations import SAME_GROUP
from jrdb_avr.schema.templates import Template


def find_candidates(context: SearchContext, template: Template) -> Candidates:
    """Search a scene's graph for a template's candidates and judge them."""
    if template.spec.read == "presence":
        return find_presence(context, template)
    joins = find_joins(context) if template.joins else None
    found = context.query("generators", template.query) if joins is None else find_forks(context, joins)
    candidates = list_candidates(context, template, found)
    if not len(candidates):
        return candidates
    holds = {rule: flags(found, rule) for rule in ("anchor", "evidence", "image")}
    holds |= {"view.ahead": ~flags(found, "ahead"), "stated": ~_stated(context, candidates)}
    perturbed: list[PerturbationResult] = []
    if template.edges:
        # Proofs about hops take long: candidates that another rule refuses are left out.
        rows = np.flatnonzero(first_refusing(holds, len(candidates)) == PASSED)
        paths = candidates.take(rows)
        if not template.single_view:
            holds["view.single"] = np.ones(len(candidates), dtype=bool)
            holds["view.single"][rows] = _needs_turning(context, paths)
        proofs = in_blocks(
            context, paths, lambda some: fork_proofs(context, joins, some) if joins else chain_proofs(context, some)
        )
        perturbed += [result.at(rows, len(candidates)) for result in proofs]
    if template.time_proof == "times":
        perturbed += held_person_proofs(context, candidates)
    rule = first_refusing(holds | proven_rules(perturbed, context.rules), len(candidates))
    return replace(candidates, rule=rule, perturbed=tuple(perturbed))


def list_candidates(context: SearchContext, template: Template, found: pa.Table) -> Candidates:
    """The rows of a generator's query as candidates, which no rule has judged yet."""
    scene, columns = context.scene, set(found.column_names)
    people = {node: ints(found, "at0" if node == "a" else node) for node in template.people}
    # Of the target, whose moment at t0 is named by its node.
    times = {"t0": scene.frames(people[template.target]), template.described: scene.frames(people[template.target])}
    times |= {f"t{column[2:]}": scene.frames(ints(found, column)) for column in ("at1", "at2") if column in columns}
    times |= {name: ints(found, name) for name in ("leaves", "returns") if name in columns}
    for suffix in [suffix for suffix in ("", "2") if f"segment{suffix}" in columns]:
        rows = ints(found, f"segment{suffix}")
        times |= {name + suffix: ints(scene.segments, name)[rows] for name in ("first", "last", "start", "end")}
    none = np.full(len(found), NOBODY)
    segment, segment2, window = (
        ints(found, name) if name in columns else none for name in ("segment", "segment2", "company")
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
