"""REINFORCE in numpy: `python reinforce.py STORE` trains a policy that looks once, then answers, on verified rewards.

It shows the loop, not a good policy: it sees neither picture nor question, only the kind of answer.
"""

import sys

import gymnasium
import numpy as np

ENVIRONMENT = "jrdb_avr.engine.integrations.gymnasium:JRDBAVR-v0"
MODES = ("multiple_choice", "frame", "span", "frame_viewpoint", "number")
PLACES = np.linspace(0, 1, 4)
"""What each part of an action may be; of four choices these are the four."""

PARTS = ("frame", "angle", "first", "second")


def probabilities(logits):
    powers = np.exp(logits - logits.max(axis=-1, keepdims=True))
    return powers / powers.sum(axis=-1, keepdims=True)


def moves(act, drawn):
    """Return an action of every environment; the box is the whole picture."""
    frame, angle, first, second = PLACES[drawn].T
    count = len(drawn)
    box, numbers = np.tile([0.0, 0.0, 1.0, 1.0], (count, 1)), np.stack([first, second], axis=1)
    return {"act": np.full(count, act), "frame": frame, "angle": angle, "numbers": numbers, "box": box}


def train(store, updates=20, count=4, rate=1.0, seed=0, **options):
    """Train on the questions of a store; returns the logits (modes, parts, places) and each update's mean reward."""
    random = np.random.default_rng(seed)
    logits, baseline, rewards = np.zeros((len(MODES), len(PARTS), len(PLACES))), 0.0, []
    envs = gymnasium.make_vec(
        ENVIRONMENT, num_envs=count, vectorization_mode="sync", store=store, budget=1, reward="answer", **options
    )
    for update in range(updates):
        _, info = envs.reset(seed=[seed + update * count + place for place in range(count)])
        mode = np.array([MODES.index(name) for name in info["answer_mode"]])
        policy = probabilities(logits[mode])
        drawn = (random.random((count, len(PARTS), 1)) > policy.cumsum(axis=2)[..., :-1]).sum(axis=2)
        envs.step(moves(0, drawn))
        _, reward, *_ = envs.step(moves(1, drawn))
        # The gradient of a draw's log-probability is what was drawn less what was likely.
        gradient = (np.arange(len(PLACES)) == drawn[..., None]) - policy
        np.add.at(logits, mode, rate * (reward - baseline)[:, None, None] * gradient / count)
        baseline += 0.1 * (reward.mean() - baseline)
        rewards.append(float(reward.mean()))
    envs.close()
    return logits, rewards


if __name__ == "__main__":
    for number, reward in enumerate(train(sys.argv[1])[1], start=1):
        print(f"update {number}: mean reward {reward:.2f}")
