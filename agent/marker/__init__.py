"""The marker model: a server that reads marks from the pictures it is sent, and nothing else.

It speaks the chat-completions protocol and is stateless: each request holds the whole history of a question.
`reading` turns a request into a task and sightings, `eyes` says what has been seen and what to look at next, `finding`
and `policy` play the question, `server` is the socket. What is not in the pixels or in the prompt is not known here.
"""
