"""The simulated model: a server that answers by reading marks from the pictures it is sent, and nothing else.

It speaks the chat-completions protocol and is stateless: each request holds the whole history of a question. `knobs`
lists its imperfections; `perception` reads the marks of a picture, as far as they allow; `requests` parses a request
into a stage, a question and sightings, with `same_person` where there are no identities; `play` and `play_agent` play
the stages with the policy of `agent.policy`; as the reference agent it stores what it reads in the agent's graph, which
`notes` reads back; `noise` spoils replies; `server` is the socket. It knows nothing that is not in the pixels or in the
prompt.
"""
