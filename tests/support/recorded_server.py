"""The simulated model's server in this process, with the bodies of all requests that it gets."""

import contextlib
import threading

from jrdb_avr.agent.simulated.server import Server


@contextlib.contextmanager
def recorded_server():
    """Yield the server's address and the list of bodies, which grows."""
    server, sent = Server(), []
    reply = server.reply
    server.reply = lambda body: (sent.append(body), reply(body))[1]
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server.url, sent
    server.shutdown()
    server.server_close()
