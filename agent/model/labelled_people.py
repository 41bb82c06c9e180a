"""Request the labels of annotated people, and find the errors in the replies."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Final, NamedTuple

from jrdb_avr.agent.model.conventions import Convention
from jrdb_avr.agent.model.decode import closed_object, reply_object, write_box
from jrdb_avr.agent.model.messages import Message, Picture
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.labels import AGES, GENDERS, POSES, may_be_called
from jrdb_avr.schema.panorama import CROP, Box

PERSON_LINE: Final = "The person's labels, as one JSON object:"
_LABELS: Final = {"gender": tuple(GENDERS), "age": tuple(AGES), "pose": tuple(POSES)}
_WORDS: Final = {topic: [*labels, "cannot tell"] for topic, labels in _LABELS.items()}
PERSON_SCHEMA: Final = closed_object({topic: {"type": "string", "enum": words} for topic, words in _WORDS.items()})


class PersonView(NamedTuple):
    """A crop that shows a labelled person.

    picture: the crop. box: the person in pixels of the crop. labels: the known labels by topic: gender, age and pose.
    """

    picture: Picture
    box: Box
    labels: Mapping[str, str]


LabelledPerson = tuple[PersonView, PersonView, PersonView]
"""Three crops of a person: two of one frame, a few degrees apart, and one a second later."""


def request_labels(view: PersonView) -> list[Message]:
    """Return the messages that request the labels of a person.

    Args:
        view: The crop of the person.

    Returns:
        One user message. It states the person's box in thousandths of the crop, and no label.
    """
    text = render("calibrate_person", box=write_box(view.box, (CROP, CROP)), words=json.dumps(_WORDS))
    return [Message("user", (text, view.picture, PERSON_LINE))]


def find_errors(reply: Reply, view: PersonView, convention: Convention) -> dict[str, bool]:
    """Return whether each label of a reply is wrong, by topic.

    Args:
        reply: The reply to `request_labels`.
        view: The crop of the person.
        convention: The convention of the model.

    Returns:
        The errors. Topics without a known label, or without a label in the reply, are left out. A label that people
        with the known label may be called too is no error.
    """
    try:
        stated = reply_object(reply, convention)
    except DecodeError:
        return {}
    return {
        topic: stated[topic] != label and label not in may_be_called(stated[topic])
        for topic, label in view.labels.items()
        if stated.get(topic) in _LABELS[topic]
    }
