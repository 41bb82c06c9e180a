"""The reference agent: a plan, a loop over tools that look and remember, and a solver that reads the answer.

`method` is the method in its four variants, `limits` its budgets. `planning` gets the plan, whose `labels` it checks;
`episode` plays a question turn by turn, `calls` reads what a turn says, `shown` and `prompts` write what it shows.
`remembering` keeps what was seen in the world model and asks `solving`; `chat` is the chat history in its place.
"""
