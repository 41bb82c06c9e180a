"""The simulated model: a server that answers by reading marks from the pictures it is sent, and nothing else.

It speaks the chat-completions protocol and is stateless: each request holds the whole history of a question. `requests`
parses a request into a stage, a question and sightings; `play` and `play_agent` play the stages with the policy of
`agent.policy`; as the reference agent it stores what it reads in the agent's graph, which `notes` reads back; `server`
is the socket. It knows nothing that is not in the pixels or in the prompt.
"""
