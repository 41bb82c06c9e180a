"""The reference agent: it plans a graph query, looks, and answers by what it saw.

`method` is the method in its four variants and three policies; `planning` gets the plan and checks its labels.
Where the harness finds the looks, `driven` plays a question: `perceive` and `recognize` ask the model about a picture,
`guided` lets it pick among looks, and `belief_writer` writes the readings into the world model.
Where the model makes every call, `episode` plays a question turn by turn within its limits, and `tool_calls` reads and
writes a turn; `graph_memory` keeps what was seen in the world model and solves the plan over it, and `chat_memory` is
the chat history in its place.
"""
