"""Descriptions and leads are those of the oracle, which reads the label files."""

import random
from pathlib import Path

import msgspec
import numpy as np
from environment import DEEP
from keyframe_layers import searched
from loaded_stores import memory_store
from oracle_candidates import NOWHERE, People
from random_worlds import in_other_words, lively_world, random_world, sociable_world

from jrdb_avr.engine.generate.describe import describe, find_leads
from jrdb_avr.schema.relations import QUESTION_RELATIONS, RELATIONS
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.wording.people import in_order

RULES = Rules()
SEQUENCE = "yard-2020-01-01_0"
MAKERS = (random_world, lively_world, sociable_world, in_other_words(random_world))


def compare(folder, seed):
    """Compare one world; return the numbers of descriptions and of leads."""
    store = memory_store(folder, MAKERS[seed % len(MAKERS)](random.Random(seed), SEQUENCE))
    oracle = People(Path(folder) / "root", SEQUENCE)
    described = led = 0
    with searched(store, SEQUENCE, RULES) as search:
        facts = search.layer.facts
        for frame, who in ((frame, who) for frame, people in facts.people.items() for who in people):
            found = describe(facts, SEQUENCE, who, frame, RULES)
            for poseless in (False, True):
                expected = oracle.description(frame, who, poseless)
                plain = None if expected is None else oracle.plain(expected)
                own = [one for one in found if (one.poseless if poseless else one.general)]
                assert [list(msgspec.to_builtins(in_order(one.conditions))) for one in own] == (
                    [plain] if plain else []
                )
                described += len(own)
            leads = find_leads(facts, who, frame)
            for label in QUESTION_RELATIONS:
                if RELATIONS[label].kind != "window":
                    reached = oracle.step(frame, who, label)
                    assert leads.get(label) == (None if reached in NOWHERE else reached), (frame, who, label)
            led += len(leads)
    return described, led


def test_descriptions_and_leads_are_those_of_the_oracle(tmp_path):
    described, led = np.sum([compare(tmp_path / str(seed), seed) for seed in range(16 if DEEP else 8)], axis=0)
    assert described > 200
    assert led > 100
