"""A chat that plays a script, and pictures of a person who is one red rectangle: what the baselines are tested with.

The eyes below find the rectangle in the JPEG they are sent and nowhere else, and write its box by the contract with
arithmetic of their own.
"""

import json
import re
from itertools import pairwise

import cv2
import numpy as np
from painted import World

from jrdb_avr.agent.model.messages import Picture
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.schema.method import Observation, Panorama, Question, SequenceInfo, Task

MODES = ("multiple_choice", "frame", "span", "frame_viewpoint", "number")
CHOICES = ("walking", "standing", "sitting", "lying")


class Chat:
    """Replies with `script[n]` to the n-th call, or with what `script(messages, n)` returns; keeps what it was sent."""

    def __init__(self, script):
        self.script = script
        self.sent, self.schemas = [], []

    def complete(self, messages, schema=None):
        n = len(self.sent)
        self.sent.append(list(messages))
        self.schemas.append(schema)
        reply = self.script(messages, n) if callable(self.script) else self.script[n]
        if isinstance(reply, Reply):
            return reply
        return Reply(reply, finish_reason="stop", prompt_tokens=10**n, completion_tokens=2 * 10**n)

    def user(self, n):
        """The parts of the n-th call's user message."""
        return self.sent[n][1].parts


def play(method, script, task, **options):
    """The prediction, and the chat that was played."""
    chat = Chat(script)
    return method(chat, **options).answer(task), chat


def evidence(bbox, frame=0, key="bbox"):
    return [{"frame_id": f"{frame:06d}", key: list(bbox)}]


def final(answer, bbox, frame=0):
    return json.dumps({"answer": answer, "evidence_bboxes": evidence(bbox, frame)})


def proposal(bbox, frame=0):
    return json.dumps({"evidence_bboxes": evidence(bbox, frame)})


def blank_task(mode="multiple_choice", choices=CHOICES, frames=(0, 5, 10), frame_count=1000, steps=None, looks=None):
    """A task whose pictures show nothing: for what does not depend on them. `looks` receives what was looked at."""
    image = np.zeros((480, 480, 3), np.uint8)
    looks = [] if looks is None else looks

    def observe(sequence, frame_index, angle_deg):
        looks.append((frame_index, angle_deg))
        # By hand: 3760 columns are 360 degrees, and the crop begins half its width before its centre.
        left = (round(angle_deg / 360 * 3760) - 240) % 3760
        return Observation(sequence, frame_index, frame_index / 15, angle_deg, 45.96, left, image)

    def panorama(sequence, frame_index):
        looks.append((frame_index, None))
        return Panorama(sequence, frame_index, frame_index / 15, b"\xff\xd8 whole \xff\xd9")

    question = Question("0" * 16, "s", "What does the person do?", tuple(choices), mode)
    record = ([] if steps is None else steps).append
    return Task(question, SequenceInfo("s", 15.0, frame_count, tuple(frames)), observe, panorama, record, None)


# -- a person of one colour -------------------------------------------------------------------------------------------


class RedWorld(World):
    """One red person per frame, at `actors[frame]` = (x, y, w, h) in stitched pixels; over the seam where x says so."""

    def paint(self, path, frame):
        image = np.full((480, 3760, 3), 90, np.uint8)
        x, y, w, h = self.actors[frame]
        columns = np.arange(x, x + w) % 3760
        image[y : y + h, columns] = (250, 0, 0)
        cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 97])


def seen_red(picture):
    """The person's box in thousandths of the picture (left, top, right, bottom), of two parts the wider; else None."""
    image = cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR)
    red = (image[..., 2] > 170) & (image[..., 0] < 45)
    count, _, stats, _ = cv2.connectedComponentsWithStats(red.astype(np.uint8))
    parts = [row for row in stats[1:count].tolist() if row[4] > 20]
    if not parts:
        return None
    x, y, w, h, _ = max(parts, key=lambda row: row[2])
    high, wide = red.shape
    return [round(1000 * v) for v in (x / wide, y / high, (x + w) / wide, (y + h) / high)]


def shown(parts):
    """The pictures of a message with the frame that the line before each says: [(frame, line, picture)]."""
    found = []
    for line, part in pairwise(parts):
        if isinstance(part, Picture):
            found.append((int(re.search(r'"frame_id":"(\d{6})"', line)[1]), line, part))
    return found


def red_eyes(answer=2):
    """A script that plays each stage of each baseline by what the pictures show; it sees best where most is seen."""

    def script(messages, n):
        parts = messages[1].parts
        last = parts[-1].rsplit("\n", 1)[-1]
        if last == "Your facts, as one JSON object:":
            return json.dumps({"reasoning": ["the person is red"]})
        if last == "Your choice of answer, as one JSON object:":
            return json.dumps({"answer": answer})
        seen = [(box, frame) for frame, _, picture in shown(parts) if (box := seen_red(picture)) is not None]
        box, frame = max(seen, key=lambda pair: (pair[0][2] - pair[0][0], -pair[1]))
        return final(answer, box, frame) if last == "Your answer, as one JSON object:" else proposal(box, frame)

    return script
