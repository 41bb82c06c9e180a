"""Write a tiny Qwen3-VL with random weights, whose image processor has the published settings.

    python qwen.py FOLDER

FOLDER/qwen3-vl-random/ is for `picture_tokens.py`, which says how to run both. Nothing is fetched.
"""

import argparse
from pathlib import Path

from transformers import (
    Qwen2VLImageProcessorPil,
    Qwen3VLConfig,
    Qwen3VLForConditionalGeneration,
    Qwen3VLProcessor,
    Qwen3VLVideoProcessor,
)
from weights import PICTURE, REPLY, TEMPLATE, tokenizer_of

START, STOP, VIDEO = "<|vision_start|>", "<|vision_end|>", "<|video_pad|>"
PIXELS = {"shortest_edge": 65_536, "longest_edge": 16_777_216}


def write(folder):
    """Write model, processor and chat template."""
    tokenizer = tokenizer_of(REPLY)
    tokenizer.add_special_tokens({"additional_special_tokens": [START, STOP, VIDEO]})
    names = {"vision_start": START, "image": PICTURE, "vision_end": STOP, "video": VIDEO}
    ids = {f"{name}_token_id": tokenizer.convert_tokens_to_ids(token) for name, token in names.items()}
    ends = {"eos_token_id": tokenizer.eos_token_id, "pad_token_id": tokenizer.eos_token_id}
    text = {"hidden_size": 64, "intermediate_size": 64, "num_hidden_layers": 1, "num_attention_heads": 4, **ends}
    text |= {"num_key_value_heads": 4, "head_dim": 16, "vocab_size": len(tokenizer)}
    text |= {"rope_parameters": {"rope_type": "default", "rope_theta": 1e6, "mrope_section": [4, 2, 2]}}
    vision = {"depth": 1, "hidden_size": 32, "intermediate_size": 32, "num_heads": 2, "out_hidden_size": 64}
    vision |= {"deepstack_visual_indexes": [0], "patch_size": 16, "spatial_merge_size": 2}
    model = Qwen3VLForConditionalGeneration(Qwen3VLConfig(text_config=text, vision_config=vision, **ids))
    model.save_pretrained(folder)
    settings = {"patch_size": 16, "merge_size": 2, "size": PIXELS}
    pictures, videos = Qwen2VLImageProcessorPil(**settings), Qwen3VLVideoProcessor(**settings)
    template = TEMPLATE.replace("REFUSAL", "").replace(PICTURE, START + PICTURE + STOP)
    Qwen3VLProcessor(pictures, tokenizer, videos, chat_template=template).save_pretrained(folder)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    write(parser.parse_args().folder / "qwen3-vl-random")
