"""All networks from one command: the same views for all, commands of their own, one that fails,
going on.
"""

import fcntl
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.contrib.training.recipes.recipe import TRAINED_BASELINES
from ggvs_eval.contrib.training.request import TrainingOptions
from ggvs_eval.contrib.training.samples import training_data
from ggvs_eval.contrib.training.samples.sample_kinds import BlendKind, InstantKind
from ggvs_eval.contrib.training.samples.training_data import sample_pools
from ggvs_eval.contrib.training.train_all import (
    NETWORKS,
    Training,
    default_jobs,
    planned_trainings,
    run_trainings,
    train_all,
)
from ggvs_eval.contrib.training.train_one import CACHE, baseline_task, planned_task
from ggvs_eval.contrib.worlds.domains import DOMAINS
from ggvs_eval.errors import TrainingError
from helpers.filled_pools import fill
from helpers.refusals import refused
from helpers.stereo_scenes import write_capture

REQUEST = TrainingOptions(
    steps=2,
    views=2,
    size="small",
    rooms=1,
    targets=1,
    domains=("plain", "narrow"),
    device="cpu",
    workers=0,
)
KINDS = BlendKind(), InstantKind(), InstantKind(depth=False)
# hardly larger than ENeRF's crops, whole views of which take long
SIZES = {"plain": (272, 204), "narrow": (260, 195)}


@pytest.fixture(scope="module")
def plane_capture(tmp_path_factory):
    """Five cameras before a slanted plane."""
    return write_capture(tmp_path_factory.mktemp("plane"), n_frames=1)


@pytest.fixture(scope="module")
def cache(tmp_path_factory, plane_capture):
    """Its samples in place of rooms of two domains, of two sizes, as blend, fwd and enerf take
    them.
    """
    folder = tmp_path_factory.mktemp("all") / CACHE
    for kind in KINDS:
        scale = 1.25 if isinstance(kind, BlendKind) else 1.0  # whose crops are larger
        for pool in sample_pools(folder, REQUEST, kind):
            fill(
                pool,
                lambda plan, scale=scale: plane_capture.resized(
                    *(round(scale * px) for px in SIZES[plan.domain]), "area"
                ),
            )
    return folder


def test_every_network_learns_from_the_same_views(plane_capture, tmp_path, monkeypatch):
    """Rooms of all domains and captures, for the blending network and for baselines, with depth or
    without: equal plans.
    """
    monkeypatch.setattr(
        training_data,
        "open_capture",
        lambda path: replace(plane_capture.resized(480, 360, "area"), path=path),
    )
    data = TrainingOptions(captures=(tmp_path / "rig",))
    pools = [sample_pools(tmp_path, data, kind) for kind in KINDS]
    for training, validation in pools:
        assert repr(training) == repr(pools[0][0])
        assert validation.sources == pools[0][1].sources
        assert len(training.sources) == len(DOMAINS) + 1
        assert [plan.domain for plan in validation.sources] == list(DOMAINS)
        assert (
            f"{training_data.CAPTURE_TARGETS} views of the captures {plane_capture.scene}"
            in training.data
        )
    with pytest.raises(TrainingError, match="wanted each once"):
        sample_pools(
            tmp_path, TrainingOptions(captures=(tmp_path / "rig", tmp_path / "rig")), InstantKind()
        )
    with refused(TrainingError, "rooms or captures", "neither", "--rooms"):
        sample_pools(tmp_path, TrainingOptions(rooms=0), InstantKind())


@pytest.mark.slow
@pytest.mark.parametrize("what", ["blend", pytest.param("enerf", marks=pytest.mark.proof)])
def test_weights_that_have_learned_are_moved_more_gently(what, cache, tmp_path):
    """A training that starts from weights has a third of the rate."""
    fresh, tuned = (
        planned_task(what, cache, replace(REQUEST, start_from=path))
        for path in (None, tmp_path / "shipped")
    )
    assert tuned.schedule.rate(400, 2000) == pytest.approx(0.3 * fresh.schedule.rate(400, 2000))


@pytest.mark.slow
@pytest.mark.parametrize("what", TRAINED_BASELINES)
def test_crops_lie_within_samples_of_any_size(what, cache):
    """Each sample's own size decides where windows may be: first and last place fit, whatever was
    drawn.
    """
    task = baseline_task(what, cache, REQUEST)
    sizes = set()
    for index in range(len(task.training)):
        sample = task.training.read(index)
        sizes.add(sample.instant.target.size)
        last = np.subtract(
            sample.instant.target.size, (task.recipe.crop_width, task.recipe.crop_height)
        )
        for place, corner in (((0.0, 0.0), (0, 0)), ((1 - 2**-53,) * 2, last)):
            crop = task._crop(sample, place)
            assert crop.truth.shape == (task.recipe.crop_height, task.recipe.crop_width, 3)
            np.testing.assert_array_equal(
                sample.instant.target.K[:2, 2] - crop.instant.target.K[:2, 2], corner
            )
    assert sizes == set(SIZES.values())


def test_each_network_has_its_command(tmp_path):
    """Eight networks in folders of their own, blend with each guidance; all get the same steps,
    rooms and captures.
    """
    request = replace(
        REQUEST, captures=(Path("walk"), Path("rig")), hold_back=True, compile_network=True
    )
    trainings = planned_trainings(tmp_path, request)
    assert [each.name for each in trainings] == [
        "blend",
        "blend-no-tsdf",
        "blend-naive",
        *TRAINED_BASELINES,
    ]
    assert len(NETWORKS) == 8
    for training in trainings:
        words = " ".join(training.arguments)
        assert training.arguments[2] == str(tmp_path / training.name)
        for part in (
            "--steps 2",
            "--domains plain narrow",
            "--captures walk rig",
            "--hold-back",
            "--device cpu",
            "--rooms 1",
        ):
            assert part in words
        assert ("--guidance" in words) == training.name.startswith("blend")
        assert ("--configuration compact" in words) != training.name.startswith("blend")
    assert "--guidance naive" in " ".join(trainings[2].arguments)
    assert "walk" in request.card_words("fwd")
    assert replace(request, captures=(tmp_path / "walk",)).card_words("fwd").count("walk") == 1
    assert "--crop" not in request.card_words("fwd")
    assert (
        " ".join(replace(request, crop=(384, 288)).card_words("fwd")).count("--crop 384 288") == 1
    )


def test_how_many_run_at_once(monkeypatch):
    """All on a GPU; on a CPU one per two cores, but one at least."""
    for cores, jobs in ((1, 1), (2, 1), (5, 2), (64, 7)):
        monkeypatch.setattr(
            "ggvs_eval.contrib.training.train_all.usable_cpus", lambda cores=cores: cores
        )
        assert default_jobs("cpu", 7) == jobs
        assert default_jobs("cuda", 7) == 7


def test_steps_are_read_from_the_log(tmp_path):
    """None before the first, then one more than the last line's number, a half line included."""
    training = Training("a", tmp_path, (), 9)
    assert training.steps_done() == 0
    (tmp_path / "log.csv").write_text("step,loss\n")
    assert training.steps_done() == 0
    (tmp_path / "log.csv").write_text(
        "step,loss\n" + "".join(f"{step},0.5\n" for step in range(2000)) + "2000,0."
    )
    assert training.steps_done() == 2001


def test_what_is_for_one_network_is_refused(tmp_path):
    """Weights to begin with, a guidance, and no job at all: one line each."""
    for request in (replace(REQUEST, start_from=tmp_path / "x"), replace(REQUEST, guidance="none")):
        with refused(TrainingError, "--start-from", "--guidance"):
            train_all(tmp_path, request)
    with refused(TrainingError, "--jobs 0"):
        run_trainings([], 0)


def test_a_folder_is_trained_into_by_one_process_only(tmp_path):
    """While another process holds the log of a training, it is not started again, and the line says
    where it runs.
    """
    training = Training("fwd", tmp_path / "fwd", ("train", "fwd"), 9)
    training.folder.mkdir()
    with training.log.open("ab") as log:
        fcntl.flock(log, fcntl.LOCK_EX)
        failures = run_trainings([training], 1)
    assert "another call trains it in" in failures["fwd"]


@pytest.mark.proof
def test_networks_are_trained_side_by_side(cache, capsys):
    """One that cannot go on stops no other and leaves a line; a second call finishes it; weights,
    cards and curves stand.
    """
    out = cache.parent
    networks = [("blend", "none"), ("enerf", "registered")]
    (out / "enerf").mkdir()
    (out / "enerf" / "state.pt").write_bytes(b"no zip")
    with refused(TrainingError, "2 trained networks", "enerf failed"):
        train_all(out, REQUEST, jobs=2, networks=networks)
    told = capsys.readouterr().err
    assert "enerf: exit 1 after 0 of 2 steps: " in told
    assert "blend-no-tsdf: 2 of 2 steps" in told
    assert str(out / "enerf" / "train.log") in told
    assert (out / "blend-no-tsdf" / "blend-no-tsdf.safetensors").is_file()
    (out / "enerf" / "state.pt").unlink()
    files = train_all(out, replace(REQUEST, steps=1), networks=networks[1:])
    assert files == [out / "enerf" / "enerf.safetensors", out / "enerf" / "enerf.md"]
    for name in ("blend-no-tsdf", "enerf"):
        card = (out / name / f"{name}.md").read_text()
        assert "of domain narrow" in card
        assert str(out) not in card
        assert (out / name / f"{name}.png").is_file()
