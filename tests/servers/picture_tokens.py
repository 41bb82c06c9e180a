"""Compare the picture tokens that `transformers serve` counts with those of the program (`docs/servers.md`).

    python3 -m venv servers
    servers/bin/pip install torch==2.14.1 torchvision==0.29.1 'transformers[serving]==5.24.0' gguf==0.19.0
    servers/bin/python tests/servers/qwen.py weights
    python tests/servers/picture_tokens.py servers/bin weights

`qwen.py` makes a tiny Qwen3-VL with random weights. The server listens on 127.0.0.1 alone and ends with the script.
"""

import argparse
from pathlib import Path

from check import Transformers

from jrdb_avr.agent.model.messages import Message
from jrdb_avr.agent.model.probes import CROP_SIZE, PANORAMA_SIZE, drawn_picture

MODEL = "qwen3-vl-random"


class Qwen(Transformers):
    """The server with the tiny Qwen3-VL."""

    def command(self, folder, kind):
        command = super().command(folder, kind)
        return [*command[:2], MODEL, *command[3:]]


def main(programs, weights, port):
    """Print the tokens that each picture adds to a prompt, beside those of the program."""
    server = Qwen(programs, weights, weights, port)
    with server.running("seeing"):
        client = server.client(MODEL, response_format="none")
        sizes = {"crop": CROP_SIZE, "panorama": PANORAMA_SIZE}
        parts = {"no picture": (), **{name: (drawn_picture(size, None),) for name, size in sizes.items()}}
        counts = {
            name: client.probe([Message("user", ("Reply with one word: ready", *shown))]).prompt_tokens
            for name, shown in parts.items()
        }
    for name, size in sizes.items():
        added, computed = counts[name] - counts["no picture"], client.convention.picture_tokens(*size)
        print(f"{server.name}, {name} {size[0]}x{size[1]}: {added} tokens, computed {computed} and 2 delimiters")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("programs", type=Path)
    parser.add_argument("weights", type=Path)
    parser.add_argument("--port", type=int, default=8765)
    main(**vars(parser.parse_args()))
