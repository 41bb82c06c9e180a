"""The reference agent: a plan, a loop over tools that look and remember, and a solver that reads the answer.

`method` is the method in its four variants with the texts of its turns; `planning` gets the plan and checks its labels;
`episode` plays a question turn by turn within its limits; `tool_calls` reads and writes a turn. `graph_memory` keeps
what was seen in the world model and solves the plan over it; `chat_memory` is the chat history in its place.
"""
