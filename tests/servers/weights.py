"""Write a tiny vision-language model twice: as a folder for transformers, and as two GGUF files for llama.cpp.

    python weights.py FOLDER [--reply TEXT]

FOLDER/qwen3.5-random/      a LLaVA model of 2 + 2 layers, its tokenizer and its chat template
FOLDER/text-random/         the same without eyes, and with a chat template that refuses the system role
FOLDER/qwen3.5-random.gguf, FOLDER/mmproj.gguf      the first one

The weights are random but for a few entries: without a grammar the model replies TEXT (by default the answer of a
fixed-context method) and ends, after a line of thinking where the template makes it think; under a grammar it ends
every part as soon as it may. Its name is that of a family whose thinking a request can switch. Nothing is fetched.

It runs where torch, transformers, tokenizers and gguf are installed, and imports nothing of the package.
"""

import argparse
import json
import os
from pathlib import Path

os.environ["HF_HUB_OFFLINE"] = "1"

import gguf
import numpy as np
import tokenizers
import torch
from transformers import (
    CLIPImageProcessorPil,
    CLIPVisionConfig,
    LlamaConfig,
    LlamaForCausalLM,
    LlavaConfig,
    LlavaForConditionalGeneration,
    LlavaProcessor,
    PreTrainedTokenizerFast,
)

PROMPTS = Path(__file__).parents[2] / "agent" / "prompts"
REPLY = '{"answer": 1, "evidence_bboxes": [{"frame_id": "000000", "bbox": [100, 200, 300, 400]}]}'
THOUGHT = "The pictures decide.\n"
END, START, PICTURE, THINK, THOUGHT_ENDS = "<|im_end|>", "<|im_start|>", "<image>", "<think>\n", "</think>\n\n"

HIDDEN, HEADS, LAYERS, WIDTH, CONTEXT = 64, 4, 2, 128, 65536
EYE, PATCH, CHANNELS = 56, 14, 32

TEMPLATE = (
    "{%- for message in messages -%}"
    "REFUSAL{{ '<|im_start|>' + message['role'] + '\\n' }}"
    "{%- if message['reasoning_content'] is string -%}"
    "{{ '<think>\\n' + message['reasoning_content'] + '\\n</think>\\n\\n' }}{%- endif -%}"
    "{%- if message['content'] is string -%}{{ message['content'] }}"
    "{%- else -%}{%- for part in message['content'] -%}"
    "{%- if part['type'] == 'image' -%}<image>{%- else -%}{{ part['text'] }}{%- endif -%}"
    "{%- endfor -%}{%- endif -%}{{ '<|im_end|>\\n' }}"
    "{%- endfor -%}"
    "{%- if add_generation_prompt -%}{{ '<|im_start|>assistant\\n<think>\\n' }}"
    "{%- if enable_thinking is defined and not enable_thinking -%}{{ '\\n</think>\\n\\n' }}{%- endif -%}{%- endif -%}"
)
REFUSAL = "{%- if message['role'] == 'system' -%}{{ raise_exception('System role not supported') }}{%- endif -%}"


def tokenizer_of(reply):
    """A byte-level tokenizer of the prompts, with the model's few own tokens."""
    inner = tokenizers.Tokenizer(tokenizers.models.BPE())
    inner.pre_tokenizer = tokenizers.pre_tokenizers.ByteLevel(add_prefix_space=False)
    inner.decoder = tokenizers.decoders.ByteLevel()
    trainer = tokenizers.trainers.BpeTrainer(
        vocab_size=1500, initial_alphabet=tokenizers.pre_tokenizers.ByteLevel.alphabet(), show_progress=False
    )
    inner.train_from_iterator((path.read_text() for path in sorted(PROMPTS.glob("*.md"))), trainer)
    # In the prompts and replies these words stand for themselves; the reply and the thinking are one token each.
    inner.add_special_tokens([END, START, PICTURE])
    inner.add_tokens([tokenizers.AddedToken(text, normalized=False) for text in (THINK, THOUGHT_ENDS, THOUGHT, reply)])
    return PreTrainedTokenizerFast(
        tokenizer_object=inner, eos_token=END, pad_token=END, extra_special_tokens={"image_token": PICTURE}
    )


def steer(table, head, ids, reply):
    """Set the embeddings and output weights that lead from a prompt to its reply, and a grammar's text to its end."""
    table[:, :6] = 0
    head[:, :6] = 0
    # A constant that the layers hardly change carries what is likely anywhere.
    table[:, 0] = 4
    likely = dict(zip('}],":0123456789[{', np.arange(3, 1, -0.1), strict=False))
    for text, weight in likely.items():
        head[ids[text], 0] = weight
    for token, number in ids.items():
        if not token.strip("\u0120\u010a\u0109"):
            # Grammars allow blanks, which would never end.
            head[number, 0] = -2
    for place, (before, after) in enumerate(
        [(THINK, THOUGHT), (THOUGHT, THOUGHT_ENDS), (THOUGHT_ENDS, reply), (reply, END)], 1
    ):
        table[ids[before], place] = 8
        head[ids[after], place] = 4
    # Where a grammar wants an end nothing else is possible.
    head[ids[END], 0] = 1


def models(tokenizer, reply):
    """The model with eyes and the one without, with random weights of a fixed seed."""
    torch.manual_seed(0)
    ids = tokenizer.get_vocab()
    text = LlamaConfig(
        vocab_size=len(ids),
        hidden_size=HIDDEN,
        intermediate_size=WIDTH,
        num_hidden_layers=LAYERS,
        num_attention_heads=HEADS,
        num_key_value_heads=HEADS,
        max_position_embeddings=CONTEXT,
        tie_word_embeddings=False,
        bos_token_id=None,
        eos_token_id=ids[END],
        pad_token_id=ids[END],
    )
    vision = CLIPVisionConfig(
        hidden_size=CHANNELS,
        intermediate_size=2 * CHANNELS,
        num_hidden_layers=LAYERS,
        num_attention_heads=2,
        image_size=EYE,
        patch_size=PATCH,
        projection_dim=CHANNELS,
    )
    seeing = LlavaForConditionalGeneration(
        LlavaConfig(
            vision_config=vision, text_config=text, image_token_id=ids[PICTURE], image_seq_length=(EYE // PATCH) ** 2
        )
    )
    blind = LlamaForCausalLM(text)
    for model in (seeing, blind):
        model.generation_config.eos_token_id = ids[END]
        with torch.no_grad():
            steer(model.get_input_embeddings().weight, model.get_output_embeddings().weight, ids, reply)
    return seeing.eval(), blind.eval()


def write_text_gguf(path, model, tokenizer):
    """The language model as GGUF."""
    ids = tokenizer.get_vocab()
    added = {token.content: token.special for token in tokenizer.added_tokens_decoder.values()}
    writer = gguf.GGUFWriter(path, "llama")
    writer.add_name("random")
    writer.add_context_length(CONTEXT)
    writer.add_embedding_length(HIDDEN)
    writer.add_block_count(LAYERS)
    writer.add_feed_forward_length(WIDTH)
    writer.add_head_count(HEADS)
    writer.add_head_count_kv(HEADS)
    writer.add_rope_dimension_count(HIDDEN // HEADS)
    writer.add_layer_norm_rms_eps(model.config.text_config.rms_norm_eps)
    writer.add_file_type(gguf.LlamaFileType.ALL_F32)
    writer.add_tokenizer_model("gpt2")
    writer.add_tokenizer_pre("gpt-2")
    tokens = sorted(ids, key=ids.get)
    kinds = {True: gguf.TokenType.CONTROL, False: gguf.TokenType.USER_DEFINED, None: gguf.TokenType.NORMAL}
    writer.add_token_list(tokens)
    writer.add_token_types([kinds[added.get(token)] for token in tokens])
    merges = json.loads(tokenizer.backend_tokenizer.to_str())["model"]["merges"]
    writer.add_token_merges([" ".join(pair) for pair in merges])
    writer.add_eos_token_id(ids[END])
    writer.add_add_bos_token(False)
    writer.add_chat_template(TEMPLATE.replace("REFUSAL", ""))
    names = gguf.TensorNameMap(gguf.MODEL_ARCH.LLAMA, LAYERS)
    parts = {"model." + name: part for name, part in model.model.language_model.state_dict().items()}
    for name, part in {**parts, "lm_head.weight": model.lm_head.weight.detach()}.items():
        value = part.float().numpy()
        if name.endswith(("q_proj.weight", "k_proj.weight")):
            # llama.cpp rotates neighbouring numbers of a head, transformers its halves.
            value = value.reshape(HEADS, 2, -1, HIDDEN).swapaxes(1, 2).reshape(value.shape)
        writer.add_tensor(names.get_name(name, (".weight",)), np.ascontiguousarray(value))
    finish(writer)


def write_vision_gguf(path, model):
    """The eyes and the projector as llama.cpp's `mmproj` file."""
    writer = gguf.GGUFWriter(path, "clip")
    writer.add_bool("clip.has_vision_encoder", True)
    writer.add_string("clip.projector_type", "mlp")
    writer.add_file_type(gguf.LlamaFileType.ALL_F32)
    writer.add_uint32("clip.vision.image_size", EYE)
    writer.add_uint32("clip.vision.patch_size", PATCH)
    writer.add_uint32("clip.vision.embedding_length", CHANNELS)
    writer.add_uint32("clip.vision.feed_forward_length", 2 * CHANNELS)
    writer.add_uint32("clip.vision.projection_dim", HIDDEN)
    # The projector takes the layer before the last.
    writer.add_uint32("clip.vision.block_count", LAYERS - 1)
    writer.add_uint32("clip.vision.attention.head_count", 2)
    writer.add_float32("clip.vision.attention.layer_norm_epsilon", 1e-5)
    writer.add_array("clip.vision.image_mean", [0.48, 0.46, 0.41])
    writer.add_array("clip.vision.image_std", [0.27, 0.26, 0.28])
    writer.add_bool("clip.use_gelu", False)
    names = gguf.TensorNameMap(gguf.MODEL_ARCH.MMPROJ, LAYERS - 1)
    tower = {
        "vision_tower.vision_model." + k.removeprefix("vision_model."): v
        for k, v in model.model.vision_tower.state_dict().items()
    }
    projector = {"multi_modal_projector." + k: v for k, v in model.model.multi_modal_projector.state_dict().items()}
    for name, part in {**tower, **projector}.items():
        if f"layers.{LAYERS - 1}." in name or "position_ids" in name or "post_layernorm" in name:
            continue
        plain = {"multi_modal_projector.linear_1": "mm.0", "multi_modal_projector.linear_2": "mm.2"}
        base, _, end = name.rpartition(".")
        written = f"{plain[base]}.{end}" if base in plain else names.get_name(name, (".weight", ".bias"))
        writer.add_tensor(written, part.float().numpy())
    finish(writer)


def finish(writer):
    writer.write_header_to_file()
    writer.write_kv_data_to_file()
    writer.write_tensors_to_file()
    writer.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--reply", default=REPLY)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    tokenizer = tokenizer_of(given.reply)
    seeing, blind = models(tokenizer, given.reply)
    template = TEMPLATE.replace("REFUSAL", "")
    processor = LlavaProcessor(
        CLIPImageProcessorPil(size={"shortest_edge": EYE}, crop_size={"height": EYE, "width": EYE}),
        tokenizer,
        patch_size=PATCH,
        vision_feature_select_strategy="default",
        image_token=PICTURE,
        num_additional_image_tokens=1,
        chat_template=template,
    )
    tokenizer.chat_template = template
    seeing.save_pretrained(given.folder / "qwen3.5-random")
    processor.save_pretrained(given.folder / "qwen3.5-random")
    write_text_gguf(given.folder / "qwen3.5-random.gguf", seeing, tokenizer)
    write_vision_gguf(given.folder / "mmproj.gguf", seeing)
    # Another one: the first has been marked as part of a processor.
    plain = tokenizer_of(given.reply)
    plain.chat_template = TEMPLATE.replace("REFUSAL", REFUSAL)
    blind.save_pretrained(given.folder / "text-random")
    plain.save_pretrained(given.folder / "text-random")


if __name__ == "__main__":
    main()
