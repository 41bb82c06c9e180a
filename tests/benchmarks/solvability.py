"""Whether each question can be answered by looking: `python tests/benchmarks/solvability.py ROOT STORE [--limit N]`.

ROOT is a sample with panoramas, STORE the store that was made of it. A method that sees perfectly (see
`tests/perfect_perception.py`) takes every question, or the first N of each template, and is judged as runs are. Prints
per template the shares of right answers and boxes, and how many observations it took; then what went wrong.
"""

import argparse
import statistics
import sys
from collections import defaultdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

from fact_teller import Teller
from perfect_perception import take

from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.queries.questions import read_question_rows, read_sequences
from jrdb_avr.queries.store import Store


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", type=Path)
    parser.add_argument("store", type=Path)
    parser.add_argument("--limit", type=int, help="questions of each template and sequence")
    arguments = parser.parse_args()
    store = Store(arguments.store)
    sequences = read_sequences(store)
    rows = []
    for name, info in sorted(sequences.items()):
        chosen, count = [], defaultdict(int)
        for question in read_question_rows(store):
            if question.sequence == name:
                count[question.template] += 1
                if arguments.limit is None or count[question.template] <= arguments.limit:
                    chosen.append(question)
        # Every panorama of one sequence is decoded once.
        observer = Observer(arguments.root / "images" / "image_stitched", [info], cached=len(info.frames))
        rows += take(store, Teller(arguments.root), chosen, sequences, observer)
        print(f"{name}: {len(chosen)} questions", file=sys.stderr)
    report(rows)


def report(rows):
    by_template = defaultdict(list)
    for row in rows:
        by_template[row["template"]].append(row)
    print(f"{'template':<14} {'n':>5} {'answer':>8} {'evidence':>8}   observations min / median / max")
    for template, part in sorted(by_template.items()):
        right = [sum(row[name] for row in part) / len(part) for name in ("answer_score", "evidence_score")]
        looks = [row["n_observations"] for row in part]
        shares = " ".join(f"{100 * share:>7.1f}%" for share in right)
        print(f"{template:<14} {len(part):>5} {shares}   {min(looks):>5} / {statistics.median(looks):g} / {max(looks)}")
    for row in rows:
        if not row["combined_score"]:
            print(f"{row['question_id']} {row['template']}: {row['reason'] or row['answer']}: {row['question']}")


if __name__ == "__main__":
    main()
