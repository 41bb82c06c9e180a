"""`jrdb-avr export` and `jrdb-avr submit`: write questions and predictions for other machines and tools."""

from __future__ import annotations

from pathlib import Path

import click

from jrdb_avr.engine.commands._options import FILE, FOLDER, Store, run_argument, store_option
from jrdb_avr.engine.console import note, warnings_as_notes
from jrdb_avr.schema.card import CREATOR, HOME


@click.command()
@store_option()
@run_argument("run", required=False)
@click.option("--jsonl", type=FILE, help="Write the predictions of RUN, one per line, for 'score --jsonl'.")
@click.option("--chat", type=FOLDER, help="Write the model calls of RUN as chats with pictures, to train models on.")
@click.option("--results", type=FILE, help="Write the scores of RUN for a model on Hugging Face (with --url).")
@click.option("--public", type=FOLDER, help="Write a public store: questions and panoramas, but no answers.")
@click.option("--opaque", is_flag=True, help="With --public: replace the names of sequences by hashes.")
@click.option("--hf", type=FOLDER, help="Write DIRECTORY/public, to publish on Hugging Face, and DIRECTORY/private.")
@click.option("--graph", type=FOLDER, help="Write the nodes and edges of the graph as Parquet, with schema.json.")
@click.option("--creator", default=CREATOR, show_default=True, help="With --hf: publisher of the questions.")
@click.option("--url", default=HOME, show_default=True, help="With --hf or --results: address of the questions.")
def export(store: Store, run: str | None, opaque: bool, creator: str, url: str, **paths: Path | None) -> None:
    """Write questions, predictions or the graph for other machines and tools.

    --public writes a store for methods or machines that must not see the answers. 'evaluate' works on a public store.
    To score a run of a public store, first write the predictions of the run to a file with --jsonl. Then give the file
    to 'score --jsonl' on the full store, which has the answers.

    --hf writes two folders without pictures. The public folder has the questions, a dataset card and Croissant
    metadata. In the public folder, hashes replace the names of sequences. The private folder has the answers and the
    evidence.

    Examples:
      jrdb-avr export --store S --hf folder --url https://huggingface.co/datasets/ME/QUESTIONS
      jrdb-avr export --store S --public folder --opaque
      jrdb-avr export --store S --graph folder
      jrdb-avr export --store S react-simulated --jsonl predictions.jsonl
      jrdb-avr export --store S react-simulated --chat folder
      jrdb-avr export --store S react --results jrdb-avr.yaml --url https://huggingface.co/datasets/ME/QUESTIONS
    """
    from jrdb_avr.queries.files import write_bytes

    public, hf, graph = (paths[name] for name in ("public", "hf", "graph"))
    chat, jsonl, results = (paths[name] for name in ("chat", "jsonl", "results"))
    if not any(paths.values()):
        raise click.UsageError("say what to write: --public, --hf, --graph, --jsonl, --chat or --results")
    if (run is None) is bool(chat or jsonl or results):
        raise click.UsageError("--jsonl, --chat and --results need a RUN; --public, --hf and --graph take no RUN")
    if opaque and public is None:
        raise click.UsageError("--opaque is an option of --public")
    if public is not None:
        from jrdb_avr.engine.run.public import export_public

        with warnings_as_notes():
            count = export_public(store, public, opaque)
        note(f"wrote {public}: {count} questions and their panoramas")
    if hf is not None:
        from jrdb_avr.engine.integrations.huggingface import export_folders

        published, private = export_folders(store, hf, creator, url)
        note(f"wrote {published}, to be published, and {private}, which is not")
    if graph is not None:
        from jrdb_avr.queries.graph.export import export_graph

        entries = export_graph(store, graph)
        note(f"wrote {graph}: {len(entries)} tables with {sum(entry['rows'] for entry in entries):,} rows")
    if chat is not None and run is not None:
        from jrdb_avr.engine.integrations.chat import export_chat

        with warnings_as_notes():
            count = export_chat(store, run, chat)
        note(f"wrote {chat}: {count} conversations")
    if results is not None and run is not None:
        from jrdb_avr.engine.integrations.huggingface import model_results

        write_bytes(results, model_results(store, run, url).encode())
        note(f"wrote {results}: three scores; its notes hold what the form has no fields for")
    if jsonl is not None and run is not None:
        from jrdb_avr.engine.report.prediction_lines import write_lines
        from jrdb_avr.engine.report.run_scores import predictions_path
        from jrdb_avr.queries.store import read_table

        predictions = read_table(predictions_path(store, run))
        write_bytes(jsonl, b"".join(write_lines(predictions)))
        note(f"wrote {jsonl}: {len(predictions)} predictions")


@click.command()
@store_option()
@run_argument("run")
@click.argument("folder", metavar="DIR", type=FOLDER)
def submit(store: Store, run: str, folder: Path) -> None:
    """Write RUN as a bundle into the new folder DIR, so that the owner of the answers can score it.

    A bundle holds a file of predictions, a file with the settings of the run, and the hashes of these two files. The
    settings do not contain the address of the model's server. RUN may be in a store without answers.

    Examples:
      jrdb-avr submit react-simulated bundle --store S
      jrdb-avr score --store S --bundle bundle         on a machine with the answers
    """
    from jrdb_avr.engine.report.bundle import write_bundle

    bundle = write_bundle(store, run, folder)
    note(f"wrote {folder}: {len(bundle.run.question_ids)} questions")
