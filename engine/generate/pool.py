"""The pool of a template in one sequence: proposals are proven in the order of a hash until nothing else can be used.

Whatever reads the same as a proposal that stays is dropped without a proof.
"""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.cypher_facts import CypherFacts
from jrdb_avr.engine.generate.facts import Key
from jrdb_avr.engine.generate.held_out import Extent
from jrdb_avr.engine.generate.near_duplicates import near_frames
from jrdb_avr.engine.generate.perturb import (
    Answer,
    MissingFactsError,
    Program,
    iterate_proofs,
    make_program,
    parse_answer,
)
from jrdb_avr.engine.generate.proofs import failing
from jrdb_avr.engine.generate.propose import Proposal, Search, make_proposal, propose, propose_presence
from jrdb_avr.schema.questions import Proof
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import Template
from jrdb_avr.schema.wording.text import stated_actions

Proven = tuple[Proposal, list[Proof]]


class Refused(NamedTuple):
    """A proposal that was tried and refused.

    Attributes:
        proposal: Proposal.
        rule: Rule that refuses the proposal, a key of `diagnostics.REASONS`.
        detail: Outcomes of the proofs of this rule, or other details of the reason.
    """

    proposal: Proposal
    rule: str
    detail: str | None = None


class Prover:
    """Proves proposals of one template in one sequence over its sets of facts.

    Attributes:
        refused: Proposals that were tried and refused.
        untried: Number of proposals that were dropped before they were tried, by rule.
    """

    def __init__(self, search: Search, cypher: CypherFacts, held_out: Sequence[Extent] = ()) -> None:
        """Make a prover.

        Args:
            search: Sequence of the proposals.
            cypher: Source of the facts that the sets lack: what happens between keyframes.
            held_out: Extents of held-out questions. No proposal that touches one of them is proven.
        """
        self._search, self._cypher, self._held_out = search, cypher, held_out
        self.refused: list[Refused] = []
        self.untried: Counter[str] = Counter()

    def ask(self, keys: Sequence[Key]) -> list[Any]:
        """Return facts by key, as `perturb` asks for them."""
        if keys[0][0] == "start":
            return [self._search.layer.start(*arguments) for _, _, *arguments in keys]
        return self._cypher.ask(keys) if keys[0][0] == "onsets" else self._search.layer.facts.ask(keys)

    def prove(self, proposal: Proposal) -> list[Proof] | None:
        """Return the proofs of a proposal about conditions, hops and times, or note the proposal as refused."""
        if rule := self._excluding_rule(proposal):
            self.refused.append(Refused(proposal, rule))
            return None
        template = proposal.template
        program = replace(make_program(proposal.sequence, proposal.plan, template), conditions=proposal.conditions)
        answer = parse_answer(template.spec.mode, proposal.answer)
        proofs = self._cypher.complete(lambda: self._try_proofs(program, answer, template))
        if not (lacking := failing(template.name, proofs, self._search.rules)):
            return proofs
        rule = lacking[0].split()[0]
        detail = ", ".join(f"{proof.variant}: {proof.outcome}" for proof in proofs if proof.kind == rule)
        self.refused.append(Refused(proposal, rule, detail))
        return None

    def _excluding_rule(self, proposal: Proposal) -> str | None:
        """Return the rule that refuses a proposal before its proofs are tried."""
        template, frames = proposal.template, proposal.frames
        if any(_touches(proposal, extent) for extent in self._held_out):
            return "held_out"
        if template.pose_answer and proposal.answer in stated_actions(proposal.plan):
            return "stated"
        if not template.single_view and self._fits_one_view(proposal):
            return "view.single"
        if template.counts:
            stretch = proposal.relations[0], proposal.target, frames["t1"], frames["t2"]
            if self._cypher.count(proposal.sequence, *stretch) != len(proposal.counted):
                return "count"
        return None

    def _try_proofs(self, program: Program, answer: Answer, template: Template) -> list[Proof]:
        """Return the proofs up to the first that does not hold, unless another one of its kind is enough."""
        rules, proofs, missing = self._search.rules, [], False
        for proof in iterate_proofs(program, answer, self._search.layer.facts.keyframes, rules, self):
            if proof is None:
                missing = True
                continue
            proofs.append(proof)
            alternative = proof.kind == "time.shift" or (proof.kind == "hop.stop" and template.joins)
            if not alternative and failing(template.name, [proof], rules):
                return proofs
        if missing:
            raise MissingFactsError
        return proofs

    def _fits_one_view(self, proposal: Proposal) -> bool:
        """Return whether one view shows everybody at t0, and the target when the answer is read."""
        needed = [(who, proposal.frames["t0"]) for who in proposal.people.values()]
        needed += [(proposal.target, proposal.frames[name]) for name in proposal.template.decisive if name != "t0"]
        boxes = [self._search.layer.boxes[one] for one in needed]
        x, w = (np.array([box[side] for box in boxes]) for side in "xw")
        return bool(views.single_view(x, w, self._search.rules.visible_share))


def fill_pool(search: Search, forms: Sequence[Template], prover: Prover) -> list[Proven]:
    """Prove the proposals of a template.

    Args:
        search: Sequence to search.
        forms: Forms of the template that the layers of the sequence allow. They compete with each other.
        prover: Prover of the sequence.

    Returns:
        The proposals that stay, each with its proofs.
    """
    if forms[0].name == "presence":
        return _fill_presence(search, forms[0], prover)
    groups: dict[tuple[int, str], list[Proposal]] = defaultdict(list)
    for form in forms:
        for proposal in propose(search, form):
            groups[proposal.target, proposal.answer].append(proposal)
    kept: list[Proven] = []
    near = near_frames(forms[0].name, search.rules)
    for _, members in sorted(groups.items()):
        kept += _thin_out(sorted(members, key=lambda one: one.key), near, search.rules, prover)
    return kept


def _thin_out(members: Sequence[Proposal], near: int, rules: Rules, prover: Prover) -> list[Proven]:
    """Prove proposals of one target and answer in their order; drop those that read the same as one that stays."""
    kept: list[Proven] = []
    for number, proposal in enumerate(members):
        if len(kept) == rules.max_per_person:
            prover.untried["max_per_person"] += len(members) - number
            break
        if any(_is_near(proposal.read, other.read, near) for other, _ in kept):
            prover.untried["near_duplicate"] += 1
        elif (proofs := prover.prove(proposal)) is not None:
            kept.append((proposal, proofs))
    return kept


def _is_near(read: Sequence[int], other: Sequence[int], near: int) -> bool:
    return all(abs(a - b) <= near for a, b in zip(read, other, strict=True))


def _fill_presence(search: Search, template: Template, prover: Prover) -> list[Proven]:
    """Prove questions of presence: pairs of times in the order of a hash, each with one description."""
    groups: dict[tuple[int, str], list[tuple[bytes, tuple[int, int], list[Any]]]] = defaultdict(list)
    for who, answer, times, rows in propose_presence(search, template):
        groups[who, answer].append((_hash(search.sequence, who, *times), times, rows))
    near, kept = near_frames(template.name, search.rules), []
    for _, members in sorted(groups.items()):
        stay: list[Proven] = []
        for number, (_, times, rows) in enumerate(sorted(members, key=lambda one: one[0])):
            if len(stay) == search.rules.max_per_person:
                prover.untried["max_per_person"] += len(members) - number
                break
            if any(_is_near(times, other.read, near) for other, _ in stay):
                prover.untried["near_duplicate"] += 1
                continue
            rows.sort(key=lambda row: _hash(search.sequence, row["name"], *times))
            for row in rows:
                proposal = make_proposal(search, template, row)
                if (proofs := prover.prove(proposal)) is not None:
                    stay.append((proposal, proofs))
                    break
        kept += stay
    return kept


def _touches(proposal: Proposal, extent: Extent) -> bool:
    """Return whether a proposal needs a person of a held-out question at the same time."""
    template, counted = proposal.template, proposal.counted
    times = [proposal.frames[name] for name in (*template.stated, *template.read, *template.decisive)]
    times += [frame for _, frame in counted]
    people = {*proposal.people.values(), *(who for who, _ in counted)}
    return min(times) <= extent.last and max(times) >= extent.first and not people.isdisjoint(extent.tracks)


def _hash(*parts: Any) -> bytes:
    return hashlib.blake2b(repr(parts).encode(), digest_size=8).digest()
