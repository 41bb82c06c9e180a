"""A host of tools, as agents have one: the simulated model calls functions, and whoever has them carries them out."""

import base64
import json
import urllib.request

OBSERVE = {"frame_id": {"type": "string"}, "angle_deg": {"type": "number"}}
SUBMIT = {"answer": {}, "evidence_bboxes": {"type": "array"}}
TOOLS = [
    {"type": "function", "function": {"name": name, "parameters": {"type": "object", "properties": properties}}}
    for name, properties in (("observe", OBSERVE), ("submit_answer", SUBMIT))
]


def complete(url, messages):
    body = json.dumps({"model": "marker", "messages": messages, "tools": TOOLS}).encode()
    request = urllib.request.Request(f"{url}/chat/completions", body, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=60) as reply:
        return json.load(reply)["choices"][0]["message"]


async def play(url, prompt, call, most=60):
    """Let the model play a question: `await call(name, arguments)` gives a result's text and picture, JPEG or None.

    Ends with the answer, and returns how many calls were made.
    """
    messages = [{"role": "user", "content": prompt}]
    for made in range(1, most):
        message = complete(url, messages)
        messages.append(message)
        (wanted,) = message["tool_calls"]
        name = wanted["function"]["name"]
        text, jpeg = await call(name, json.loads(wanted["function"]["arguments"]))
        if name == "submit_answer":
            return made
        content = [{"type": "text", "text": text}]
        if jpeg is not None:
            uri = "data:image/jpeg;base64," + base64.b64encode(jpeg).decode()
            content.append({"type": "image_url", "image_url": {"url": uri}})
        messages.append({"role": "tool", "tool_call_id": wanted["id"], "content": content})
    raise AssertionError("no answer")
