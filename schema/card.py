"""Texts for the card of a published question set: sources, licences, citation and notes for users.

The Markdown card and the Croissant metadata of `export` both use these texts.
"""

from __future__ import annotations

import tomllib
from importlib.resources import files
from typing import Final, NamedTuple

HOME: Final = "https://jrdb.erc.monash.edu/"
"""Website of JRDB and its extensions."""

CREATOR: Final = "The JRDB-AVR developers"

TITLE: Final = "JRDB-AVR questions"

SUMMARY: Final = (
    "Questions about people in 360-degree video that a mobile robot recorded, to be answered by choosing where "
    "and when to look. Each has one proven answer and a person whose box is the visual evidence; the publisher "
    "keeps both for scoring."
)


class Source(NamedTuple):
    """Data set that questions are made from.

    Attributes:
        name: Name of the data set.
        layers: Annotation layers that the data set provides, as in `schema.tables.LAYERS`.
        licence: Identifier of the licence, as in the lists of Hugging Face and SPDX.
        licence_url: Address of the licence text.
        citation: Short reference to the paper.
    """

    name: str
    layers: tuple[str, ...]
    licence: str
    licence_url: str
    citation: str


_JRDB: Final = ("cc-by-nc-sa-3.0", "https://creativecommons.org/licenses/by-nc-sa/3.0/")

SOURCES: Final = (
    Source("JRDB", ("2d", "3d", "timestamps", "images"), *_JRDB, "Martín-Martín et al., JRDB, IEEE TPAMI"),
    Source("JRDB-Act", ("actions", "groups"), *_JRDB, "Ehsanpour et al., JRDB-Act, CVPR 2022"),
    Source(
        "JRDB-Social",
        ("demographics", "interactions", "group_info"),
        *_JRDB,
        "Jahangard et al., JRDB-Social, CVPR 2024",
    ),
    Source("JRDB-Pose", ("pose",), *_JRDB, "Vendrow et al., JRDB-Pose, CVPR 2023"),
    Source("JRDB-PanoTrack", ("panoptic",), *_JRDB, "Le et al., JRDB-PanoTrack, CVPR 2024"),
    Source("JRDB-Reasoning", ("handles",), *_JRDB, "Jahangard et al., JRDB-Reasoning"),
)
"""JRDB and its extensions.

The footer of the JRDB website states the licence. The maintainers of JRDB's toolkit confirm it
(https://github.com/JRDB-dataset/jrdb_toolkit/issues/9). If the website states further terms, the terms of
the website take precedence.
"""

SAMPLE: Final = Source(
    "the synthetic sample world of jrdb-avr",
    (),
    "apache-2.0",
    "https://www.apache.org/licenses/LICENSE-2.0",
    "none: it shows no real people, and results on it say nothing about JRDB",
)

SYNTHETIC: Final = "Synthetic: questions of the sample world. Results on it say nothing about JRDB."

CITE: Final = """\
@misc{jrdb-avr,
  title = {JRDB-AVR},
  author = {The authors of the JRDB-AVR paper}
}
@article{jrdb,
  title = {JRDB: A Dataset and Benchmark of Egocentric Robot Visual Perception of Humans in Built Environments},
  author = {Martín-Martín, Roberto and Patel, Mihir and Rezatofighi, Hamid and Shenoi, Abhijeet and Gwak, JunYoung and
            Frankel, Eric and Sadeghian, Amir and Savarese, Silvio},
  journal = {IEEE Transactions on Pattern Analysis and Machine Intelligence}
}"""
RAI: Final[dict[str, str]] = tomllib.loads(files("jrdb_avr.schema").joinpath("rai.toml").read_text("utf-8"))
"""Texts of the Responsible-AI fields by the name of the field in Croissant."""


def is_of_sample(sequence: str) -> bool:
    """Return whether a sequence belongs to the synthetic sample world. Names of such sequences begin with "sample-"."""
    return sequence.startswith("sample-")
