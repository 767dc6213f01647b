"""``splats:PATH``: Gaussians that others have fitted are a method of a run, rendered by our
splat.
"""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from ggvs_eval.baselines.fitted.hexplane import PUBLISHED, DeformationNetwork
from ggvs_eval.capture import Capture
from ggvs_eval.errors import RenderError, WeightsError
from ggvs_eval.files.images import quantise, read_image
from ggvs_eval.gaussians import GaussianCloud, render_gaussians, write_ply
from ggvs_eval.gaussians.settings import moved_cloud
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.methods.splats import named_splats, open_splats, splats_files, splats_notes
from ggvs_eval.pipelines.run.evaluate import measure
from ggvs_eval.pipelines.run.run_plan import RunPlan, RunRequest, plan_run
from ggvs_eval.protocol import CameraPath, Frames, Measurement, Protocol, Synthesis, Views
from ggvs_eval.run_folder import frame_path, read_json
from helpers.gaussian_clouds import random_cloud
from helpers.refusals import refused
from helpers.stereo_scenes import write_capture

PROTOCOL = Protocol(
    "splats",
    "plane",
    Views(("cam00",), "by hand"),
    Frames(0, 2),
    Synthesis(k=2),
    Measurement(metrics=("PSNR",), ceilings=False),
    CameraPath(poses=2),
)


def cloud_before(capture: Capture, grey: float) -> GaussianCloud:
    """Large Gaussians of one grey in front of the rig."""
    camera = capture.cameras[0]
    pixels = np.random.default_rng(0).uniform((0, 0), camera.size, (40, 2))
    points = camera.unproject(pixels, np.full(40, (camera.near + camera.far) / 2))
    means = torch.from_numpy(points).float()
    return GaussianCloud.of_points(
        means, torch.full((40, 3), grey), scale=0.1 * camera.far, opacity=0.9
    )


@pytest.fixture(scope="module")
def plane_capture(tmp_path_factory) -> Capture:
    return write_capture(tmp_path_factory.mktemp("rig"), n_frames=2)


@pytest.fixture(scope="module")
def sequence(plane_capture, tmp_path_factory) -> Path:
    """A cloud per frame, each of another grey."""
    folder = tmp_path_factory.mktemp("clouds")
    for frame, grey in enumerate((0.3, 0.7)):
        write_ply(folder / f"scene2_{frame:05d}.ply", cloud_before(plane_capture, grey))
    return folder


@pytest.fixture(scope="module")
def finished(plane_capture, sequence, tmp_path_factory) -> RunPlan:
    """A whole run of a sequence and of its second cloud alone, in an output folder of 3D Gaussian
    splatting.
    """
    trained = tmp_path_factory.mktemp("trained") / "point_cloud"
    for iteration, frame in ((7000, 0), (30000, 1)):
        (trained / f"iteration_{iteration}").mkdir(parents=True)
        shutil.copy(
            sequence / f"scene2_{frame:05d}.ply",
            trained / f"iteration_{iteration}" / "point_cloud.ply",
        )
    labels, paths = named_splats([f"moving=splats:{sequence}", f"still=splats:{trained.parent}"])
    root = tmp_path_factory.mktemp("run")
    plan = plan_run(
        RunRequest(root, plane_capture, PROTOCOL, labels, networks=NetworkOptions(splats=paths))
    )
    measure(plan, 1)
    return plan


def test_frames_are_those_of_the_splat(finished, plane_capture):
    """Each instant from its own cloud, or all from one; the camera path stands at its instant."""
    for label, greys in (("moving", (0.3, 0.7)), ("still", (0.7, 0.7))):
        for frame, grey in enumerate(greys):
            expected = (
                render_gaussians(cloud_before(plane_capture, grey), finished.plans["cam00"].target)
                .image.clamp(max=1)
                .numpy()
            )
            assert np.array_equal(
                read_image(frame_path(finished.run.renders(label, "cam00"), frame)),
                quantise(expected),
            )
        on_path = cloud_before(plane_capture, greys[finished.path_frame])
        expected = render_gaussians(on_path, finished.path[1].target).image.clamp(max=1).numpy()
        assert np.array_equal(
            read_image(frame_path(finished.run.path(label), 1)), quantise(expected)
        )


def test_they_are_scored_and_timed(finished, sequence, plane_capture):
    """A row of the table like any other, with the milliseconds of the splat; whoever fits again is
    rendered again, alone.
    """
    scores = read_json(finished.run.root / "results.json")
    record = read_json(finished.run.renders("moving", "cam00") / "job.json")

    assert {"moving", "still"} <= set(finished.run.labels())
    assert "moving" in str(scores)
    assert set(record["seconds"]) == {"read", "splat"}
    assert all(task.is_done() for task in finished.renders)
    file = sequence / "scene2_00001.ply"
    before = file.read_bytes()
    write_ply(file, cloud_before(plane_capture, 0.9))
    tasks = plan_run(finished.request).renders
    file.write_bytes(before)

    assert [task.is_done() for task in tasks] == [task.label == "still" for task in tasks]


def test_labels_that_folders_can_bear():
    labels = ("ours+beta_temporal=0.5", "splats:a/my room (2).ply", "x=splats:b")
    assert named_splats(labels)[0] == ("ours+beta_temporal=0.5", "splats-my-room-2-", "x")
    with refused(RenderError, "a/c.ply", "b/c.ply", "splats-c", "NAME=splats:PATH"):
        named_splats(["splats:a/c.ply", "splats:b/c.ply"])
    for label in ("splats:", "a/b=splats:c"):
        with refused(RenderError, f"method {label}", "NAME=splats:PATH"):
            named_splats([label])


def test_what_is_no_scene(tmp_path, plane_capture, sequence):
    """Absent, empty, unnumbered, twice the same number, a frame that is not there, Gaussians that
    move: one line each.
    """
    messages = {
        "absent": "got no such path",
        "empty": "got none of them",
        "unnumbered": r"b\.ply: wanted a frame number in the name",
        "double": r"1\.ply and x01\.ply are both of frame 1",
        "deformed": r"point_cloud\.ply: wanted a \.ply file|deformation\.pth: wanted a file of "
        r"tensors",
    }
    for name, files in (
        ("unnumbered", ("a1", "b")),
        ("double", ("1", "x01")),
        ("deformed", ("point_cloud",)),
        ("empty", ()),
    ):
        (tmp_path / name).mkdir()
        for file in files:
            (tmp_path / name / f"{file}.ply").touch()
    (tmp_path / "deformed" / "deformation.pth").touch()
    for name, message in messages.items():
        with pytest.raises((RenderError, WeightsError), match=message):
            open_splats(tmp_path / name)
    with refused(RenderError, "frame 5", "2 of 0 to 1"):
        open_splats(sequence).render(5, plane_capture.cameras[0])


def test_a_cloud_in_nerfstudios_world_is_moved_by_the_transform_next_to_it(plane_capture, tmp_path):
    """What ns-export writes looks as in the capture's world once dataparser_transforms.json lies
    next to it; harmonics turn.
    """
    camera = plane_capture.cameras[0]
    cloud = replace(
        cloud_before(plane_capture, 0.5),
        sh=torch.randn(40, 4, 3, generator=torch.Generator().manual_seed(0)) * 0.2,
    )
    angle, scale = 0.7, 0.05
    transform = np.array(
        [[np.cos(angle), 0, np.sin(angle), 2], [0, 1, 0, 4], [-np.sin(angle), 0, np.cos(angle), -6]]
    )
    similarity = np.vstack([scale * transform, [0, 0, 0, 1]])
    write_ply(tmp_path / "splat.ply", moved_cloud(cloud, similarity))
    content = {"transform": transform.tolist(), "scale": scale}
    (tmp_path / "dataparser_transforms.json").write_text(json.dumps(content))

    picture = open_splats(tmp_path / "splat.ply").render(0, camera).image
    np.testing.assert_allclose(
        picture, render_gaussians(cloud, camera).image.clamp(max=1).numpy(), atol=1e-4
    )
    assert picture.std() > 0.02
    (note,) = splats_notes(tmp_path / "splat.ply")
    assert "dataparser_transforms.json" in note
    (tmp_path / "dataparser_transforms.json").write_text('{"transform": [[1, 2]], "scale": 0}')
    with refused(RenderError, "dataparser_transforms.json", "wanted nerfstudio's transform"):
        open_splats(tmp_path / "splat.ply")


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("cfg_args", "Namespace(white_background=True)"),
        ("config.yml", "    background_color: white"),
    ],
)
def test_settings_of_the_training_are_applied(file, line, plane_capture, tmp_path):
    """A cloud that was trained over white is drawn over white, and it is noted; its renders are
    identified by the file too.
    """
    folder, camera = tmp_path / "point_cloud" / "iteration_7000", plane_capture.cameras[0]
    folder.mkdir(parents=True)
    write_ply(folder / "point_cloud.ply", cloud_before(plane_capture, 0.2))
    before = open_splats(tmp_path).render(0, camera).image
    (tmp_path / file).write_text(line)

    assert open_splats(tmp_path).render(0, camera).image.max() > before.max() + 0.1
    assert (
        open_splats(folder / "point_cloud.ply").render(0, camera).image.max() > before.max() + 0.1
    )
    assert any(file in note and "over white" in note for note in splats_notes(tmp_path))


def test_a_normalised_world_without_its_transform_is_refused(plane_capture, tmp_path):
    """The cfg.yml of gsplat says that the world was normalised; without the transform the cloud
    belongs to no camera.
    """
    (tmp_path / "ply").mkdir()
    write_ply(tmp_path / "ply" / "point_cloud_6999.ply", cloud_before(plane_capture, 0.2))
    (tmp_path / "cfg.yml").write_text("antialiased: true\nnormalize_world_space: true\n")
    with refused(RenderError, "cfg.yml", "normalize_world_space", "point_cloud_6999.ply"):
        open_splats(tmp_path / "ply")


def test_numbers_of_iterations_and_of_frames(plane_capture, tmp_path):
    """Files numbered by iterations are one cloud, the last; numbers from 1 are the frames from 0; a
    gap shows before depth.
    """
    for frame in (1, 2):
        write_ply(
            tmp_path / "frames" / f"{frame:05d}.ply", cloud_before(plane_capture, 0.2 * frame)
        )
    for iteration in (6999, 29999):
        write_ply(
            tmp_path / "ply" / f"point_cloud_{iteration}.ply",
            cloud_before(plane_capture, iteration / 30000),
        )

    assert splats_files(tmp_path / "ply") == [tmp_path / "ply" / "point_cloud_29999.ply"]
    (note,) = splats_notes(tmp_path / "ply")
    assert re.search("iterations.*point_cloud_29999.ply", note)
    assert open_splats(tmp_path / "frames", range(2)).instants == [0, 1]
    assert any("numbered from 1 to 2" in note for note in splats_notes(tmp_path / "frames"))
    (tmp_path / "frames" / "00002.ply").rename(tmp_path / "frames" / "00003.ply")
    labels, paths = named_splats([f"moving=splats:{tmp_path / 'frames'}"])
    with refused(RenderError, "wanted a cloud of frame 0, there are 2 of 1 to 3"):
        plan = plan_run(
            RunRequest(
                tmp_path / "run",
                plane_capture,
                PROTOCOL,
                labels,
                networks=NetworkOptions(splats=paths),
            )
        )
        any(task.is_done() for task in plan.renders)
    write_ply(tmp_path / "nothing.ply", random_cloud(0, dtype=torch.float32))
    with refused(RenderError, "nothing.ply", "holds no Gaussians"):
        open_splats(tmp_path / "nothing.ply")


class Intruder:
    """What a hostile checkpoint holds: reading it as a pickle would leave a file behind."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> tuple:
        return Path.touch, (self.file,)


def test_output_of_4dgs(plane_capture, tmp_path):
    """Gaussians are moved by the field, whose file is loaded strictly and never run."""
    folder = tmp_path / "output" / "point_cloud" / "iteration_14000"
    folder.mkdir(parents=True)
    cloud, camera = random_cloud(30, dtype=torch.float32), plane_capture.cameras[0]
    write_ply(folder / "point_cloud.ply", cloud)
    field = DeformationNetwork(torch.tensor([[2.0, 2, 6], [-2, -2, 0]]), PUBLISHED)
    with torch.no_grad():
        for head in PUBLISHED.heads:
            last = getattr(field.deformation_net, f"{head}_deform")[-1]
            last.weight.zero_()
            last.bias.fill_(0.1 if head == "pos" else 0.0)
    torch.save(field.state_dict(), folder / "deformation.pth")
    expected = render_gaussians(replace(cloud, means=cloud.means + 0.1), camera).image.clamp(max=1)

    scene = open_splats(tmp_path / "output", range(4))
    np.testing.assert_allclose(scene.render(3, camera).image, expected, atol=1e-5)
    assert expected.max() > 0.2
    assert scene.size_bytes == sum(file.stat().st_size for file in folder.iterdir())

    torch.save(
        {"deformation_net.grid.aabb": Intruder(tmp_path / "ran")}, folder / "deformation.pth"
    )
    with refused(WeightsError, "deformation.pth", "tensors only"):
        open_splats(tmp_path / "output", range(4))
    assert not (tmp_path / "ran").exists()
