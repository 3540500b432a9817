"""Training comes to the same weights whatever kills it, with several processes too, and says what it was made from."""

import json
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from classifier.augmentation import augmented
from classifier.batches import Batch, ClipBatches, epoch_order
from classifier.checkpoint import load_model, save_model
from classifier.clips import ClipCache
from classifier.configuration import preset
from classifier.examples import read_examples
from classifier.learner import Loss, learning_rate
from classifier.network import VideoClassifier
from classifier.run_folder import RunFolder, read_checkpoint, read_run
from classifier.training import train, training_preset
from config.errors import RefusedInput
from ros_nodes.cli import app
from tests.classifier.drawn_campaign import drawn_campaign, example
from tests.classifier.training_job import EPOCHS, job, network, training

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return drawn_campaign(tmp_path_factory.mktemp("drawn") / "campaign", tests=24)


@pytest.fixture(scope="module")
def whole(folder, tmp_path_factory):
    """A training without a stop, guided by true displacement."""
    found = job(folder, tmp_path_factory.mktemp("whole") / "run")
    state = read_checkpoint(found.model.parent)
    assert state is not None and "guess.weight" in state["model"]
    return found


def _run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)


def _same_state(one: Path, other: Path) -> None:
    ours, theirs = read_checkpoint(one), read_checkpoint(other)
    assert ours is not None and theirs is not None
    assert ours["model"].keys() == theirs["model"].keys()
    for name, value in ours["model"].items():
        assert torch.equal(value, theirs["model"][name]), name
    for name, value in ours["averaged"].items():
        assert torch.equal(value, theirs["averaged"][name]), name
    for number, row in ours["optimiser"]["state"].items():
        for name, value in row.items():
            assert torch.equal(value, theirs["optimiser"]["state"][number][name]), (number, name)
    for key in ("train_loss", "validation_loss", "validation_accuracy", "learning_rate", "is_best"):
        assert [row[key] for row in ours["epochs"]] == [row[key] for row in theirs["epochs"]]


@pytest.mark.parametrize("average", [0.0, 0.5])
def test_the_mean_of_the_weights_is_what_is_kept(folder, tmp_path, average):
    found = job(folder, tmp_path / "run", epochs=1, average=average)
    state = read_checkpoint(tmp_path / "run")
    assert state is not None
    last = {name.removeprefix("model."): value for name, value in state["model"].items()}
    mean = last if average == 0.0 else state["averaged"]
    kept = load_model(found.model)[0].state_dict()
    for name, value in kept.items():
        # The last bias tells how much more passes weigh.
        assert name == "output.bias" or torch.equal(value, mean[name]), name
    if average > 0.0:
        assert not torch.equal(mean["fuse.weight"], last["fuse.weight"])


@pytest.mark.parametrize(("epoch", "share"), [(2, 0.5), (2, 2.0)], ids=["within", "between"])
def test_a_killed_training_goes_on_to_the_same_bits(folder, whole, tmp_path, epoch, share):
    killed = _run("-m", "tests.classifier.training_job", folder, tmp_path, "{}", epoch, share)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    done = 1 if share < 1.0 else 2
    assert len(read_run(tmp_path)["epochs"]) == done and not read_run(tmp_path)["finished"]
    resumed = job(folder, tmp_path)
    assert [row.number for row in resumed.epochs] == list(range(1, EPOCHS + 1))
    assert resumed.digest == whole.digest
    _same_state(tmp_path, whole.model.parent)
    assert (tmp_path / "model" / "model.pt").read_bytes() == (whole.model / "model.pt").read_bytes()
    assert (tmp_path / "model" / "model.json").read_bytes() == (whole.model / "model.json").read_bytes()


def test_a_kill_between_model_and_checkpoint_does_no_harm(folder, whole, tmp_path):
    # The best model of a later epoch is there, the checkpoint is not.
    shutil.copytree(whole.model, tmp_path / "model")
    state = json.loads((whole.model.parent / "run.json").read_text())
    (tmp_path / "run.json").write_text(json.dumps({**state, "finished": False, "epochs": []}))
    (tmp_path / "checkpoint.pt.part").write_bytes(b"half")
    assert job(folder, tmp_path).digest == whole.digest
    _same_state(tmp_path, whole.model.parent)


def test_a_finished_training_is_not_run_again(folder, whole):
    before = (whole.model.parent / "checkpoint.pt").stat().st_mtime_ns
    told = []
    config = {"network": network(), "training": training()}
    again = train(folder, whole.model.parent, **config, on_step=lambda *_: told.append(0))
    assert not told and again.digest == whole.digest and again.epochs == whole.epochs
    assert (whole.model.parent / "checkpoint.pt").stat().st_mtime_ns == before


def test_a_kill_after_the_last_checkpoint_leaves_only_words_to_be_written(folder, whole, tmp_path):
    out = tmp_path / "run"
    shutil.copytree(whole.model.parent, out)
    (out / "curves.png").unlink()
    state = read_run(out)
    (out / "run.json").write_text(json.dumps({**state, "finished": False, "epochs": [], "code": "older"}))
    assert job(folder, out).epochs == whole.epochs
    again = read_run(out)
    assert again["finished"] and again["epochs"] == state["epochs"] and (out / "curves.png").is_file()
    assert again["code"] == state["code"] and again["earlier_code"] == ["older"]


def test_two_processes_hold_the_same_weights_and_learn(folder, tmp_path):
    # Steps of two batches and of one: gradients are added up before they are shared.
    changes = {
        "epochs": 7,
        "batch": 2,
        "learning_rate": 1.0e-2,
        "augmentation": 0.0,
        "weight_decay": 1.0e-5,
        "warmup_epochs": 0.0,
    }
    launch = ("-m", "torch.distributed.run", "--standalone", "--nproc-per-node", 2)
    ended = _run(*launch, "-m", "tests.classifier.training_job", folder, tmp_path, json.dumps(changes))
    assert ended.returncode == 0, ended.stderr[-2000:]
    assert (tmp_path / "digest-0").read_text() == (tmp_path / "digest-1").read_text()
    rows = read_run(tmp_path)["epochs"]
    assert len(rows) == 7 and rows[-1]["train_loss"] < 0.95 * rows[0]["train_loss"]
    assert read_run(tmp_path)["processes"] == 2
    with pytest.raises(RefusedInput, match="by another number of processes"):
        job(folder, tmp_path, **changes)


def test_it_learns_what_slides_and_what_stands(folder, tmp_path):
    found = train(
        folder, tmp_path / "run", network=preset("compact", size_px=32, frames=4, base_width=4, lstm_units=8),
        training=training(epochs=15, learning_rate=1.0e-2), split="random",
    )  # fmt: skip
    assert found.best.validation_accuracy == 1.0
    assert found.best.validation_loss < 0.5 * found.epochs[0].validation_loss
    model, told = load_model(found.model)
    assert told["epoch"] == found.best.number and told["validation_accuracy"] == 1.0
    assert (tmp_path / "run" / "curves.png").read_bytes()[:4] == b"\x89PNG"
    examples = read_examples(folder)
    cache = ClipCache(folder / "clips", model.config)
    (batch,) = ClipBatches(cache, batch=99).batches([examples[k] for k in found.split.test])
    with torch.no_grad():
        logits, _ = model(batch.frames, batch.critical, batch.lengths)
    called = torch.sigmoid(logits / told["temperature"]) >= told["threshold"]
    assert (called == (batch.failed > 0.5)).all()


def test_the_kept_model_gives_true_odds(folder, whole):
    """A network that weighs passes w times as much has w times too small odds of failure: ln w is added back."""
    model, told = load_model(whole.model)
    state = read_checkpoint(whole.model.parent)
    assert state is not None and whole.best.number == whole.epochs[-1].number == EPOCHS
    learnt = state["averaged"]["output.bias"]
    assert model.output.bias.item() == pytest.approx(learnt.item() + np.log(told["success_weight"]), abs=1e-6)
    assert told["threshold"] == 0.5


def test_a_run_says_which_bags_code_and_settings_made_it(folder, whole):
    run, (_, told) = read_run(whole.model.parent), load_model(whole.model)
    examples = read_examples(folder)
    assert (
        run["bags"]["count"] == 24 and run["bags"]["campaign"] == "drawn" and len(run["bags"]["sha256"]) == 64
    )
    assert run["training"] == training().model_dump() and run["network"] == network().model_dump()
    assert len(run["code"]) == 64 and run["earlier_code"] == [] and run["versions"]["torch"].startswith("2.")
    assert run["split"]["test"] == [examples[k].number for k in whole.split.test]
    assert all(told[key] == run[key] for key in ("bags", "split", "network", "training", "code", "versions"))
    row = run["epochs"][-1]
    assert row["frames_hz"] > 0.0 and 0.0 < row["compute_share"] < 1.0


def test_another_training_in_the_same_folder_is_refused(folder, whole, tmp_path):
    out = whole.model.parent
    with pytest.raises(RefusedInput, match="with other settings; name another folder"):
        train(folder, out, network=network(), training=training(seed=1))
    with pytest.raises(RefusedInput, match="of another network"):
        train(folder, out, network=preset("compact", size_px=48), training=training())
    with pytest.raises(RefusedInput, match="with another split"):
        train(folder, out, network=network(), training=training(), split="random")
    with RunFolder(tmp_path / "held", {}), pytest.raises(RefusedInput, match="in use by another training"):
        RunFolder(tmp_path / "held", {})
    (tmp_path / "else").mkdir()
    (tmp_path / "else" / "thesis.txt").write_text("mine")
    with pytest.raises(RefusedInput, match="holds something else"):
        RunFolder(tmp_path / "else", {})


def test_it_ends_when_the_validation_loss_no_longer_falls(folder, tmp_path):
    # Too high a rate: it gets worse from the first epoch on, or goes up and down.
    found = train(
        folder, tmp_path / "run", network=network(), training=training(epochs=30, patience=2, learning_rate=0.1)
    )  # fmt: skip
    assert len(found.epochs) < 30 and found.epochs[-1].number == found.best.number + 2
    assert found.best.validation_loss == min(epoch.validation_loss for epoch in found.epochs)


def test_a_model_comes_back_and_nothing_else_is_taken_for_one(tmp_path):
    model = VideoClassifier(network())
    save_model(tmp_path, model, {"threshold": 0.4, "temperature": 1.5})
    again, told = load_model(tmp_path)
    assert told == {"threshold": 0.4, "temperature": 1.5} and not again.training and again.config == network()
    for name, value in model.state_dict().items():
        assert torch.equal(value, again.state_dict()[name])
    with pytest.raises(RefusedInput, match="must be the folder of a trained model"):
        load_model(tmp_path / "none")
    (tmp_path / "network.json").write_text(preset("compact").to_json())
    with pytest.raises(RefusedInput, match="is not of the network"):
        load_model(tmp_path)
    (tmp_path / "model.pt").write_bytes((tmp_path / "model.pt").read_bytes()[:1000])
    with pytest.raises(RefusedInput, match="is damaged, or no file of tensors"):
        load_model(tmp_path)


def test_an_epochs_order_hangs_on_seed_and_epoch_and_processes_share_it():
    order = epoch_order(10, seed=1, epoch=0)
    assert sorted(order) == list(range(10)) and order == epoch_order(10, seed=1, epoch=0)
    assert order != epoch_order(10, seed=1, epoch=1) and order != epoch_order(10, seed=2, epoch=0)
    shared = [epoch_order(10, seed=1, epoch=0, rank=rank, ranks=3) for rank in range(3)]
    assert [len(part) for part in shared] == [4, 4, 4]
    assert sorted(index for part in shared for index in part) == sorted([*range(10), *order[:2]])


def test_a_change_is_the_same_for_all_frames_of_a_clip():
    still = np.repeat(np.random.default_rng(0).integers(0, 256, (1, 24, 24, 3), dtype=np.uint8), 3, axis=0)
    always = training(augmentation=1.0)
    changed = augmented(still, np.random.default_rng(1), always)
    assert changed.shape == still.shape and not np.array_equal(changed, still)
    assert np.array_equal(changed, np.repeat(changed[:1], 3, axis=0))
    assert np.array_equal(changed, augmented(still, np.random.default_rng(1), always))
    assert np.array_equal(augmented(still, np.random.default_rng(1), training(augmentation=0.0)), still)
    mirror = training(augmentation=1.0, resize=0.0, rotation_deg=0.0, jitter=0.0)
    assert np.array_equal(augmented(still, np.random.default_rng(1), mirror), still[:, :, ::-1])
    bright = training(augmentation=1.0, resize=0.0, rotation_deg=0.0, flip=False)
    rng = np.random.default_rng(2)
    assert augmented(still[..., :1].copy(), rng, bright).shape == (3, 24, 24, 1)


def test_half_of_the_clips_are_left_alone_in_each_way():
    clip = np.arange(16 * 16, dtype=np.uint8).reshape(1, 16, 16, 1)
    mirror = training(augmentation=0.5, resize=0.0, rotation_deg=0.0, jitter=0.0)
    mirrored = [
        not np.array_equal(augmented(clip, np.random.default_rng(seed), mirror), clip) for seed in range(400)
    ]
    # Binomial: 400 draws of 0.5 have a standard deviation of 0.025.
    assert np.mean(mirrored) == pytest.approx(0.5, abs=0.1)


def test_short_clips_are_filled_up_and_judged_as_if_alone(folder):
    examples = read_examples(folder)[:3]
    cache = ClipCache(folder / "clips", network())
    (batch,) = ClipBatches(cache, batch=3).batches(examples)
    assert batch.lengths.tolist() == [5, 6, 5] and batch.frame_count == 16
    assert torch.equal(batch.frames[0, 5], batch.frames[0, 4])
    model = VideoClassifier(network()).eval()
    with torch.no_grad():
        together, _ = model(batch.frames, batch.critical, batch.lengths)
        for place, one in enumerate(examples):
            (alone,) = ClipBatches(cache, batch=1).batches([one])
            said, _ = model(alone.frames, alone.critical, alone.lengths)
            assert together[place].item() == pytest.approx(said.item(), abs=1e-5)


def test_batches_are_the_same_whatever_prepares_them(folder):
    examples, cache = read_examples(folder), ClipCache(folder / "clips", network())
    found = [
        list(ClipBatches(cache, batch=5, training=training(), threads=threads).batches(order, epoch=2))
        for threads, order in ((1, examples), (3, examples))
    ]
    assert all(torch.equal(a.frames, b.frames) for a, b in zip(*found, strict=True))
    # An example's augmentation does not hang on the place that it has in the order.
    source = ClipBatches(cache, batch=24, training=training())
    (turned,), (straight,) = source.batches(examples[::-1], epoch=2), source.batches(examples, epoch=2)
    assert torch.equal(turned.frames.flip(0), straight.frames)


def test_a_passed_test_weighs_as_many_times_as_there_are_more_fails():
    examples = [example(k, "pass" if k < 2 else "fail", "s") for k in range(8)]
    loss = Loss(examples, None)
    assert loss.success_weight == 3.0
    failed = torch.tensor([0.0 if e.success else 1.0 for e in examples])
    nothing = torch.zeros(0)
    batch = Batch(nothing, nothing, nothing, failed, nothing, None, 0.0)
    each = loss.each(torch.zeros(8), batch)
    # At even odds every loss is ln 2, times weights whose mean is 1: 8 / (6 + 3 * 2) for a fail.
    assert each.mean().item() == pytest.approx(np.log(2.0), rel=1e-6)
    assert each[7].item() == pytest.approx(np.log(2.0) * 8.0 / 12.0, rel=1e-6)
    assert each[0].item() == pytest.approx(3.0 * each[7].item(), rel=1e-6)
    assert Loss([replace(e, success=not e.success) for e in examples], None).success_weight == 1.0


def test_the_learning_rate_rises_and_falls_as_told():
    config = training(epochs=12, warmup_epochs=2.0, learning_rate=1.0e-2)
    assert learning_rate(config, 0.5) == pytest.approx(0.25e-2)
    assert learning_rate(config, 2.0) == pytest.approx(1.0e-2)
    assert learning_rate(config, 7.0) == pytest.approx(1.0e-2 * (0.01 + 0.99 * 0.5))
    assert learning_rate(config, 12.0) == pytest.approx(1.0e-4)
    assert learning_rate(training(schedule="constant"), 2.0) == training().learning_rate
    assert training_preset("paper").model_dump(include={"batch", "accumulation", "patience", "epochs"}) == {
        "batch": 8, "accumulation": 2, "patience": 10, "epochs": 100,
    }  # fmt: skip


def test_bad_settings_are_refused_in_one_line():
    for changes, told in (
        ({"batch": 0}, "training.batch = 0"), ({"rate": 1}, "training.rate"), ({"seed": "x"}, "training.seed"),
    ):  # fmt: skip
        with pytest.raises(RefusedInput, match=told) as refused:
            training_preset("paper", **changes)
        assert "\n" not in str(refused.value)
    with pytest.raises(RefusedInput, match="must be one of paper, compact"):
        training_preset("huge")


WITHOUT_TORCH = "import sys; sys.modules['torch'] = None; from ros_nodes.entry import main; main()"


def test_without_torch_the_command_says_what_to_install():
    ended = _run("-c", WITHOUT_TORCH, "train", "runs/none")
    assert ended.returncode == 2
    assert (
        ended.stderr
        == "pallet-twin: train = torch: is not installed: pip install 'pallet-twin[classifier]'\n"
    )


def test_the_command_trains_and_goes_on(folder, tmp_path):
    few = (
        "--set",
        "network.size_px=32",
        "--set",
        "network.base_width=4",
        "--set",
        "training.validation_share=0.3",
    )
    command = ("train", folder, "--out", tmp_path / "run", "--workers", 1, "--epochs", 1, *few)
    for _ in range(2):
        ended = CliRunner().invoke(app, [str(argument) for argument in command])
        assert ended.exit_code == 0, ended.output
        assert f"model   {tmp_path / 'run' / 'model'}" in ended.stdout
        assert "epoch   1 of 1: loss" in ended.stderr
    load_model(tmp_path / "run" / "model")
