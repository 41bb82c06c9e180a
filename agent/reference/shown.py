"""What a turn shows: observations under their names, results, and what is left of the budget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from jrdb_avr.agent.messages import Part, Picture, crop_line, crop_picture
from jrdb_avr.agent.panoramas import panorama_line, panorama_picture
from jrdb_avr.agent.prompt import render
from jrdb_avr.schema.method import Observation, Panorama
from jrdb_avr.schema.panorama import CROP, WIDTH


@dataclass(frozen=True)
class View:
    """An observation as it is named and shown. left, width: its columns in the panorama; line: its metadata."""

    name: str
    kind: str
    frame: int
    left: int
    width: int
    line: str
    picture: Picture


def crop_view(name: str, observation: Observation) -> View:
    """A look."""
    line, picture = crop_line(observation), crop_picture(observation)
    return View(name, "Picture", observation.frame_index, observation.left, CROP, line, picture)


def panorama_view(name: str, panorama: Panorama) -> View:
    """A panorama of a fixed context."""
    line, picture = panorama_line(panorama), panorama_picture(panorama)
    return View(name, "Panorama", panorama.frame_index, 0, WIDTH, line, picture)


def view_parts(views: Sequence[View]) -> list[Part]:
    """Each picture behind the line that numbers, names and places it."""
    parts: list[Part] = []
    for number, view in enumerate(views, 1):
        parts += [f"{view.kind} {number}, observation {view.name}: {view.line}", view.picture]
    return parts


@dataclass(frozen=True)
class Turn:
    """What has changed since the last turn, and what is left.

    results: of the last turn's calls; fresh: the pictures that they made; looks, calls: made and left.
    """

    results: Sequence[str]
    fresh: Sequence[View]
    error: str
    looks: tuple[int, int]
    calls: tuple[int, int]

    def result_lines(self) -> str:
        """The results as numbered lines."""
        lines = [f"{number}. {result}" for number, result in enumerate(self.results, 1)]
        return "\n".join(["Results of your last calls:", *(lines or ["none"])])

    def state(self) -> str:
        """The lines that close every turn."""
        error = f"Your last turn was malformed, and a second such turn ends the question: {self.error}"
        return render(
            "agent_state",
            looks=self.looks[0],
            looks_left=self.looks[1],
            calls=self.calls[0],
            calls_left=self.calls[1],
            error=error if self.error else "",
        )
