"""The marker model: a server that reads marks from the pictures it is sent, and nothing else.

It speaks the chat-completions protocol and is stateless: each request holds the whole history of a question.
`reading` turns a request into a stage, a question and sightings; `stages` is the table of the stages' plays; `eyes`
says what has been seen and what to look at next, `finding`, `hops` and `policy` find the person and read the answer for
all of them; `server` is the socket. As the reference agent (`agency`) it keeps what it reads in the agent's graph, from
which `notes` and `memory` make looks again. What is not in the pixels or in the prompt is not known here.
"""
