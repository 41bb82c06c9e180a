"""The pool of a template in one sequence: proposals are proven in the order of a hash until selection has enough.

What a selection cannot use is dropped without a proof.
"""

from __future__ import annotations

import sys
from bisect import bisect_left
from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from itertools import chain, compress, islice
from typing import Any, Final, TypeVar

import msgspec
import numpy as np

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.asked import Candidate, answer_contexts, choice_contexts
from jrdb_avr.engine.generate.bins import answer_bin
from jrdb_avr.engine.generate.choices import wrong_choices, wrong_sets
from jrdb_avr.engine.generate.cypher_facts import CypherFacts
from jrdb_avr.engine.generate.held_out import Extent
from jrdb_avr.engine.generate.layer import Layer, TableRow
from jrdb_avr.engine.generate.near_duplicates import are_near, near_frames
from jrdb_avr.engine.generate.perturb import MissingFactsError, Setting, iterate_proofs, require_all
from jrdb_avr.engine.generate.programs import Answer, Program
from jrdb_avr.engine.generate.proofs import failing
from jrdb_avr.engine.generate.propose import Proposal, program_of, propose, propose_presence
from jrdb_avr.engine.report.hashes import hash_of
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, POSES, PRESENCE_ANSWERS
from jrdb_avr.schema.questions import Proof
from jrdb_avr.schema.relations import QUESTION_RELATIONS
from jrdb_avr.schema.rules import frames
from jrdb_avr.schema.templates import Template
from jrdb_avr.schema.wording.text import implied_choices

_T = TypeVar("_T")

_DESCRIPTIONS: Final = 6
"""Number of descriptions of a person with which questions of a template with time twins begin."""

_TRIES: Final = 6
"""Maximum number of proposals about one person, time and answer that are tried without success."""

_MOST_TRIES: Final = 1000
"""Number of tries after which `_thin_out` stops in a sequence, or `_TRIES` for each candidate of the limit if more."""

_PAIRS: Final = 3
"""Maximum number of candidates of the template presence with one description and one answer."""

_WITH_TWINS: Final = ("change", "later_action")
"""Templates with actions as choices that have time twins."""

_ROW_KEYS: Final = ("segment", "t0", "t1", "t2", "r1", "r2", "r3", "r4", "answer")


class Prover:
    """Proves proposals of one template in one sequence over its sets of facts.

    Attributes:
        counts: Number of proposals that were refused, by rule, a key of `diagnostics.RULES`.
    """

    def __init__(self, layer: Layer, cypher: CypherFacts, held_out: Sequence[Extent] = ()) -> None:
        """Make a prover.

        Args:
            layer: Layer of the sequence.
            cypher: Source of facts, with the sets of the layer.
            held_out: Extents of held-out questions. No proposal that touches one of them is proven.
        """
        self._layer, self._cypher, self._held_out = layer, cypher, held_out
        self._setting = Setting(cypher, layer.facts.keyframes, layer.rules)
        self.counts: Counter[str] = Counter()

    def with_choices(self, form: Template, rows: Iterable[TableRow]) -> Iterator[Proposal]:
        """Yield the proposals of rows that have wrong choices, and note the others as refused."""
        for row in rows:
            proposal = Proposal(self._layer, form, row)
            if wrong_sets(_wrong_actions(proposal)):
                yield proposal
            else:
                self.counts["choices"] += 1

    def proven(self, proposals: Iterable[Proposal]) -> Iterator[Proposal]:
        """Yield the proposals that are proven, and note the others as refused."""
        return (proposal for proposal in proposals if self.prove(proposal) is not None)

    def prove(self, proposal: Proposal) -> list[Proof] | None:
        """Return the proofs of a proposal about conditions, hops and times, or note the proposal as refused."""
        return self.prove_all([proposal])[0]

    def prove_all(self, proposals: Sequence[Proposal]) -> list[list[Proof] | None]:
        """Return what `prove` returns, for several proposals. Statements look up the facts of all of them together."""
        tried = {number: partial(self._try, proposal) for number, proposal in enumerate(proposals)}
        results = self._cypher.complete_all(tried)
        self.counts.update(result for result in results.values() if isinstance(result, str))
        return [None if isinstance(result := results[number], str) else result for number in tried]

    def look_ahead(self, proposals: Iterable[Proposal]) -> None:
        """Note the facts that the proofs of some proposals lack, so that a statement looks them up together."""
        for proposal in proposals:
            with suppress(MissingFactsError):
                self._try(proposal)

    def _try(self, proposal: Proposal) -> list[Proof] | str:
        """Return the proofs of a proposal, or the rule that refuses it."""
        template, frames = proposal.template, proposal.frames
        if any(_touches(proposal, extent) for extent in self._held_out):
            return "held_out"
        if not template.single_view and self._fits_one_view(proposal):
            return "view.single"
        if template.counts:
            stretch = proposal.relations[0], frames["t1"], frames["t2"]
            if self._cypher.ask([("count", proposal.sequence, proposal.target, *stretch)]) != [len(proposal.counted)]:
                return "count"
        proofs = self._try_proofs(*program_of(proposal), template)
        lacking = failing(template.name, proofs, self._layer.rules)
        return lacking[0].split()[0] if lacking else proofs

    def _try_proofs(self, program: Program, answer: Answer, template: Template) -> list[Proof]:
        """Return the proofs up to the first that does not hold, unless another one of its kind is enough."""
        proofs: list[Proof | None] = []
        for proof in iterate_proofs(program, answer, self._setting):
            proofs.append(proof)
            if proof is None or proof.kind == "time.shift" or (proof.kind == "hop.stop" and template.joins):
                continue
            if failing(template.name, [proof], self._layer.rules):
                return [*filter(None, proofs)]
        return require_all(proofs)

    def _fits_one_view(self, proposal: Proposal) -> bool:
        """Return whether one view shows all people at t0, and the target at the times of the answer."""
        needed = [(track, proposal.frames["t0"]) for track in proposal.people.values()]
        needed += [(proposal.target, proposal.frames[name]) for name in proposal.template.decisive if name != "t0"]
        boxes = [self._layer.boxes[one] for one in needed]
        x, w = (np.array([box[side] for box in boxes]) for side in "xw")
        return bool(views.single_view(x, w, self._layer.rules.visible_share))


def fill_pool(layer: Layer, forms: Sequence[Template], prover: Prover, limit: int = sys.maxsize) -> list[Candidate]:
    """Prove the proposals of a template, as many as selection can use.

    People and moments come in the order of a hash, so that a limit prefers none of them.

    Args:
        layer: Layer of the sequence.
        forms: Forms of the template that the layers of the sequence allow. They compete with each other.
        prover: Prover of the sequence.
        limit: Number of candidates that are enough. All candidates with one description may be needed as time twins,
            so a few more are returned.

    Returns:
        The proven candidates.
    """
    fill = _fill_presence if forms[0].name == "presence" else _fill_moments if forms[0].asks_action else _thin_out
    return list(map(make_candidate, fill(layer, forms, prover, limit)))


def _fill_moments(layer: Layer, forms: Sequence[Template], prover: Prover, limit: int) -> Iterator[Proposal]:
    """Yield one proposal for each person, time and true answer: the first proven one in the order of a hash.

    Time twins have equal descriptions. A template with twins begins with all times and answers of some descriptions.
    """
    (form,) = forms
    described: dict[int, dict[tuple[Any, ...], list[TableRow]]] = defaultdict(lambda: defaultdict(list))
    moments: dict[tuple[Any, ...], list[TableRow]] = defaultdict(list)
    for row in propose(layer, form):
        if form.name in _WITH_TWINS:
            described[row[form.target]][row["name"], row.get("r1"), row.get("r2")].append(row)
        moments[_moment(form, row)].append(row)

    def prove_described(track: int) -> Iterator[list[Proposal]]:
        ordered = sorted(described[track].values(), key=lambda rows: _rank(layer, rows[0]))
        return _take_some(prover.proven(prover.with_choices(form, rows)) for rows in ordered)

    def prove_moment(moment: tuple[Any, ...]) -> list[Proposal]:
        tried = prover.with_choices(form, sorted(moments[moment], key=partial(_rank, layer)))
        return list(islice(prover.proven(islice(tried, _TRIES)), 1))

    for proposal in _take_turns(limit, map(prove_described, _in_order(layer, described))):
        moments.pop(_moment(form, proposal.row), None)
        yield proposal
    yield from _take_turns(limit, [map(prove_moment, _in_order(layer, moments))])


def _moment(form: Template, row: TableRow) -> tuple[Any, ...]:
    """Return the person, the time asked and the true answer of a row."""
    return row[form.target], row.get("t1", row["t0"]), row["answer"]


def _in_order(layer: Layer, items: Iterable[_T]) -> list[_T]:
    """Return people or moments in the order of a hash."""
    return sorted(items, key=partial(hash_of, layer.sequence))


def _take_some(groups: Iterable[Iterable[_T]]) -> Iterator[list[_T]]:
    """Return the first groups that are not empty."""
    return islice(filter(None, map(list, groups)), _DESCRIPTIONS)


def _take_turns(limit: int, queues: Iterable[Iterator[Sequence[_T]]]) -> Iterator[_T]:
    """Yield the items of the queues, one whole group of each queue in turn, until there are at least `limit` items."""
    waiting = deque(queues)
    while waiting and limit > 0:
        queue = waiting.popleft()
        for group in islice(queue, 1):
            yield from group
            limit -= len(group)
            waiting.append(queue)


def _fill_presence(layer: Layer, forms: Sequence[Template], prover: Prover, limit: int) -> Iterator[Proposal]:
    """Yield, for some descriptions of each person, a few proposals with each answer, in the order of a hash."""
    (form,) = forms
    described, pairs = propose_presence(layer, form)

    def prove_described(track: int) -> Iterator[list[Proposal]]:
        ordered = sorted(described[track], key=partial(_rank, layer))
        return _take_some(_prove_pairs(layer, form, row, pairs.get(track, ()), prover) for row in ordered)

    return _take_turns(limit, map(prove_described, _in_order(layer, described)))


def _prove_pairs(
    layer: Layer, form: Template, row: TableRow, pairs: Iterable[TableRow], prover: Prover
) -> Iterator[Proposal]:
    near, first = near_frames(form.name, layer.rules), row["t0"] + frames(layer.rules.min_wait_s)
    kept: dict[str, list[tuple[int, int]]] = defaultdict(list)
    later = [row | pair for pair in pairs if pair["t1"] >= first and not (row["ahead"] and pair["away"])]
    for both in sorted(later, key=partial(_rank, layer)):
        times, stay = (both["t1"], both["t2"]), kept[both["answer"]]
        if len(stay) < _PAIRS and not any(are_near(times, one, near) for one in stay):
            for proposal in prover.proven([Proposal(layer, form, both)]):
                stay.append(times)
                yield proposal


def _thin_out(layer: Layer, forms: Sequence[Template], prover: Prover, limit: int) -> Iterator[Proposal]:
    """Yield proven proposals without near-duplicates, at most `max_per_person` for each person and answer.

    Pairs of person and answer take turns in the order of a hash. The proposals of one pair come in the order of their
    keys. The search ends at the limit or after a number of tries.
    """
    groups: dict[tuple[int, str], list[Proposal]] = defaultdict(list)
    for form in forms:
        for row in propose(layer, form):
            proposal = Proposal(layer, form, row)
            groups[proposal.target, proposal.answer].append(proposal)
        if form.spec.read == "start_view":
            prover.look_ahead(chain.from_iterable(groups.values()))
    near, kept = near_frames(forms[0].name, layer.rules), defaultdict[tuple[int, str], list[Sequence[int]]](list)

    def admitted(group: tuple[int, str]) -> Iterator[Proposal]:
        for proposal in sorted(groups[group], key=lambda proposal: proposal.key):
            if len(kept[group]) == layer.rules.max_per_person:
                prover.counts["max_per_person"] += 1
            elif any(are_near(proposal.read, read, near) for read in kept[group]):
                prover.counts["near_duplicate"] += 1
            else:
                yield proposal

    def prove_turns() -> Iterator[list[Proposal]]:
        queues = [admitted(group) for group in _in_order(layer, groups)]
        tries = max(_MOST_TRIES, _TRIES * limit)
        while tries > 0 and (tried := [proposal for queue in queues for proposal in islice(queue, 1)]):
            tries -= len(tried)
            proven = list(compress(tried, prover.prove_all(tried)))
            for proposal in proven:
                kept[proposal.target, proposal.answer].append(proposal.read)
            yield proven

    return _take_turns(limit, [prove_turns()])


def _rank(layer: Layer, row: TableRow) -> int:
    """Return the hash that decides among rows. It does not depend on the place of the sequence in the data."""
    local = row | {key: row[key] - layer.low for key in ("name", "segment") if key in row}
    return hash_of(layer.sequence, local["name"], [local.get(key) for key in _ROW_KEYS])


# -- candidates -------------------------------------------------------------------------------------------------------


def make_candidate(proposal: Proposal) -> Candidate:
    """Make the candidate of a proposal.

    Args:
        proposal: Proposal. If it has actions as choices, at least three wrong choices fit (`Prover.with_choices`).

    Returns:
        The candidate.
    """
    template, answer, layer = proposal.template, proposal.answer, proposal.layer
    words, begin = [condition.words for condition in proposal.conditions], proposal.frames["t0"]
    key, asked, wrong = proposal.key, proposal.read, frozenset[str]()
    if template.asks_action:
        wrong, asked = _wrong_actions(proposal), (_asked_keyframe(proposal),)
        key = f"{key} {answer}"
        last = " ".join(proposal.relations[-2 if template.joins else -1 :]) or None
        contexts = choice_contexts(proposal.sequence, words, last, asked[0] - begin)
    elif template.answer is None:
        asked = tuple(proposal.frames[name] for name in template.decisive)
        wrong = frozenset(PRESENCE_ANSWERS if answer in PRESENCE_ANSWERS else DISTANCE_ANSWERS) - {answer}
        contexts = answer_contexts(proposal.sequence, layer.head["frame_count"], begin, asked, words)
    else:
        times = [proposal.frames[name] for name in template.stated]
        number = answer_bin(template.spec.mode, answer, times, template.spec.read)
        contexts = ((f"form {template.query}", 1), (f"form {template.query} answer {number}", 1))
    return Candidate(
        key=key,
        template=template.name,
        sequence=proposal.sequence,
        track=proposal.target,
        described=repr((begin, words, proposal.relations)),
        asked=asked,
        truth=answer,
        wrong=wrong,
        contexts=contexts,
        event=_event(proposal),
        form=template.query,
        row=msgspec.msgpack.encode(proposal.row),
    )


def _asked_keyframe(proposal: Proposal) -> int:
    """Return the first keyframe at or after the time asked, because a posture may begin between two keyframes."""
    keyframes: list[int] = proposal.layer.facts.keyframes
    return keyframes[bisect_left(keyframes, proposal.frames[proposal.template.decisive[0]])]


def _wrong_actions(proposal: Proposal) -> frozenset[str]:
    """Return the actions that may be wrong choices of a proposal."""
    layer = proposal.layer
    false = proposal.layer.false_labels(proposal.target, _asked_keyframe(proposal))
    if proposal.template.spec.read == "next_action":
        false &= frozenset(POSES)
    implied = implied_choices(layer.names[proposal.row["name"]], proposal.relations)
    return wrong_choices(proposal.answer, false, implied, layer.present)


def _event(proposal: Proposal) -> str | None:
    """Return the name of the event that a proposal asks about. At most one question of a person has an event.

    The event is a count of people, or the start of an action. All other proposals have None.
    """
    template = proposal.template
    if template.counts:
        return f"count {QUESTION_RELATIONS.index(proposal.relations[0])} {proposal.frames['t1']}"
    if template.spec.read not in ("start", "span", "start_view"):
        return None
    return f"start {proposal.segments[0]['id'] - proposal.layer.low}"


def _touches(proposal: Proposal, extent: Extent) -> bool:
    """Return whether a proposal needs a person of a held-out question at the same time."""
    template, frames = proposal.template, proposal.frames
    times = {frames[name] for name in (*template.stated, *template.read, *template.decisive)}
    times.update(frame for _, frame in proposal.counted)
    people = {*proposal.people.values(), *(track for track, _ in proposal.counted)}
    return min(times) <= extent.last and max(times) >= extent.first and not people.isdisjoint(extent.tracks)
