"""The tasks for lmms-eval say what the methods say, read replies as they do, and lead back into a store."""

import importlib.util
import json

import pytest
import yaml
from asked_world import QUESTIONS_ASKED
from entry import run
from scripted import Chat, final

from jrdb_avr.agent.methods.attempt import PANORAMAS
from jrdb_avr.agent.model.conventions import CONTRACT
from jrdb_avr.agent.model.messages import Picture
from jrdb_avr.engine.integrations.lmms_eval import FixedContextTask
from jrdb_avr.engine.run.bench import Bench
from jrdb_avr.engine.run.imported import import_predictions
from jrdb_avr.engine.run.methods import make_method
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.schema.answers import Evidence, decode_answer
from jrdb_avr.schema.errors import StoreError

BOX = [100, 200, 150, 700]


@pytest.fixture(scope="module")
def tasks(asked_world, tmp_path_factory):
    """The folder that the command writes, and its functions as lmms-eval imports them."""
    folder = tmp_path_factory.mktemp("lmms") / "tasks"
    code, out, err = run("export", "--store", asked_world / "store", "--lmms-eval", folder)
    assert (code, out) == (0, ""), err
    spec = importlib.util.spec_from_file_location("utils", folder / "utils.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return folder, module


@pytest.fixture(scope="module")
def docs(tasks):
    return read_table(tasks[0] / "questions" / "questions.parquet").to_pylist()


def configs(folder):
    """Each task's YAML with the names of its functions, resolved as lmms-eval does: FILE.FUNCTION."""

    class Loader(yaml.SafeLoader):
        pass

    Loader.add_constructor("!function", lambda loader, node: ("function", loader.construct_scalar(node)))
    return [yaml.load(path.read_text(), Loader) for path in sorted(folder.glob("*.yaml"))]


def played(asked_world, method, doc, replies):
    """What `evaluate` would send for a question, and the prediction."""
    chat = Chat(replies)
    bench = Bench.open(Store(asked_world / "store"), questions=[doc["question_id"]])
    return make_method(method, chat, CONTRACT).answer(bench.task(doc["question_id"])), chat.sent


def same_messages(sent, messages):
    assert [message.role for message in sent] == [message["role"] for message in messages]
    for message, own in zip(sent, messages, strict=True):
        assert own["content"] == [
            {"type": "image", "url": part.data} if isinstance(part, Picture) else {"type": "text", "text": part}
            for part in message.parts
        ]


def test_the_yaml_names_functions_and_data_that_there_are(tasks, docs):
    folder, module = tasks
    one, two = configs(folder)
    assert [one["task"], two["task"]] == ["jrdb_avr_chain_of_thought", "jrdb_avr_monolithic"]
    for config in (one, two):
        metrics = [metric["aggregation"] for metric in config["metric_list"]]
        named = [value for value in [*config.values(), *metrics] if isinstance(value, tuple)]
        assert len(named) == 5
        for _, name in named:
            file, function = name.split(".")
            assert file == "utils" and callable(getattr(module, function))
        data = config["dataset_kwargs"]["data_files"]["test"]
        assert (folder / data).is_file() and config["test_split"] == "test"
        assert config["doc_to_target"] in docs[0]
        # An empty line within a reply must not end it, as lmms-eval's default has it.
        assert config["generation_kwargs"]["until"] == []
    assert [picture.size for picture in module.monolithic_doc_to_visual(docs[0])] == [(3760, 480)] * PANORAMAS
    # Questions of sequences with panoramas alone.
    assert {doc["question_id"] for doc in docs} == {question.question_id for question in QUESTIONS_ASKED}
    assert not list(folder.rglob("answers*")) and not list(folder.rglob("evidence*"))


@pytest.mark.parametrize("reply", [final(2, BOX, 45), final(9, BOX, 45), final(2, BOX, 15), "no JSON", ""])
def test_monolithic_asks_and_reads_as_the_method_does(asked_world, tasks, docs, reply):
    task = FixedContextTask("monolithic", tasks[0], asked_world / "images", "", bytes)
    # The second reply says nothing: lmms-eval asks once.
    prediction, sent = played(asked_world, "monolithic", docs[0], [reply, ""])
    same_messages(sent[0], task.doc_to_messages(docs[0]))
    texts = [part for message in sent[0] for part in message.parts if isinstance(part, str)]
    assert task.doc_to_text(docs[0]) == "\n\n".join(texts)
    assert task.doc_to_visual(docs[0]) == [part.data for part in sent[0][1].parts if isinstance(part, Picture)]
    found = task.process_results(docs[0], [reply])
    line = json.loads(found["predictions"])
    assert found["readable"] == (prediction.status == "answered") and line["question_id"] == docs[0]["question_id"]
    assert line.get("status", "answered") == prediction.status and line.get("raw", "") == reply
    answer = line.get("answer")
    assert (answer and decode_answer("multiple_choice", json.dumps(answer))) == prediction.answer
    evidence = line.get("evidence")
    assert (evidence and Evidence(evidence["frame"], tuple(evidence["box"]))) == prediction.evidence


FACTS = json.dumps({"reasoning": ["one stands", "one walks"]})


@pytest.mark.parametrize(
    "replies",
    [
        [FACTS, final(2, BOX, 45)],
        ["no facts", FACTS, final(2, BOX, 45)],
        ["no facts", "none again", "no JSON", final(1, BOX, 45)],
    ],
)
def test_chain_of_thought_goes_on_until_the_method_ends(asked_world, tasks, docs, replies):
    """The rounds of models that get messages, and of those that get text, are the calls of the method."""
    task = FixedContextTask("chain-of-thought", tasks[0], asked_world / "images", "", bytes)
    doc = docs[0]
    prediction, sent = played(asked_world, "chain-of-thought", doc, replies)
    assert len(sent) == len(replies)
    same_messages(sent[0], task.doc_to_messages(doc))
    assert sent[0][0].parts[0] in task.doc_to_text(doc, lmms_eval_specific_kwargs=None)
    for n in range(1, len(replies) + 1):
        kwargs = {"round_idx": n, "previous_output": replies[:n], "previous_round_info": None}
        messages, over, outputs, _ = task.doc_to_messages(doc, **kwargs)
        visuals, text, ended, kept, _ = task.doc_to_text(doc, lmms_eval_specific_kwargs=None, **kwargs)
        assert (over, ended, outputs, kept) == (n == len(replies), n == len(replies), replies[:n], replies[:n])
        if not over:
            same_messages(sent[n], messages)
            assert len(visuals) == PANORAMAS and sent[n][1].parts[-1] in text
    # Models return the rounds as a list or a tuple.
    for rounds in ([replies], [tuple(replies)]):
        line = json.loads(task.process_results(doc, rounds)["predictions"])
        assert line["answer"] == {"choice": prediction.answer.choice} and line["n_model_calls"] == len(replies)


def test_predictions_lead_back_into_a_store(asked_world, tasks, docs, store, tmp_path):
    _, module = tasks

    class Arguments:
        output_path = str(tmp_path / "logs")

    found = [module.monolithic_process_results(doc, [final(2, BOX, 45)])["predictions"] for doc in docs]
    assert module.monolithic_write_predictions(found, args=Arguments) == len(docs)
    path = tmp_path / "logs" / "submissions" / "jrdb_avr_monolithic.jsonl"
    run_id = import_predictions(store, path)
    table = read_table(store.run_path(run_id) / "predictions.parquet")
    assert table["answer"].to_pylist() == ['{"choice":2}'] * len(docs)
    assert set(table["evidence_frame"].to_pylist()) == {45}


def test_the_tasks_need_a_folder_of_their_own_and_panoramas(asked_world, tasks, tmp_path):
    code, _, err = run("export", "--store", asked_world / "store", "--lmms-eval", tasks[0])
    assert code == 1 and "not empty" in err
    with pytest.raises(StoreError, match="no selected question"):
        FixedContextTask("monolithic", tasks[0], tmp_path, "", bytes)
