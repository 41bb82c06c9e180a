"""A sequence searched twice: by the generators, in the graph of its scene, and by DuckDB, over its interval tables.

`sql/*.sql` derive from the tables alone what the generators search: people at keyframes, certain and possible
relations, descriptions, what begins and ends, companies, joins. `sql/generators` and `sql/necessity` hold a SELECT for
each Cypher file of these names. The two share the interval tables, the vocabulary, and nothing else.
"""

from contextlib import contextmanager
from pathlib import Path

import duckdb
import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate.candidates import RULES, VALUES
from jrdb_avr.engine.generate.chains import paths_in_graph
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.fork_join import find_forks, find_joins
from jrdb_avr.engine.generate.scene import ints, load_scene
from jrdb_avr.engine.generate.search import find_candidates, list_candidates
from jrdb_avr.schema import labels as words
from jrdb_avr.schema.labels import POSES_OF_INTERACTIONS
from jrdb_avr.schema.templates import TEMPLATES
from jrdb_avr.schema.things import OBJECTS, PERSON_CATEGORIES, VERBS
from jrdb_avr.schema.wording.phrases import POSES_OF_VERBS

SQL = Path(__file__).parent / "sql"
SCRIPTS = ("people", "relations", "descriptions", "events", "company", "joins")
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
JUDGED = {"presence": ("presence", "described", "presence_shift")}
"""Templates whose candidates are put together from several queries: the rows compared are those of the whole search."""
OF_PATHS = {
    "two_hop": ("text", "t", "a", "r1", "b", "r2", "c"),
    "three_hop": ("text", "t", "a", "r1", "b", "r2", "c", "r3", "d"),
    "fork_join": ("text", "t", "a", "r1", "b", "r2", "c", "r3", "r4", "d"),
}


class Search:
    """`generated` and `perturbed` give the rows that a Cypher file finds, `differences` compares them with the SQL's.

    rules: what the generators keep to; values: the same thresholds by the names that the SQL calls them by.
    """

    def __init__(self, store, sequence, rules, values):
        self.found = {}
        self.scene = load_scene(store, sequence)
        self.context = SearchContext.of(self.scene, rules)
        self.descriptions = self.context.descriptions
        self.database = duckdb.connect(config={"threads": 1})
        for table in TABLES:
            self.database.read_parquet(str(store.interval_path(table, sequence))).create(table)
        self._give("vocabulary", ("list", "word"), [(name, word) for name, all_ in VOCABULARY.items() for word in all_])
        self._give("names_pose", ("list", "word"), [(name, word) for name, all_ in NAMES_POSE.items() for word in all_])
        for name, value in values.items():
            self.database.execute(f"CREATE MACRO {name}() AS {value}::{'DOUBLE' if value != int(value) else 'INTEGER'}")
        for script in SCRIPTS:
            self.database.execute((SQL / f"{script}.sql").read_text())

    def close(self):
        self.context.graph.close()
        self.database.close()

    def _give(self, table, names, rows):
        rows = pa.table([pa.array(column) for column in zip(*rows, strict=True)], names=list(names))
        self.database.register("given", rows)
        self.database.execute(f"CREATE TABLE {table} AS FROM given")

    def differences(self, folder, name, found, **values):
        """How many rows both ways give, and examples of what only the SQL and only the Cypher gives."""
        query = (SQL / folder / f"{name}.sql").read_text()
        for macro, value in values.items():
            self.database.execute(f"CREATE OR REPLACE MACRO {macro}() AS {value}")
        self.database.register("cypher", found)
        self.database.execute(f"CREATE OR REPLACE TEMP TABLE joined_rows AS {query}")
        number = self.database.execute("SELECT count(*) FROM joined_rows").fetchone()[0]
        if number == len(found) and not self._beyond("joined_rows", "cypher"):
            # As many rows, of which none is missing, are the same.
            return number, [], []
        return number, self._beyond("joined_rows", "cypher"), self._beyond("cypher", "joined_rows")

    def _beyond(self, one, other):
        """Examples of rows of a table that another lacks."""
        return self.database.execute(f"FROM {one} EXCEPT ALL FROM {other} LIMIT 3").fetchall()

    # -- the generators' side -------------------------------------------------------------------------------------

    def generated(self, name):
        return self._judged(name) if name in JUDGED else self._plain(self._found(name))

    def _judged(self, name):
        """Candidates that no one query lists, with the rule that refuses each."""
        template = next(template for template in TEMPLATES.values() if template.name == name)
        found = find_candidates(self.context, template)
        texts, number = self.descriptions.texts
        rules, answers = pa.array([*RULES, None]), pa.array(VALUES)
        columns = [pa.array(texts, pa.string()).take(pa.array(number[found.name])), found.frames["t0"]]
        columns += [self._tracks(found.people["a"]), found.frames["t1"], found.frames["t2"]]
        return _table([*columns, answers.take(pa.array(found.answer)), rules.take(pa.array(found.rule))])

    def _found(self, name):
        """What a generator finds, searched once."""
        if name not in self.found:
            self.found[name] = self._search(name)
        return self.found[name]

    def _search(self, name):
        if name == "fork_join":
            return find_forks(self.context, find_joins(self.context))
        if name == "gap_count_people":
            return self._people_counted()
        found = self.context.query("generators", name)
        return found.rename_columns(["at0", "b", "c"]) if name == "fork" else found

    def _people_counted(self):
        """Whom companies meet, the company being told by where it begins and its relation."""
        text = "MATCH (m:Moment)-[:Keeps]->(c:Company) RETURN c.id AS id, m.id AS at0, c.relation AS r1 ORDER BY id"
        companies, met = self.context.graph.query(text), self.context.people_met
        rows = met["company"].to_numpy()
        return pa.table(
            {
                "at0": companies["at0"].take(rows),
                "r1": companies["r1"].take(rows),
                "person": pa.array(self.scene.tracks[met["person"].to_numpy()]),
                "met": met["met"],
                "seen": met["seen"],
            }
        )

    @contextmanager
    def paths(self, name):
        """The paths of a template's candidates, put into both databases."""
        found = self._found(name)
        template = next(template for template in TEMPLATES.values() if template.name == name)
        paths = list_candidates(self.context, template, found)
        self.database.execute(
            "CREATE OR REPLACE TEMP TABLE paths AS"
            f" SELECT * FROM ({(SQL / 'generators' / f'{name}.sql').read_text()}) found({', '.join(OF_PATHS[name])})"
        )
        with paths_in_graph(self.context, paths):
            yield found

    def perturbed(self, name, found=None, **values):
        """The rows of a necessity query; `found` are the candidates whose paths are in the graph."""
        rows = self.context.query("necessity", name, **values)
        if found is not None:
            paths = found.select(["name", "at0", *(n for n in ("r1", "r2", "r3", "r4") if n in found.column_names)])
            columns = paths.take(rows["id"])
            for column in rows.column_names[1:]:
                columns = columns.append_column(column, rows[column])
            rows = columns
        return self._plain(rows)

    def _plain(self, found):
        """Numbers of the scene's graph as what they stand for: tracks, frames, texts."""
        columns = []
        for name in found.column_names:
            column = found[name]
            if name == "name":
                texts, number = self.descriptions.texts
                columns.append(pa.array(texts, pa.string()).take(pa.array(number[ints(found, name)])))
            elif name.startswith("at"):
                columns += [self.scene.frames(ints(found, name)), self._tracks(ints(found, name))]
            elif name in ("a", "b", "c", "d"):
                columns.append(self._tracks(ints(found, name)))
            elif name.startswith("segment"):
                columns += [self.scene.segments[key].take(column) for key in ("action", "start")]
            elif name != "company":
                columns.append(column)
        return _table(columns)

    def _tracks(self, moments):
        """Tracks of moments; reasons for nobody stay as they are."""
        if not len(moments):
            return moments
        return np.where(moments < 0, moments, self.scene.tracks[self.scene.people(np.maximum(moments, 0))])


def _table(columns):
    columns = [pa.array(column) if isinstance(column, np.ndarray) else column for column in columns]
    return pa.table(columns, names=[str(i) for i in range(len(columns))])
