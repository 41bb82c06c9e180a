"""The simulated model: a server that answers by reading marks from the pictures it is sent, and nothing else.

It speaks the chat-completions protocol, with function calling, and is stateless: each request holds the history of
a question. It knows nothing that is not in the pixels or in the prompt.

    knobs, confusion     its imperfections, and the profiles that set them
    perception           the marks of a picture, as far as the knobs let it read them
    requests, tools      a request as stage, question and sightings; function calls
    same_person          who is the same person in several pictures, where there are no identities
    play, facts          the stages of the baselines, by the policy of `agent.policy`; facts of the chain of thought
    play_agent, notes    the reference agent: what it reads goes into the agent's graph, and is read back from there
    noise, server        faults of replies; the socket
"""
