"""Generation in one sequence: from its interval tables to its proven candidates, near-duplicates removed.

A pure function of the sequence's tables and the rules, so sequences can be shared among processes or machines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from jrdb_avr.engine.generate.candidates import (
    BLOCK,
    OUTCOMES,
    PASSED,
    RULES,
    Candidates,
    candidate_table,
    frame_lists,
    with_selection_columns,
)
from jrdb_avr.engine.generate.descriptions import Descriptions, describe_people
from jrdb_avr.engine.generate.distractors import Choices, make_choices
from jrdb_avr.engine.generate.proofs import make_record, needed_boxes, proof
from jrdb_avr.engine.generate.relations import Steps, find_facts, find_steps
from jrdb_avr.engine.generate.scene import Ints, Scene, load_scene
from jrdb_avr.engine.generate.search import find_candidates, search_graph
from jrdb_avr.engine.generate.selection import near_duplicates
from jrdb_avr.engine.rederive import Annotations, rederive
from jrdb_avr.queries.store import Store
from jrdb_avr.queries.workers import without_collector
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.rules import Rules, frames
from jrdb_avr.schema.tables import CANDIDATES, QUESTIONS
from jrdb_avr.schema.templates import FORMS, Template

EXAMPLES: Final = 100
"""Example rows kept per sequence, template and rule."""


@dataclass(frozen=True)
class Job:
    """A sequence to search. `candidates` is where to write every proven candidate, or None."""

    store: Path
    sequence: str
    rules: Rules
    candidates: Path | None = None


@dataclass(frozen=True)
class Found:
    """What a sequence gives: kept candidates with their records, refusals, and templates whose layers are missing.

    counts: (template, what) -> number, where what is "candidates", "proven" or a rule that refuses.
    faults: one line per candidate on which the second path disagrees.
    """

    sequence: str
    kept: pa.Table | None
    rejected: pa.Table
    counts: dict[tuple[str, str], int]
    lacking: dict[str, tuple[str, ...]]
    faults: tuple[str, ...]


@without_collector()
def search_sequence(job: Job) -> Found:
    """Find, prove and thin out the candidates of one sequence."""
    store = Store(job.store)
    scene = load_scene(store, job.sequence)
    facts = find_facts(scene)
    descriptions = describe_people(scene, facts, job.rules)
    annotations = Annotations.read(store, job.sequence, job.rules)
    search = _Search(job, scene, find_steps(scene, facts), descriptions, annotations)
    with search_graph(scene, facts, descriptions, job.rules) as graph:
        for name, forms in FORMS.items():
            missing = [tuple(layer for layer in form.layers if layer not in scene.layers) for form in forms]
            if least := min(missing, key=len):
                search.lacking[name] = least
                continue
            searched = [form for form, layers in zip(forms, missing, strict=True) if not layers]
            search.judge([find_candidates(scene, facts, descriptions, graph, form, job.rules) for form in searched])
    return search.result()


class _Search:
    """Collects what the templates give, one after the other."""

    def __init__(
        self, job: Job, scene: Scene, steps: Steps, descriptions: Descriptions, annotations: Annotations
    ) -> None:
        self.job = job
        self.scene = scene
        self.steps = steps
        self.descriptions = descriptions
        self.annotations = annotations
        self.lacking: dict[str, tuple[str, ...]] = {}
        self.counts: dict[tuple[str, str], int] = {}
        self.kept: list[pa.Table] = []
        self.examples: list[dict[str, Any]] = []
        self.faults: list[str] = []
        self.writer = pq.ParquetWriter(job.candidates, CANDIDATES) if job.candidates is not None else None

    def judge(self, forms: Sequence[Candidates]) -> None:
        """Judge the candidates of a template, whose forms compete with each other."""
        name = forms[0].template.name
        slims = []
        for form, candidates in enumerate(forms):
            self._count(name, "candidates", len(candidates))
            for rule, count in candidates.refusals().items():
                self._count(name, rule, count)
                self._give_examples(candidates, rule, EXAMPLES // len(forms))
            proven = np.flatnonzero(candidates.rule == PASSED)
            self._count(name, "proven", len(proven))
            blocks = [self._slim(candidates, proven[i : i + BLOCK]) for i in range(0, len(proven), BLOCK)]
            slims += [
                block.append_column("form", pa.repeat(pa.scalar(form, pa.int64()), len(block))) for block in blocks
            ]
        if not slims:
            return
        slim = pa.concat_tables(slims).combine_chunks()
        kept, dropped = near_duplicates(slim, self.job.rules)
        for rule, count in dropped.items():
            self._count(name, rule, count)
        self._give_dropped_examples(forms, slim, kept)
        for form, candidates in enumerate(forms):
            rows = np.sort(kept.filter(pc.equal(kept["form"], form))["row"].to_numpy())
            if len(rows):
                table = candidate_table(self.scene, self.descriptions, candidates, rows)
                self.kept.append(self._recorded(with_selection_columns(table, candidates), candidates))

    def _count(self, template: str, what: str, count: int) -> None:
        self.counts[template, what] = self.counts.get((template, what), 0) + count

    def _slim(self, candidates: Candidates, rows: Ints) -> pa.Table:
        """Proven candidates without their plans, which are only hashed (and written out where that is asked for)."""
        table = candidate_table(self.scene, self.descriptions, candidates, rows)
        if self.writer is not None:
            self.writer.write_table(table.select(CANDIDATES.names).cast(CANDIDATES))
        empty = pa.repeat(pa.scalar("", pa.string()), len(rows))
        table = table.set_column(table.schema.get_field_index("plan"), "plan", empty)
        return table.append_column("read_frames", frame_lists(candidates, candidates.template.read, rows))

    def _recorded(self, table: pa.Table, candidates: Candidates) -> pa.Table:
        """Add the private columns of kept candidates; drop, and report, those that the second path does not confirm."""
        rows: list[dict[str, Any]] = []
        stays = []
        for line in table.select(["row", "target_track", "plan", "answer", "key"]).to_pylist():
            fault = self._disagreement(candidates, line)
            agrees = fault is None
            choices: Choices | None = None
            if fault is not None:
                self._refuse(candidates, "rederive", line, fault)
                self.faults.append(f"{self.scene.sequence} {line['plan']}: {fault}")
            elif candidates.template.answer is None:
                choices = make_choices(
                    self.scene, self.steps, self.descriptions, candidates, line["row"], line["key"], self.job.rules
                )
                if choices is None:
                    self._refuse(candidates, "choices", line, "fewer than three wrong answers")
            stays.append(agrees and (choices is not None or candidates.template.answer is not None))
            if stays[-1]:
                rows.append(self._private(candidates, line, choices))
        return _joined_columns(table.filter(pa.array(stays)).drop_columns(["row"]), rows)

    def _disagreement(self, candidates: Candidates, line: dict[str, Any]) -> str | None:
        """What the second path, from the annotation tables, finds otherwise; None where it confirms the candidate."""
        template = candidates.template.name
        second = rederive(self.annotations, parse_plan(line["plan"]), template, self.job.rules)
        track = line["target_track"]
        needed = needed_boxes(self.scene, candidates, line["row"])
        boxes = {(box.node, box.track, box.frame, box.decisive) for box in needed}
        if second.outcome != "defined" or second.answer != line["answer"]:
            return f"answer {line['answer']}, rederived {second.answer or second.outcome}"
        if second.target != track:
            return f"target {track}, rederived {second.target}"
        if second.faults:
            return second.faults[0]
        if {(box.node, box.track, box.frame, box.decisive) for box in second.needed} != boxes:
            return "other boxes are needed"
        return None

    def _private(self, candidates: Candidates, line: dict[str, Any], choices: Choices | None) -> dict[str, Any]:
        record = make_record(self.scene, self.descriptions, candidates, line["row"], line["answer"], self.job.rules)
        proofs = [*record.proofs, proof("rederive", "annotations", True, "same", line["answer"])]
        return {
            "proofs": _json(proofs),
            "needed": _json([box.plain() for box in record.needed]),
            "bindings": _json(record.bindings),
            "hops": record.hops,
            "time_gap_s": record.time_gap_s,
            "separation_deg": record.separation_deg,
            "people_in_scene": record.people_in_scene,
            "choices": list(choices.texts) if choices else [],
            "true_choice": choices.true if choices else 0,
            "distractors": _json(list(choices.perturbations) if choices else []),
        }

    # -- refusals ---------------------------------------------------------------------------------------------

    def _refuse(self, candidates: Candidates, rule: str, line: dict[str, Any], detail: str) -> None:
        name = candidates.template.name
        self._count(name, rule, 1)
        if self.counts[name, rule] <= EXAMPLES:
            self._example(candidates.template, rule, line["target_track"], line["plan"], detail)

    def _give_examples(self, candidates: Candidates, rule: str, most: int) -> None:
        """The first refused candidates by a hash of who and when."""
        refused = np.flatnonzero(candidates.rule == RULES.index(rule))
        columns = [self.descriptions.moment[candidates.name[refused]]]
        columns += [candidates.frames[name][refused] for name in sorted(candidates.frames)]
        columns += [codes[refused] for _, codes in sorted(candidates.relations.items())]
        if candidates.template.time_proof == "construction":
            columns += [candidates.segment[refused], candidates.segment2[refused]]
        hashes = mixed(columns)
        if len(hashes) > most:
            near = np.flatnonzero(hashes <= np.partition(hashes, most)[most])
            refused, hashes = refused[near], hashes[near]
        rows = refused[np.lexsort((refused, hashes))[:most]]
        table = candidate_table(self.scene, self.descriptions, candidates, rows, keyed=False)
        for line in table.select(["row", "target_track", "plan"]).to_pylist():
            detail = self._detail(candidates, rule, line["row"])
            self._example(candidates.template, rule, line["target_track"], line["plan"], detail)

    def _detail(self, candidates: Candidates, rule: str, row: int) -> str:
        match rule:
            case "anchor":
                left = self.descriptions.left[candidates.name[row]]
                return "could match when one condition is dropped: " + ", ".join(str(n) for n in left if n)
            case "time.shift" | "hop.stop" | "hop.skip":
                found = [proof for proof in candidates.perturbed if proof.kind == rule]
                return ", ".join(f"{proof.variant}: {OUTCOMES[proof.outcome[row]]}" for proof in found)
            case "time.drop":
                return "every other keyframe with an answer gives the same"
            case "stated":
                return "the question's own words name the answer"
            case "view.single":
                return "one view shows everybody needed"
            case "view.ahead":
                return "all decisive boxes are seen straight ahead"
            case "evidence":
                return "a needed box is no clear view"
            case _:
                return "a needed frame has no image"

    def _give_dropped_examples(self, forms: Sequence[Candidates], slim: pa.Table, kept: pa.Table) -> None:
        """Examples of what near-duplicates and the cap dropped, first by key."""
        row, stays = (table["row"].to_numpy() * len(forms) + table["form"].to_numpy() for table in (slim, kept))
        dropped = slim.filter(pa.array(~np.isin(row, stays)))
        near = _near_any(dropped, kept, frames(self.job.rules.near_duplicate_s))
        for rule, of_rule in (("near_duplicate", near), ("max_per_person", ~near)):
            refused = dropped.filter(pa.array(of_rule))
            first = refused.take(pc.select_k_unstable(refused, EXAMPLES, [("key", "ascending")]))
            for form, candidates in enumerate(forms):
                rows = first.filter(pc.equal(first["form"], form))["row"].to_numpy()
                table = candidate_table(self.scene, self.descriptions, candidates, rows, keyed=False)
                for line in table.select(["target_track", "plan"]).to_pylist():
                    self._example(candidates.template, rule, line["target_track"], line["plan"], "")

    def _example(self, template: Template, rule: str, track: int, plan: str, detail: str) -> None:
        self.examples.append(
            {
                "kind": "example",
                "sequence": self.scene.sequence,
                "family": template.family,
                "template": template.name,
                "rule": rule,
                "candidates": 1,
                "target_track": track,
                "plan": plan,
                "detail": detail or None,
            }
        )

    def result(self) -> Found:
        if self.writer is not None:
            self.writer.close()
        return Found(
            sequence=self.scene.sequence,
            kept=pa.concat_tables(self.kept) if self.kept else None,
            rejected=pa.Table.from_pylist(self.examples, schema=QUESTIONS["rejected"]),
            counts=self.counts,
            lacking=self.lacking,
            faults=tuple(self.faults),
        )


def _near_any(rows: pa.Table, kept: pa.Table, limit: int) -> Bools:
    """Whether each row reads the answer of the same person at nearly the same frames as a kept one."""
    if not len(rows):
        return np.zeros(0, dtype=bool)
    read, read_kept = (
        pc.list_flatten(table["read_frames"]).to_numpy().reshape(len(table), -1) for table in (rows, kept)
    )
    track = rows["target_track"].to_numpy()
    order = np.argsort(track, kind="stable")
    owners = track[order]
    near = np.zeros(len(rows), dtype=bool)
    for owner, frames_kept in zip(kept["target_track"].to_pylist(), read_kept, strict=True):
        low, high = np.searchsorted(owners, [owner, owner + 1])
        rivals = order[low:high]
        near[rivals[np.all(np.abs(read[rivals] - frames_kept) <= limit, axis=1)]] = True
    return near


def mixed(columns: list[Ints]) -> npt.NDArray[np.uint64]:
    """A well-mixed number per row of the columns, the same on every machine."""
    state = np.full(len(columns[0]), 0x9E3779B97F4A7C15, dtype=np.uint64)
    for column in columns:
        state = state ^ column.astype(np.uint64)
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
            state = (state ^ (state >> np.uint64(shift))) * np.uint64(factor)
        state = state ^ (state >> np.uint64(31))
    return state


_PRIVATE: Final = pa.schema(
    [
        ("proofs", pa.string()),
        ("needed", pa.string()),
        ("bindings", pa.string()),
        ("hops", pa.int32()),
        ("time_gap_s", pa.float64()),
        ("separation_deg", pa.float64()),
        ("people_in_scene", pa.int32()),
        ("choices", pa.list_(pa.string())),
        ("true_choice", pa.int32()),
        ("distractors", pa.string()),
    ]
)


def _joined_columns(table: pa.Table, rows: list[dict[str, Any]]) -> pa.Table:
    private = pa.Table.from_pylist(rows, schema=_PRIVATE)
    for name in _PRIVATE.names:
        table = table.append_column(_PRIVATE.field(name), private[name])
    return table


def _json(value: object) -> str:
    return msgspec.json.encode(value).decode()
