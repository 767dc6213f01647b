"""Fits from their first points to a scene: what they recover, that they can be killed, and what
they leave on disk.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ggvs_eval import kernels
from ggvs_eval.baselines.fitted.four_d import FourD
from ggvs_eval.baselines.fitted.optimiser import FitSchedule, Journal, optimise
from ggvs_eval.baselines.fitted.per_instant import PerInstant
from ggvs_eval.baselines.fitted.scene import SCENE, LinearMotion, StoredScene
from ggvs_eval.baselines.fitted.shots import Shots
from ggvs_eval.baselines.fitted.state import FitState
from ggvs_eval.baselines.fitted.stream import Stream
from ggvs_eval.compute_device import one_thread
from ggvs_eval.errors import RenderError, TrainingError, WeightsError
from ggvs_eval.gaussians import render_gaussians
from helpers.fitted_footage import footage_of, rig, wall
from helpers.photographs import psnr_db
from helpers.refusals import refused

SHORT = {"steps": 24, "points": 400, "most": 450, "save_every": 10}


def sliding(time: float):
    """The wall, whose middle slides to the right."""
    cloud = wall()
    middle = (cloud.means[:, 2] < -0.3)[:, None]
    return replace(cloud, means=cloud.means + middle * torch.tensor([0.4 * time, 0.0, 0.0]))


@pytest.fixture(scope="module")
def sliding_footage(tmp_path_factory):
    return footage_of(sliding, tmp_path_factory.mktemp("sliding"))


def fitted(fitter, footage, folder):
    folder.mkdir(exist_ok=True)
    fitter.fit(footage, folder, lambda done, steps: None)
    return fitter.load(folder)


def quiet(folder, steps):
    return Journal(folder, "fit", steps, 0, 0, lambda done, steps: None)


@pytest.mark.slow
def test_a_cloud_with_known_linear_motion_is_recovered(tmp_path):
    """From places in the middle of the clip, other colours and no velocities, to more than 40 dB,
    velocities within 5 %.
    """
    random = np.random.default_rng(8)
    cloud = wall(across=10, down=7, colours=random.uniform(0.1, 0.9, (70, 3)), scale=0.12)
    # units per clip
    velocities = torch.from_numpy(random.normal(0, (0.15, 0.15, 0.05), (70, 3)).astype(np.float32))
    footage = footage_of(
        lambda time: replace(cloud, means=cloud.means + (time - 0.5) * velocities),
        tmp_path,
        instants=5,
    )
    canonical = {name: tensor for name, tensor in cloud.parameters().items() if name != "sh"}
    lasting = {
        "times": torch.full((70,), 0.5),
        "log_durations": torch.full((70,), 9.0),
        "velocities": torch.zeros(70, 1, 3),
    }
    colours = {"sh_base": cloud.sh[:, :1] + 0.1, "sh_rest": cloud.sh[:, 1:]}
    state = FitState({**canonical, **lasting, **colours}, LinearMotion())
    shots = Shots(footage, footage.indices, tmp_path)

    with one_thread():
        optimise(
            state,
            shots,
            FitSchedule(600, density=None, measure_every=0),
            quiet(tmp_path, 600),
            None,
        )

    errors = []
    with torch.no_grad():
        for shot in (shots.shot(ordinal) for ordinal in range(len(shots))):
            picture = render_gaussians(state.motion.cloud(state.gaussians, shot.time), shot.camera)
            errors.append(float((picture.image - shot.image).square().mean()))
    # to all cameras, all the time
    visible = (cloud.means.abs() < torch.tensor([1.4, 1.0, 9.0])).all(dim=1)
    wrong = (state.gaussians["velocities"][:, 0].detach() - velocities)[
        visible
    ].norm() / velocities[visible].norm()
    assert int(visible.sum()) > 10
    assert -10 * np.log10(np.mean(errors)) > 40
    assert float(wrong) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("motion", [pytest.param("hexplane", marks=pytest.mark.proof), "linear"])
def test_moving_footage_is_learned_in_each_motion(motion, sliding_footage, tmp_path):
    """A camera that was held out is rendered at the last instant better by 2 dB than at the first
    one, which differs from it.
    """
    held = sliding_footage.cameras[2]
    footage = replace(
        sliding_footage,
        cameras=tuple(camera for camera in sliding_footage.cameras if camera is not held),
    )

    scene = fitted(FourD(motion, steps=250, points=400, most=500), footage, tmp_path / motion)

    first, last = (
        psnr_db(scene.render(index, held).image, sliding_footage.image(held.name, 3))
        for index in (0, 3)
    )
    assert last > 22
    assert last > first + 2


@pytest.mark.slow
@pytest.mark.parametrize("motion", [pytest.param("hexplane", marks=pytest.mark.proof), "linear"])
def test_a_killed_fit_goes_on_with_equal_bits(motion, sliding_footage, tmp_path, kernel_settings):
    """A fit that was killed after a checkpoint, and goes on with another number of threads, leaves
    the same bytes and curve.
    """
    fitter = FourD(motion, **SHORT)
    whole = fitted(fitter, sliding_footage, tmp_path / "whole")

    def kill(done: int, steps: int) -> None:
        if done == 17:
            raise KeyboardInterrupt

    (tmp_path / "killed").mkdir()
    kernels.set_threads(1)
    with pytest.raises(KeyboardInterrupt):
        fitter.fit(sliding_footage, tmp_path / "killed", kill)
    kernels.set_threads(2)
    steps: list[tuple[int, int]] = []
    fitter.fit(sliding_footage, tmp_path / "killed", lambda *progress: steps.append(progress))

    assert steps == [(step, 24) for step in range(11, 25)]
    assert (tmp_path / "killed" / SCENE).read_bytes() == (tmp_path / "whole" / SCENE).read_bytes()
    curves = [(tmp_path / name / "validation.csv").read_text() for name in ("whole", "killed")]
    assert curves[0] == curves[1]
    assert len(curves[0].splitlines()) == 2
    assert (tmp_path / "whole" / "fit.png").is_file()
    assert not list((tmp_path / "whole").glob("*.npy"))
    assert whole.size_bytes == (tmp_path / "whole" / SCENE).stat().st_size


@pytest.mark.slow
def test_each_instant_alone_depends_on_no_other(sliding_footage, tmp_path):
    """`3dgs-per-instant` gives an instant the same bytes, whatever the others are; it works on a
    single one.
    """
    fitter = PerInstant(**SHORT | {"steps": 12})
    (tmp_path / "all").mkdir()

    def kill(done: int, steps: int) -> None:
        if done == 31:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fitter.fit(sliding_footage, tmp_path / "all", kill)
    scene = fitted(fitter, sliding_footage, tmp_path / "all")
    fitted(fitter, replace(sliding_footage, indices=range(2, 3), fps=0.0), tmp_path / "one")

    cloud, alone = (
        StoredScene(tmp_path / name / "000002.safetensors").gaussians for name in ("all", "one")
    )
    assert all(torch.equal(cloud[name], alone[name]) for name in cloud)
    assert len(list((tmp_path / "all").glob("*.safetensors"))) == 4
    picture = scene.render(3, sliding_footage.cameras[0])
    assert picture.image.shape == (48, 64, 3)
    assert picture.depth is not None
    assert not (tmp_path / "all" / "state.pt").exists()


@pytest.mark.proof
def test_a_stream_goes_from_instant_to_instant(sliding_footage, tmp_path):
    """`3dgstream` follows what moves, goes on after a kill with equal bytes, and renders its
    instants in any order.
    """
    fitter = Stream(steps=60, transforming=40, spawning=8, spawned=40, points=400, most=500)
    whole = fitted(fitter, sliding_footage, tmp_path / "whole")

    def kill(done: int, steps: int) -> None:
        if done == 90:
            raise KeyboardInterrupt

    (tmp_path / "killed").mkdir()
    with pytest.raises(KeyboardInterrupt):
        fitter.fit(sliding_footage, tmp_path / "killed", kill)
    scene = fitted(fitter, sliding_footage, tmp_path / "killed")

    files = sorted((tmp_path / "whole").glob("*.safetensors"))
    assert [file.read_bytes() for file in files] == [
        (tmp_path / "killed" / file.name).read_bytes() for file in files
    ]
    assert len(files) == 4
    camera = sliding_footage.cameras[1]
    forward = [scene.render(index, camera).image for index in range(4)]
    backward = [whole.render(index, camera).image for index in (3, 2, 1, 0)][::-1]
    assert all(np.array_equal(image, twin) for image, twin in zip(forward, backward, strict=True))
    own = psnr_db(forward[3], sliding_footage.image(camera.name, 3))
    still = psnr_db(forward[0], sliding_footage.image(camera.name, 3))
    assert own > still + 6  # at a rate that moves all planes' nodes alike it gains 2.4 dB


@pytest.mark.slow
def test_what_cannot_be_is_said_in_a_line(sliding_footage, tmp_path):
    """An unknown motion, a damaged state, a file that is no scene, and an instant that was not
    fitted are errors one can mend.
    """
    with refused(RenderError, "4dgs", "steps", "got 0"):
        FourD(steps=0)
    with refused(RenderError, "hexplane", "'liner'", "did you mean linear"):
        FourD("liner")  # type: ignore[arg-type]
    (tmp_path / "state.pt").write_bytes(b"no state")
    with refused(TrainingError, "state.pt", "move it away"):
        FourD(**SHORT).fit(sliding_footage, tmp_path, lambda done, steps: None)
    (tmp_path / SCENE).write_bytes(b"no scene")
    with refused(WeightsError, "scene.safetensors"):
        FourD().load(tmp_path)
    fitted(FourD("linear", **SHORT | {"steps": 1}), sliding_footage, tmp_path / "short")
    with refused(RenderError, "0..3", "got 4"):
        FourD().load(tmp_path / "short").render(4, rig()[0])
