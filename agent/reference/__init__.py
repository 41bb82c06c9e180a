"""The reference agent: a plan, a loop over tools that look and remember, and a solver that reads the answer.

`planning` gets the plan, `calls` reads a turn, `episode` plays a question, `remembering` keeps what was seen in the
world model (and `chat` in a chat history, for the ablation), `shown` says what a turn shows, `method` is the method.
"""
