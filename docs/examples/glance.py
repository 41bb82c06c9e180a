"""A method in forty lines: one look straight ahead, one question to the model, its box in that picture."""

from jrdb_avr.agent.methods.attempt import Attempt, ParsedReply, on_crop
from jrdb_avr.agent.methods.requests import heading
from jrdb_avr.agent.model.conventions import CONTRACT
from jrdb_avr.agent.model.messages import Message, metadata_line, picture_of
from jrdb_avr.agent.model.prompts import mode_text
from jrdb_avr.schema.errors import DecodeError

RULES = """Answer a question about people in a video from one picture of it, with one JSON object:
{"answer": %s, "evidence_bboxes": [{"frame_id": "000150", "bbox": [x1, y1, x2, y2]}]}
The answer: %s The box is round the person asked about, in whole thousandths of the picture."""


class Glance:
    """Sees one crop of the middle frame, whatever is asked."""

    name = "glance"

    def __init__(self, chat):
        self.chat = chat

    def settings(self):
        return {"looks": 1}

    def answer(self, task):
        attempt = Attempt(task, self.chat, CONTRACT)
        frames = task.sequence.frames
        seen = attempt.look(frames[len(frames) // 2], 180.0)
        text = mode_text(task)
        messages = [
            Message("system", (RULES % (text.form, text.rule),)),
            Message("user", (heading(task.question), f"Crop: {metadata_line(seen)}", picture_of(seen))),
        ]
        try:
            reply = attempt.ask_object(messages, attempt.final_schema([seen.frame_index]))
            return attempt.prediction(attempt.parse_final(reply, on_crop(seen)))
        except DecodeError as error:
            return attempt.prediction(ParsedReply(faults=(str(error),)))
