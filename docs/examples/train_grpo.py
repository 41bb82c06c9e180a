"""GRPO with TRL on a CPU: `python train_grpo.py STORE RUN` trains a tiny random Qwen3-VL on a question of a store.

The model is made here and knows nothing, so the first group of rollouts is scripted: each looks as the run did last,
and every second one boxes a corner. The script asserts that their rewards differ, that the picture reaches the model
and that its parameters change. RUN is a run of `react` whose answer is right, as that of `jrdb-avr demo` is.
"""

import json
import os
import sys
import tempfile

os.environ |= {"HF_HUB_OFFLINE": "1", "TRL_EXPERIMENTAL_SILENCE": "1"}

import torch
from datasets import Dataset
from PIL import Image
from tokenizers import Tokenizer, decoders, models, pre_tokenizers, trainers
from transformers import (
    PreTrainedTokenizerFast,
    Qwen2VLImageProcessorPil,
    Qwen3VLConfig,
    Qwen3VLForConditionalGeneration,
    Qwen3VLProcessor,
)
from trl import GRPOConfig, GRPOTrainer
from trl.chat_template_utils import qwen3_vl_chat_template

import jrdb_avr as avr
from jrdb_avr.engine.integrations.trl import Environments

END, PAD = "<|im_end|>", "<|endoftext|>"
SPECIAL = [PAD, END, "<|im_start|>", "<|vision_start|>", "<|vision_end|>", "<|image_pad|>", "<|video_pad|>"]
GROUP, TOKENS = 2, 256


class Processor(Qwen3VLProcessor):
    """A processor without videos, which would need torchvision."""

    def check_argument_for_proper_class(self, name, argument):
        return None


class ScriptedModel(Qwen3VLForConditionalGeneration):
    """A model whose first generations are `turns`: each is a list of texts, one per rollout."""

    turns, tokenizer = (), None

    def generate(self, input_ids, **inputs):
        if not self.turns:
            return super().generate(input_ids, **inputs)
        texts = self.turns.pop(0)
        written = self.tokenizer(texts, padding=True, padding_side="right", return_tensors="pt").input_ids
        return torch.cat([input_ids, written], dim=1)


def tiny_processor(texts):
    inner = Tokenizer(models.BPE())
    inner.pre_tokenizer, inner.decoder = pre_tokenizers.ByteLevel(add_prefix_space=False), decoders.ByteLevel()
    trainer = trainers.BpeTrainer(vocab_size=1500, initial_alphabet=pre_tokenizers.ByteLevel.alphabet())
    inner.train_from_iterator(texts, trainer)
    inner.add_special_tokens(SPECIAL)
    tokenizer = PreTrainedTokenizerFast(tokenizer_object=inner, eos_token=END, pad_token=PAD)
    pictures = Qwen2VLImageProcessorPil(patch_size=16, size={"shortest_edge": 32 * 32, "longest_edge": 96 * 96})
    return Processor(pictures, tokenizer, chat_template=qwen3_vl_chat_template)


def tiny_model(tokenizer):
    ids, heads = tokenizer.get_vocab(), {"num_attention_heads": 2, "num_key_value_heads": 2, "head_dim": 16}
    rope = {"rope_type": "default", "rope_theta": 10000.0, "mrope_section": [4, 2, 2], "mrope_interleaved": True}
    text = {"vocab_size": len(ids), "hidden_size": 32, "intermediate_size": 64, "num_hidden_layers": 2, **heads}
    vision = {"depth": 2, "hidden_size": 32, "intermediate_size": 64, "num_heads": 2, "out_hidden_size": 32}
    torch.manual_seed(0)
    model = ScriptedModel(
        Qwen3VLConfig(
            text_config={**text, "rope_parameters": rope, "max_position_embeddings": 8192},
            vision_config={**vision, "num_position_embeddings": 64, "deepstack_visual_indexes": [0]},
            **{f"{name}_token_id": ids[f"<|{name}_pad|>"] for name in ("image", "video")},
            **{f"vision_{name}_token_id": ids[f"<|vision_{name}|>"] for name in ("start", "end")},
        )
    )
    model.tokenizer = tokenizer
    return model


def call(tool, **arguments):
    return f"<tool_call>\n{json.dumps({'name': tool, 'arguments': arguments})}\n</tool_call>{END}"


def script(store, run):
    """Return a question of the run, its last look, and the turns of a group: half play the run's last two moves."""
    query = "select question_id, response from steps where run_id = $run and kind = 'model' order by question_id, step"
    steps = avr.Store(store).sql(query, run=run).to_pylist()
    question_id = steps[0]["question_id"]
    moves = [json.loads(json.loads(step["response"])["content"]) for step in steps]
    last = next(i for i, move in enumerate(moves) if move.pop("action") == "answer")
    (box,) = moves[last]["evidence_bboxes"]
    corner = {**moves[last], "evidence_bboxes": [{**box, "bbox": [0, 0, 9, 9]}]}
    answers = [call("submit_answer", **(corner if i % 2 else moves[last])) for i in range(GROUP)]
    return (
        question_id,
        moves[last - 1],
        [[call("observe", **moves[last - 1])] * GROUP, answers, [f"Done.{END}"] * GROUP],
    )


def main(store, run, steps=3):
    question_id, look, turns = script(store, run)
    environments = Environments(store, questions=[question_id], budget=2)
    processor = tiny_processor([qwen3_vl_chat_template, environments.rows()[0]["prompt"][0]["content"]])
    model = tiny_model(processor.tokenizer)
    model.turns = turns
    before = {name: value.detach().clone() for name, value in model.named_parameters()}
    pixels = []
    model.register_forward_pre_hook(lambda _, __, inputs: pixels.append(inputs.get("pixel_values")), with_kwargs=True)
    with tempfile.TemporaryDirectory() as folder:
        options = GRPOConfig(
            folder,
            max_steps=steps,
            per_device_train_batch_size=GROUP,
            num_generations=GROUP,
            max_completion_length=TOKENS,
            generation_kwargs={"max_new_tokens": 16},  # what a random model writes is no call of a tool
            learning_rate=1e-3,
            gradient_checkpointing=False,
            logging_steps=1,
            use_cpu=True,
            report_to="none",
            save_strategy="no",
            disable_tqdm=True,
        )
        trainer = GRPOTrainer(
            model,
            args=options,
            train_dataset=Dataset.from_list(environments.rows()),
            environment_factory=environments,
            processing_class=processor,
        )
        trainer.train()
    first, *_ = trainer.state.log_history
    assert (first["rewards/QuestionEnvironment/mean"], first["reward_std"] > 0) == (0.5, True), first
    seen = avr.Bench.open(store).episode(question_id).observe(int(look["frame_id"]), look["angle_deg"])
    shown = processor.image_processor(images=[Image.fromarray(seen.image)], return_tensors="pt").pixel_values
    assert any(torch.equal(some, shown.repeat(GROUP, 1)) for some in pixels if some is not None), "no picture was seen"
    changed = sum(not torch.equal(before[name], value) for name, value in model.named_parameters())
    assert changed and all(value.isfinite().all() for value in model.parameters())
    print(f"{len(pixels)} forward passes, {sum(some is not None for some in pixels)} with pictures")
    print(f"{changed} of {len(before)} parameters changed")
    return trainer.state.log_history


if __name__ == "__main__":
    for entry in main(*sys.argv[1:3]):
        print({name: value for name, value in entry.items() if "reward" in name or "tools" in name})
