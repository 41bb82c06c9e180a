"""A journal of one file."""

from collections import defaultdict

from jrdb_avr.engine.run.journal import Journal, KeptEntries, LinePlace, journal_folder


def opened(path):
    """The journal in a file's folder that writes all entries into this file."""
    return Journal(path.parent, defaultdict(lambda: path.stem))


def segment_of(run, sequence="s"):
    """The file of a sequence in the journal of a run's folder."""
    return journal_folder(run) / f"{sequence}.jsonl"


def journal_lines(run):
    """All lines of a run's journal."""
    return [line for path in sorted(journal_folder(run).glob("*.jsonl")) for line in path.read_text().splitlines()]


class InMemory(KeptEntries):
    """Entries that lie in no file, as of one sequence."""

    def __init__(self, *entries):
        super().__init__(None, {own.question_id: LinePlace("s", 0, 0) for own in entries})
        self._entries = {own.question_id: own for own in entries}

    def __getitem__(self, question_id):
        return self._entries[question_id]
