"""Questions and runs in TRL itself, with a tiny random model that is made here."""

import runpy

import pytest
from environment import DOCS, needs

needs("trl", "PIL")

RUN = "react-simulated-perfect"


@pytest.fixture(scope="module")
def example():
    return runpy.run_path(str(DOCS / "examples" / "train_grpo.py"))


def test_the_example_trains_on_what_it_sees(example, small_demo):
    """The script itself asserts that the picture reaches the model and that parameters change."""
    scripted, *own, _ = example["main"](str(small_demo.folder / "store"), RUN)
    assert (scripted["reward"], scripted["tools/call_frequency"], scripted["tools/failure_frequency"]) == (
        0.5,
        2.0,
        0.0,
    )
    assert scripted["grad_norm"] > 0 and [entry["reward"] for entry in own] == [0.0, 0.0]


def test_the_model_reads_the_schemas_of_the_tools(small_demo):
    from transformers.utils import get_json_schema

    from jrdb_avr.engine.integrations.trl import Environments

    environment = Environments(small_demo.folder / "store", limit=1)()
    schemas = [get_json_schema(tool)["function"] for tool in (environment.observe, environment.submit_answer)]
    shapes = [one["parameters"] for one in schemas]
    assert [shape["required"] for shape in shapes] == [["frame_id", "angle_deg"], ["answer", "evidence_bboxes"]]
    look, answer = (shape["properties"] for shape in shapes)
    assert {name: kind["type"] for name, kind in look.items()} == {"frame_id": "string", "angle_deg": "number"}
    assert [kind["type"] for kind in answer["answer"]["anyOf"]] == ["integer", "object"]
    assert answer["evidence_bboxes"]["type"] == "array"


def test_the_supervised_trainer_reads_chats_with_pictures(example, small_demo, tmp_path):
    import torch
    from datasets import load_dataset
    from trl import SFTConfig, SFTTrainer

    from jrdb_avr.engine.integrations.chat import export_chat
    from jrdb_avr.queries.store import Store

    with pytest.warns(UserWarning, match="must not be trained on"):
        count = export_chat(Store(small_demo.folder / "store"), RUN, tmp_path / "chat")
    rows = load_dataset(
        "imagefolder", data_dir=str(tmp_path / "chat"), split="train", cache_dir=str(tmp_path / "cache")
    )
    assert len(rows) == count
    # A first turn has no picture yet.
    chosen = [i for i in range(10) if rows[i]["images"]][:2]
    processor = example["tiny_processor"]([part["text"] or "" for part in rows[0]["messages"][1]["content"]])
    model = example["tiny_model"](processor.tokenizer)
    before = {name: value.detach().clone() for name, value in model.named_parameters()}
    pixels = []
    model.register_forward_pre_hook(lambda _, __, inputs: pixels.append(inputs.get("pixel_values")), with_kwargs=True)
    options = SFTConfig(
        str(tmp_path / "sft"),
        max_steps=1,
        per_device_train_batch_size=2,
        max_length=None,
        learning_rate=1e-3,
        gradient_checkpointing=False,
        use_cpu=True,
        report_to="none",
        save_strategy="no",
    )
    trainer = SFTTrainer(model, args=options, train_dataset=rows.select(chosen), processing_class=processor)
    assert torch.isfinite(torch.tensor(trainer.train().training_loss))
    assert len(pixels) == 1 and pixels[0].abs().sum() > 0
    # Also the parameters of the part that reads the pictures.
    assert not any(torch.equal(before[name], value) for name, value in model.named_parameters())
