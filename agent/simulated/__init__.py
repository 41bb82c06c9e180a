"""The simulated model: a server that answers from the annotations of a store, with errors as real models make them.

It speaks the chat-completions protocol, with function calling, and is stateless: each request holds the history of
a question. In a run that is declared simulated, each picture says which frame and angle it shows.

    profiles, noise      errors, and the profiles that set them
    sight, people        people of a frame, from the annotations
    recorded             a detector's readings in place of annotated boxes
    requests, tools      a request as stage, question and pictures; function calls
    fields               what is replied about each person of a picture
    brain                all stages of methods without a world model
    play_tools           turns of the agent with a world model
    server               the socket, and the checks of a server
"""
