"""The reference agent: it plans, looks, writes what it sees, and answers by its world model.

`method` is the method in its four variants. `planning` gets the plan. `loop` plays the turns of a question, and `turns`
reads and writes a turn. `world_memory` is the memory in the world model, with the tools of `tools`. `chat_memory` is
the memory in a chat history.
"""
