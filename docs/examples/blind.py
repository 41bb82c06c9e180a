"""A method that never looks: what can be had from the words of a question alone. Nothing of it needs a model."""

from jrdb_avr.schema.answers import Choice, FrameAnswer, FrameViewpoint, Number, Span
from jrdb_avr.schema.method import Prediction


class Blind:
    """The first choice, the middle of the video, straight ahead, ten of whatever is counted."""

    name = "blind"

    def __init__(self, chat=None):
        pass

    def settings(self):
        return {"guesses": "first choice, middle frame, 180 degrees, 10"}

    def answer(self, task):
        middle, last = task.sequence.frame_count // 2, task.sequence.frame_count - 1
        guess = {
            "multiple_choice": Choice(1),
            "frame": FrameAnswer(middle),
            "span": Span(middle // 2, min(middle + middle // 2, last)),
            "frame_viewpoint": FrameViewpoint(middle, 180.0),
            "number": Number(10.0),
        }
        # It has no box to give, so its evidence does not score.
        return Prediction(status="answered", answer=guess[task.question.answer_mode])
