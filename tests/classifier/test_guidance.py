"""What training is guided by is the judge's own displacement; the network's input and the saved model never see it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from classifier.batches import Batch, ClipBatches
from classifier.checkpoint import load_model
from classifier.clips import ClipCache, clip_of_bag, clip_to_bytes
from classifier.configuration import preset
from classifier.examples import read_examples
from classifier.guidance import GUIDES, GuideCache, guide_of_bag
from classifier.learner import Guided, guidance_loss
from classifier.load_motion import CHANNELS
from classifier.margins import MARGINS
from classifier.network import VideoClassifier
from classifier.run_folder import read_checkpoint
from config.errors import BrokenRecording
from recordings.campaigns.one_test import run_one
from recordings.judge_bag import judge_bag
from sim_core.judge import BAND_COUNT
from tests.classifier.drawn_campaign import PICTURES, SLID_MM, drawn_campaign, pictures, write_bag
from tests.classifier.training_job import job, network, training
from tests.recordings.tiny_campaign import CAMERA, SCENE, tasks, tiny

# Of two boxes, 1 m high together, at 5 % of the height.
LIMIT_MM = 50.0


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
def trained(folder, tmp_path_factory):
    return job(folder, tmp_path_factory.mktemp("guided") / "run")


def _shares(guide):
    """Displacements as shares of the permanent limit, shape [picture_count, GUIDES]."""
    return np.exp(guide.astype(float)) - 0.05


def _batch(guide: np.ndarray | None) -> Batch:
    count, time = guide.shape[:2] if guide is not None else (2, 3)
    nothing = torch.zeros(count, time, CHANNELS, 32, 32)
    lengths = torch.full((count,), time)
    told = torch.from_numpy(guide) if guide is not None else None
    critical, margins = torch.zeros(count, dtype=torch.int64), torch.zeros(count, MARGINS)
    return Batch(nothing, critical, lengths, torch.zeros(count), margins, told, 0.0)


def test_figures_are_the_judges_at_each_picture(folder):
    slid, stood = read_examples(folder)[3], read_examples(folder)[1]
    assert not slid.success and stood.success
    guide = guide_of_bag(slid.bag)
    count = PICTURES + 1
    assert guide.shape == (count, GUIDES) and GUIDES == 1 + BAND_COUNT and guide.dtype == np.float32
    _, judge = judge_bag(slid.bag)
    assert judge.height_m == 1.0 and judge.peak_mm == pytest.approx(SLID_MM * (count - 1))
    shares = _shares(guide)
    assert shares[-1, 0] == pytest.approx(judge.peak_mm / LIMIT_MM, rel=1.0e-5)
    # Corners stand at 0, 0.5 and 1 m: in the bands 0, 2 and 5. Those without move as the ones below them.
    truth = np.arange(count) * SLID_MM / LIMIT_MM
    assert shares[:, 0] == pytest.approx(truth, abs=1.0e-5)
    assert shares[:, 3:] == pytest.approx(np.repeat(truth[:, None], 4, axis=1), abs=1.0e-5)
    assert shares[:, 1:3] == pytest.approx(np.zeros((count, 2)), abs=1.0e-5)
    assert _shares(guide_of_bag(stood.bag)) == pytest.approx(np.zeros((count, GUIDES)), abs=1.0e-5)


def test_a_load_that_falls_off_counts_as_eight_limits(tmp_path):
    write_bag(tmp_path / "bag", pictures(0, slides=True), slid_mm=300.0)
    assert _shares(guide_of_bag(tmp_path / "bag"))[-1, 0] == pytest.approx(8.0, rel=1.0e-5)


def test_a_recipe_has_the_figures_of_the_pictures_that_it_is_drawn_to(tmp_path):
    scene = {**SCENE, "camera": CAMERA}
    (task,) = tasks(tiny(scene=scene), 1)
    guides = []
    for with_pictures in (True, False):
        done = run_one(replace(task, with_pictures=with_pictures))
        bag = tmp_path / str(with_pictures) / "bag"
        bag.mkdir(parents=True)
        for name, content in done.bag.items():
            (bag / name).write_bytes(content)
        guides.append(guide_of_bag(bag))
    assert guides[0].shape == (CAMERA["pictures"], GUIDES) and np.array_equal(*guides)
    shares = _shares(guides[0])
    assert shares[:, 0] == pytest.approx(shares[:, 1:].max(axis=1), abs=1.0e-6)
    assert shares[0] == pytest.approx(np.zeros(GUIDES), abs=1.0e-6)


def test_figures_come_back_from_disk_and_damaged_ones_are_made_anew(folder, tmp_path):
    example, cache = read_examples(folder)[0], GuideCache(tmp_path)
    cache.prepare([example])
    made = cache.guide(replace(example, bag=tmp_path / "gone"))
    assert np.array_equal(made, guide_of_bag(example.bag))
    (stored,) = tmp_path.rglob("*.npy")
    whole = stored.read_bytes()
    for damaged in (whole[:-9], whole[:20], b"no figures"):
        stored.write_bytes(damaged)
        assert np.array_equal(cache.guide(example), made) and stored.read_bytes() == whole
    assert not list(tmp_path.rglob("*.part"))


def test_an_empty_file_is_made_anew(folder, tmp_path):
    example, cache = read_examples(folder)[0], GuideCache(tmp_path)
    made = cache.guide(example)
    (stored,) = tmp_path.rglob("*.npy")
    stored.write_bytes(b"")
    assert np.array_equal(cache.guide(example), made)


def test_preparing_tells_how_far_it_is_and_makes_nothing_twice(folder, tmp_path):
    examples, cache, told = read_examples(folder)[:3], GuideCache(tmp_path), []
    cache.guide(examples[1])
    cache.prepare(examples, on_progress=lambda done, total, _: told.append((done, total)))
    assert told == [(2, 3), (3, 3)]
    gone = [replace(example, bag=tmp_path / "gone") for example in examples]
    cache.prepare(gone)
    assert all(
        np.array_equal(cache.guide(one), guide_of_bag(two.bag))
        for one, two in zip(gone, examples, strict=True)
    )


def test_frames_of_a_batch_have_the_figures_of_their_pictures(folder):
    examples = read_examples(folder)[:2]
    few = preset("compact", size_px=32, frames=3)
    clips, guides = ClipCache(folder / "clips", few), GuideCache(folder / "clips")
    (batch,) = ClipBatches(clips, batch=2, guides=guides).batches(examples)
    assert batch.guide is not None and batch.guide.shape == (2, 3, GUIDES)
    for place, example in enumerate(examples):
        numbers = clips.clip(example).numbers
        assert np.array_equal(batch.guide[place].numpy(), guide_of_bag(example.bag)[numbers])
    # Clips of 5 and 6 pictures, all of which are looked at: what fills up the first has no figures.
    clips = ClipCache(folder / "clips", network())
    (batch,) = ClipBatches(clips, batch=2, guides=guides).batches(examples)
    assert batch.guide is not None
    assert torch.isnan(batch.guide[0, 5]).all() and torch.isfinite(batch.guide[0, :5]).all()
    assert torch.isfinite(batch.guide[1]).all()
    (plain,) = ClipBatches(clips, batch=2).batches(examples)
    assert plain.guide is None and torch.equal(plain.frames, batch.frames)


def test_the_loss_is_hubers_mean_of_each_clip_and_ignores_what_fills_it_up():
    guide = np.random.default_rng(0).normal(size=(2, 3, GUIDES)).astype(np.float32)
    guide[0, 2] = np.nan
    guess = torch.nan_to_num(torch.from_numpy(guide), nan=1.0e3)
    assert guidance_loss(guess, _batch(guide)).item() == 0.0
    # Off by 2 in one clip, by 0.5 in the other: 2 − 1/2 and 0.5²/2, whatever their lengths.
    off = guess + torch.tensor([2.0, 0.5])[:, None, None]
    off.requires_grad_()
    loss = guidance_loss(off, _batch(guide))
    assert loss.item() == pytest.approx(1.5 + 0.125, rel=1.0e-5)
    loss.backward()
    assert off.grad is not None and torch.isfinite(off.grad).all()
    assert (off.grad[0, 2] == 0.0).all() and (off.grad[0, :2] > 0.0).all() and (off.grad[1] > 0.0).all()
    assert guidance_loss(None, _batch(guide)).item() == guidance_loss(guess, _batch(None)).item() == 0.0


def test_the_guess_reaches_the_backbone_and_nothing_behind_it():
    torch.manual_seed(0)
    guided = Guided(VideoClassifier(network()), guided=True).train()
    frames, lengths = torch.randn(2, 3, CHANNELS, 32, 32), torch.full((2,), 3)
    guide = np.ones((2, 3, GUIDES), np.float32)
    _, guess, _ = guided(frames, torch.zeros(2, dtype=torch.int64), lengths)
    guidance_loss(guess, _batch(guide)).backward()
    reached = {name for name, value in guided.named_parameters() if value.grad is not None}
    assert {name.split(".")[0] for name in reached} == {"model", "guess"}
    assert {name.split(".")[1] for name in reached if name.startswith("model")} == {"backbone", "figures"}


def test_the_saved_model_has_nothing_of_the_guess(folder, tmp_path):
    # The checkpoint is that of the last epoch: of one, it is the best, too.
    trained = job(folder, tmp_path / "one", epochs=1)
    state = read_checkpoint(trained.model.parent)
    assert state is not None and training().guidance > 0.0 and training().margins > 0.0
    beside = {name.split(".")[0] for name in state["model"] if not name.startswith("model.")}
    assert beside == {"guess", "margins"}
    model, _ = load_model(trained.model)
    kept = torch.load(trained.model / "model.pt", weights_only=True)
    assert kept.keys() == VideoClassifier(network()).state_dict().keys() == model.state_dict().keys()
    for name, value in model.state_dict().items():
        # The last bias has the weighing of passes in it.
        assert name == "output.bias" or torch.equal(value, state["averaged"][name])


def test_guidance_changes_what_is_learnt_but_not_what_is_shown(folder, trained, tmp_path):
    plain = job(folder, tmp_path / "plain", guidance=0.0, margins=0.0)
    assert plain.digest != trained.digest
    # The loss that is told, and that ends a training, is that of verdicts alone.
    assert trained.epochs[0].train_loss == pytest.approx(plain.epochs[0].train_loss, rel=0.1)
    state = read_checkpoint(plain.model.parent)
    assert state is not None and all(name.startswith("model.") for name in state["model"])


def test_no_answer_hangs_on_figures_poses_or_scene(folder, trained, tmp_path):
    examples = read_examples(folder)[:4]
    model, _ = load_model(trained.model)

    def answers(cache: ClipCache) -> tuple[list[bytes], list[float]]:
        clips = [clip_to_bytes(cache.clip(example)) for example in examples]
        (batch,) = ClipBatches(cache, batch=4).batches(examples)
        with torch.no_grad():
            return clips, model(batch.frames, batch.critical, batch.lengths)[0].tolist()

    before = answers(ClipCache(folder / "clips", model.config))
    # Other figures stand where they are looked for; and a cache without any.
    guides = GuideCache(tmp_path / "other")
    guides.prepare(examples)
    for stored in (tmp_path / "other").rglob("*.npy"):
        np.save(stored, np.full((PICTURES + 1, GUIDES), 3.0, np.float32))
    assert guides.guide(examples[0])[0, 0] == 3.0
    assert answers(ClipCache(tmp_path / "other", model.config)) == before
    assert answers(ClipCache(tmp_path / "none", model.config)) == before
    # The same pictures with other poses, or none.
    shown = pictures(7, slides=True)
    for slid_mm in (None, 0.0, 90.0):
        write_bag(tmp_path / str(slid_mm), shown, slid_mm=slid_mm)
    first, *others = (
        clip_to_bytes(clip_of_bag(tmp_path / name, network())) for name in ("None", "0.0", "90.0")
    )
    assert others == [first, first]


def test_bags_without_poses_teach_without_guidance_and_are_refused_with_it(tmp_path):
    bare = drawn_campaign(tmp_path / "campaign", tests=24, posed=False)
    with pytest.raises(BrokenRecording, match="must hold one topic scene") as refused:
        job(bare, tmp_path / "guided")
    assert "\n" not in str(refused.value)
    assert len(job(bare, tmp_path / "plain", guidance=0.0, epochs=1).epochs) == 1


def test_a_refusal_in_a_worker_comes_back_as_one(tmp_path):
    bare = drawn_campaign(tmp_path / "campaign", tests=2, posed=False)
    with pytest.raises(BrokenRecording, match="must hold one topic scene"):
        GuideCache(tmp_path / "clips").prepare(read_examples(bare), workers=2)
