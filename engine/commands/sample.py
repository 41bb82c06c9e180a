"""`jrdb-avr sample`: write synthetic data in the folder layout of JRDB."""

from __future__ import annotations

from itertools import cycle, islice
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from jrdb_avr.engine.commands._options import FILE, form_option, workers_option
from jrdb_avr.engine.console import RowFormat, note, print_rows, progress_bar


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--sequences", type=click.IntRange(1, 200), help="Number of sequences (default: 5; 27 at --full-scale).")
@click.option(
    "--frames", type=click.IntRange(60, 100_000), default=1050, show_default=True, help="Frames per sequence."
)
@click.option("--people", type=click.IntRange(1, 300), default=34, show_default=True, help="Number of people in view.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the synthetic data.")
@click.option("--no-images", is_flag=True, help="Write label files, but no panoramas.")
@click.option(
    "--images",
    type=click.Choice(("keyframes", "changes", "all")),
    default="changes",
    show_default=True,
    help="Frames that get a panorama. 'changes': keyframes, and the frames just before and just after a label changes.",
)
@click.option("--full-scale", is_flag=True, help="Write sequences as large as in JRDB's test split, without panoramas.")
@click.option("--like", type=FILE, help="Write what this file of 'load --fingerprint' describes. No other options.")
@workers_option
@form_option
def command(folder: Path, seed: int, images: str, workers: int, form: RowFormat, **options: Any) -> None:
    """Write synthetic data to the new folder DIR, in the layout of JRDB, so that 'load' can read it.

    The data are label files and panoramas that show drawn people. The default size is 5 sequences of 1,050 frames.

    --like writes a root with the folders, files, keys, types, label names and frame numbers of a fingerprint. Numbers
    are invented, and pictures are empty files. So 'load' repeats what it prints about these, but not about numbers.

    Examples:
      jrdb-avr sample ./sample
      jrdb-avr sample ./big --full-scale
      jrdb-avr sample ./two --full-scale --sequences 2
      jrdb-avr sample ./copy --like jrdb.json
    """
    from jrdb_avr.loaders.synthetic.like import write_like
    from jrdb_avr.loaders.synthetic.write import FULL_SCALE, plan, rows, write
    from jrdb_avr.queries.files import new_folder

    sources = map(click.get_current_context().get_parameter_source, click.get_current_context().params)
    # The two are DIR and --like.
    if options["like"] and list(sources).count(ParameterSource.COMMANDLINE) > 2:
        raise click.UsageError("--like takes no other option")
    sizes = FULL_SCALE if options["full_scale"] else [(options["frames"], options["people"])] * 5
    sizes = list(islice(cycle(sizes), options["sequences"] or len(sizes)))
    done = []
    with new_folder(folder) as made, progress_bar() as progress:
        if options["like"] is not None:
            return note(f"{folder}: {write_like(options['like'], made)}")
        orders = plan(made, sizes, seed, "none" if options["no_images"] or options["full_scale"] else images)
        for written in write(orders, workers):
            done.append(written)
            progress("sequences", len(done), len(orders))
    print_rows(rows(done), title="The sample beside JRDB (synthetic)", form=form)
    if not form:
        boxes, images_made = sum(written.counts["boxes"] for written in done), sum(written.images for written in done)
        note(f"{folder}: {len(done)} sequence{'s' if len(done) > 1 else ''}, {boxes} boxes, {images_made} panoramas")
