"""A sequence searched twice: by Cypher, in the keyframe layer, and by DuckDB, over the sequence's interval tables.

`sql/*.sql` derive from the tables alone what the layer holds: people at keyframes, certain and possible relations,
steps, descriptions, what begins and ends, encounters, joins. Folders of `sql` hold a SELECT for each Cypher file of
these names in `queries`. The two share the interval tables, the vocabulary, and nothing else.
"""

from pathlib import Path

import duckdb
import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate.candidates import RULES, VALUES
from jrdb_avr.engine.generate.scene import ints
from jrdb_avr.engine.generate.search import find_candidates
from jrdb_avr.schema import labels as words
from jrdb_avr.schema.labels import POSES_OF_INTERACTIONS
from jrdb_avr.schema.tables import LABELED
from jrdb_avr.schema.templates import TEMPLATES
from jrdb_avr.schema.things import OBJECTS, PERSON_CATEGORIES, VERBS
from jrdb_avr.schema.wording.phrases import POSES_OF_VERBS

SQL = Path(__file__).parent / "sql"
SCRIPTS = ("people", "relations", "descriptions", "events", "company", "joins")
CHAINS = ("two_hop", "three_hop", "later_pose")
"""Generators whose candidates statements of `necessity` go on from."""
TABLES = (
    "sequence",
    "frames",
    "persons",
    "sightings",
    "actions",
    "memberships",
    "interactions",
    "beside",
    "handles",
    "objects",
    "segments",
)
VOCABULARY = {
    "pose": words.POSES,
    "action": words.OTHER_ACTIONS,
    "interaction": words.INTERACTIONS,
    "gender": words.GENDERS,
    "age": words.AGES,
    "sector": words.ROBOT_SECTORS,
    "distance": words.DISTANCE_WORDS,
    "verb": VERBS,
    "thing": OBJECTS,
    "person category": sorted(PERSON_CATEGORIES),
}
NAMES_POSE = {"interaction": POSES_OF_INTERACTIONS, "object": POSES_OF_VERBS}


class Search:
    """`found` gives the rows of a Cypher file, `differences` compares them with the SQL's.

    context: the sequence with its layer; values: the thresholds of its rules by the names that the SQL calls them by.
    """

    def __init__(self, store, context, values, scripts=SCRIPTS):
        self.context, self.scene = context, context.scene
        self.database = duckdb.connect(config={"threads": 1})
        for table in TABLES:
            self._give(table, (store.facts if table in LABELED else store.interval)(table, self.scene.sequence))
        for table, lists in (("vocabulary", VOCABULARY), ("names_pose", NAMES_POSE)):
            rows = [{"list": name, "word": word} for name, all_ in lists.items() for word in all_]
            self._give(table, pa.Table.from_pylist(rows))
        for name, value in values.items():
            self.database.execute(f"CREATE MACRO {name}() AS {value}::{'DOUBLE' if value != int(value) else 'INTEGER'}")
        for script in scripts:
            self.database.execute((SQL / f"{script}.sql").read_text())
        for name in CHAINS if scripts == SCRIPTS else ():
            self.database.execute(f"CREATE TABLE {name} AS {(SQL / 'generators' / f'{name}.sql').read_text()}")

    def _give(self, table, rows):
        self.database.register("given", rows)
        self.database.execute(f"CREATE TABLE {table} AS FROM given")

    def differences(self, file, found, **values):
        """How many rows the SQL of a file gives, and examples of what only it and only the other side gives."""
        for macro, value in values.items():
            self.database.execute(f"CREATE OR REPLACE MACRO {macro}() AS {value}")
        self.database.register("cypher", found)
        self.database.execute(f"CREATE OR REPLACE TEMP TABLE joined_rows AS {(SQL / f'{file}.sql').read_text()}")
        number = self.database.execute("SELECT count(*) FROM joined_rows").fetchone()[0]
        if number == len(found) and not self._beyond("joined_rows", "cypher"):
            # As many rows, of which none is missing, are the same.
            return number, [], []
        return number, self._beyond("joined_rows", "cypher"), self._beyond("cypher", "joined_rows")

    def _beyond(self, one, other):
        """Examples of rows of a table that another lacks."""
        return self.database.execute(f"FROM {one} EXCEPT ALL FROM {other} LIMIT 3").fetchall()

    # -- the other side -------------------------------------------------------------------------------------------

    def found(self, folder, name, **values):
        """The rows of a Cypher file, with what its numbers stand for in their place."""
        found = self.context.query(folder, name, **values)
        if name == "steps":
            found = found.rename_columns(["moment", "relation", "reached"])
        columns = []
        for column in found.column_names:
            if column == "name":
                moments = self.context.descriptions.moment[ints(found, column)]
                columns += [self._texts(ints(found, column)), self.scene.frames(moments), self._tracks(moments)]
            elif column == "description":
                columns.append(pa.array(self.context.descriptions.texts[0], pa.string()).take(found[column]))
            elif column == "moment":
                columns += [self.scene.frames(ints(found, column)), self._tracks(ints(found, column))]
            elif column == "reached":
                columns.append(self._tracks(ints(found, column)))
            elif column.startswith("segment"):
                columns += [self.scene.segments[key].take(found[column]) for key in ("action", "start")]
            elif column == "encounter":
                columns += self._encounters().take(found[column]).columns
            else:
                columns.append(found[column])
        return plain(columns)

    def judged_presence(self):
        """Candidates of presence, which no one statement lists, with the rule that refuses each."""
        found = find_candidates(self.context, TEMPLATES["presence"])
        times = [found.frames[time] for time in ("t1", "t2")]
        columns = [self._texts(found.name), found.frames["t0"], self._tracks(found.people["a"]), *times]
        return plain(
            [
                *columns,
                *(
                    pa.array(all_).take(pa.array(numbers))
                    for all_, numbers in ((VALUES, found.answer), ([*RULES, None], found.rule))
                ),
            ]
        )

    def _texts(self, names):
        texts, number = self.context.descriptions.texts
        return pa.array(texts, pa.string()).take(pa.array(number[names]))

    def _tracks(self, moments):
        """Tracks of moments; reasons for nobody stay as they are."""
        if not len(moments):
            return moments
        return np.where(moments < 0, moments, self.scene.tracks[self.scene.people(np.maximum(moments, 0))])

    def _encounters(self):
        """Where each encounter begins, and its relation."""
        text = (
            "MATCH (m:Moment)-[:Begins]->(e:Encounter) WHERE e.id >= $low AND e.id < $low + 4294967296 "
            "RETURN m.frame AS t, m.track AS track, e.relation AS relation, e.id AS id ORDER BY id"
        )
        return self.context.graph.query(text, {"low": self.context.low}).drop("id")


def all_steps(context):
    """Where every relation that leads somebody anywhere leads from everybody with a box at a keyframe: frame, track,
    relation, outcome, target."""
    text = """
        MATCH (:Moment)-[s:Step]->(b:Moment) WHERE b.id >= $low AND b.id < $low + 4294967296
        WITH DISTINCT s.relation AS relation, s.bit AS bit
        MATCH (a:Moment) WHERE a.id >= $low AND a.id < $low + 4294967296 AND coalesce(a.seen, 1) = 1
          AND a.track IS NOT NULL
        OPTIONAL MATCH (a)-[k:Step]->(b:Moment) WHERE k.relation = relation
        RETURN a.frame AS frame, a.track AS source, relation,
               CASE WHEN b.track IS NOT NULL THEN 'defined' WHEN b.id IS NOT NULL THEN b.nowhere
                    WHEN bitwise_and(a.open, bit) > 0 THEN 'unknown' ELSE 'empty' END AS outcome, b.track AS target
        ORDER BY frame, source, relation"""
    return context.graph.query(text, {"low": context.low})


def plain(columns):
    """A table of these columns, which are compared by their place."""
    columns = [pa.array(column) if isinstance(column, np.ndarray) else column for column in columns]
    return pa.table(columns, names=[str(i) for i in range(len(columns))])
