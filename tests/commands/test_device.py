"""Where networks compute: what is refused, what travels, and that nothing changes where nobody asks
for a GPU.
"""

import json
import pickle
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch

import ggvs_eval.compute_device
from ggvs_eval.baselines.gps_gaussian.rendering import (
    TILE,
    Gaussians,
    _tiles,
    blend_batches,
    blend_gaussians,
    footprints,
    rotation_matrices,
)
from ggvs_eval.compute_device import (
    clock_s,
    compute_device,
    computing_on,
    describe_device,
    rendering_on,
)
from ggvs_eval.errors import DeviceError
from ggvs_eval.merged_results import merge_results
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.methods.fitted import FittedMethod
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.methods.ours import ON_DEVICE
from ggvs_eval.pipelines.methods.registry import METHODS, find_method
from ggvs_eval.pipelines.methods.spec import OnlineMethod
from ggvs_eval.pipelines.play.synthesizer import OnlineSynthesizer
from ggvs_eval.pipelines.run.render import render_task
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.pipelines.run.score import _devices
from ggvs_eval.reports.page import page
from ggvs_eval.results import COLUMNS, Results
from ggvs_eval.run_folder import RunFolder, write_json
from helpers.command_line import refusal
from helpers.geometry_scenes import random_camera
from helpers.refusals import refused
from helpers.scenes import camera_at
from helpers.small_runs import small_protocol, write_small_capture

H100 = "cuda: NVIDIA H100 80GB HBM3"
LEARNED = (
    "fwd",
    "ibrnet",
    "gps-gaussian+given-depth",
    "enerf",
    "mvsplat",
    "ours",
    "ours+no-tsdf",
    "ours+no-temporal",
    "naive",
)


@pytest.fixture
def no_gpu(monkeypatch):
    """A machine without a GPU, wherever this runs."""
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


@pytest.fixture(scope="module")
def filmed_room(tmp_path_factory):
    return write_small_capture(tmp_path_factory.mktemp("rendered") / "demo", n_frames=1)


@pytest.fixture
def planned(filmed_room, tmp_path):
    """A run that nothing has been done of."""
    return plan_run(RunRequest(tmp_path / "run", filmed_room, small_protocol(1, 0, ("PSNR",))))


@pytest.mark.usefixtures("no_gpu")
def test_devices_that_are_not_there_are_refused():
    """A GPU that is not there and a name that is none are told apart; `auto` falls back to
    the CPU.
    """
    assert compute_device("auto") == compute_device("cpu") == torch.device("cpu")
    assert describe_device(torch.device("cpu")) == "cpu"
    with refused(DeviceError, "device cuda", "0 GPUs", "cpu", "CUDA"):
        compute_device("cuda")
    with refused(DeviceError, "device cuda:3", "0 GPUs"):
        compute_device("cuda:3")
    for name in ("gpu", "mps", "meta"):
        with refused(DeviceError, f"'{name}'", "cpu, cuda, cuda:N or auto"):
            compute_device(name)


@pytest.mark.usefixtures("no_gpu")
@pytest.mark.parametrize("label", LEARNED)
def test_methods_refuse_a_gpu_that_is_not_there(label):
    """Each method with networks says so when it is made, live or for a run."""
    method = find_method(label, NetworkOptions(device="cuda"))
    assert method.device == "cuda"
    with pytest.raises(DeviceError, match="finds 0 GPUs"):
        method.make()
    with pytest.raises(DeviceError, match="finds 0 GPUs"):
        OnlineSynthesizer([camera_at(0.0)], k=1, method=label, device="cuda")


@pytest.mark.usefixtures("no_gpu")
def test_the_command_line_refuses_a_gpu_before_it_begins(tmp_path):
    """Every verb that renders ends with one line and writes nothing."""
    for words in (
        ("run", tmp_path / "run"),
        ("run", tmp_path / "run", "--capture", tmp_path / "nowhere"),
        ("render", tmp_path / "run"),
        ("sweep", "k", tmp_path / "sweep"),
        ("play", tmp_path / "nowhere", tmp_path / "out.mp4"),
    ):
        assert refusal(*words, "--device", "cuda").startswith("ggvs-eval: device cuda: torch ")
        assert list(tmp_path.iterdir()) == []


def test_memory_that_is_out_is_told():
    """A GPU without room is not our bug; what was set for the picture is set back."""
    rounds = torch.backends.cudnn.allow_tf32

    def render_something() -> None:
        with rendering_on(torch.device("cpu")):
            assert not torch.backends.cudnn.allow_tf32
            raise torch.OutOfMemoryError("CUDA out of memory")

    with refused(DeviceError, "device cpu", "memory", "--jobs"):
        render_something()
    assert torch.backends.cudnn.allow_tf32 == rounds
    assert not torch.is_inference_mode_enabled()
    assert clock_s(torch.device("cpu")) > 0


def test_tensors_are_made_where_it_is_computed():
    """Arrays and fresh tensors go to the device of the context, and to the CPU without one."""
    with computing_on(torch.device("meta")):
        assert torch.as_tensor(np.zeros(2)).device.type == torch.arange(3).device.type == "meta"
    assert torch.as_tensor(np.zeros(2)).device.type == "cpu"


def test_methods_without_networks_know_no_device():
    """Their spec stays the very same; with networks it says the device, and makes what it made
    where that is the CPU.
    """
    on_gpu = NetworkOptions(device="cuda")
    for label, spec in METHODS.items():
        assert find_method(label).device == "cpu"
        learned, fitted = (
            isinstance(spec, OnlineMethod) and bool(spec.weights or spec.checkpoint),
            isinstance(spec, FittedMethod),
        )
        assert find_method(label, on_gpu).device == ("cuda" if learned or fitted else "cpu")
        assert learned == (label in LEARNED or label in ("gps-gaussian", "mvsnerf"))
    assert find_method("ours+beta_temporal=0.6", on_gpu).device == "cuda"
    assert find_method("ours+beta_temporal=0.6").make().blender.device == "cpu"


def test_a_job_knows_its_device(planned, monkeypatch):
    """On the CPU the identity says nothing of it; on a GPU it says which, and code of Warp counts
    that renders there.
    """
    monkeypatch.setattr(ggvs_eval.compute_device, "describe_device", lambda device: H100)
    unit = planned.units[0]
    for label in ("ours", "fwd"):
        spec = find_method(label)
        here, there = (
            render_task(planned.run, label, each, unit) for each in (spec, spec.on("cuda"))
        )
        assert "device" not in here.inputs
        assert there.inputs == here.inputs | {"device": H100, "code": there.inputs["code"]}
        assert (there.inputs["code"] == here.inputs["code"]) == (label == "fwd" or not ON_DEVICE)
        assert there.sha256 != here.sha256
        assert here.sha256 == render_task(planned.run, label, spec.on("cpu"), unit).sha256
        # it travels to other processes by name
        assert pickle.loads(pickle.dumps(there)).make.args[1].device == "cuda"
    plain = find_method("no-blending")
    assert (
        render_task(planned.run, "no-blending", plain.on("cuda"), unit).inputs.keys()
        == here.inputs.keys()
    )


@pytest.mark.usefixtures("no_gpu")
def test_a_planned_sweep_carries_its_device(filmed_room, tmp_path, capsys):
    """Its commands may run where there is a GPU, so that none is needed to plan them."""
    words = [
        "sweep",
        "k",
        str(tmp_path / "sweep"),
        "--capture",
        str(filmed_room.path),
        "--plan",
        str(tmp_path / "plan.json"),
    ]
    for device in ("cuda", "cpu"):
        run_command([*words, "--device", device])
        commands = [
            job["command"] for job in json.loads((tmp_path / "plan.json").read_text())["jobs"]
        ]
        assert {" ".join(command).count("--device cuda") for command in commands} == {
            int(device == "cuda")
        }


def test_results_tell_the_devices_of_their_renders(tmp_path):
    """The provenance names those that are not the CPU's, by method and view; merged results keep
    them.
    """
    run = RunFolder(tmp_path)
    for label, identity in (
        ("ours", {"device": H100}),
        ("ours+no-tsdf", {}),
        ("theirs", {"files": {}}),
    ):
        write_json(run.renders(label, "cam00") / "job.json", {"identity": identity})
    found = _devices(run, ["ours/cam00", "ours+no-tsdf/cam00", "theirs/cam00", "absent/cam00"])
    assert found == {"ours/cam00": H100}
    empty = pd.DataFrame(columns=list(COLUMNS))
    common = {"protocol_sha256": "0", "inputs": {}}
    cpu, gpu = Results(empty, common), Results(empty, common | {"devices": found})
    assert merge_results([cpu, gpu]).provenance["devices"] == found
    assert "devices" not in merge_results([cpu, cpu]).provenance


def test_the_page_renders_again_where_it_was_rendered(tmp_path):
    """The commands that make the numbers again ask for a GPU for those methods alone that
    had one.
    """
    results = Results(
        pd.DataFrame(columns=list(COLUMNS)),
        {"protocol_sha256": "0", "devices": {"ours/cam00": H100}},
    )
    run = SimpleNamespace(
        folder=RunFolder(tmp_path / "run"),
        protocol=small_protocol(1, 0, ("PSNR",)),
        results=results,
    )
    run.labels, run.has_own_truth = ("no-blending", "ours"), False
    for label in run.labels:
        write_json(run.folder.renders(label, "cam00") / "job.json", {})
    assert [command for command in page.reproduce(run, "demo") if " render " in command] == [
        "ggvs-eval render run --methods no-blending",
        "ggvs-eval render run --methods ours --device cuda",
    ]


@pytest.mark.parametrize("count", [0, 40, pytest.param(4000, marks=pytest.mark.slow)])
def test_tiles_are_blended_side_by_side_as_one_by_one(count):
    """The order of work of a GPU gives what the CPU's gives, and its gradient: few, many, tiles
    dark before their last one.
    """
    random = np.random.default_rng(5)
    camera = random_camera(random, 77, 50)
    gaussians = Gaussians(
        torch.from_numpy(random.uniform((-1.5, -1, 0.5), (1.5, 1, 3.0), (count, 3))),
        rotation_matrices(
            torch.nn.functional.normalize(
                torch.from_numpy(random.normal(size=(count, 4))).float(), dim=1
            )
        ),
        torch.from_numpy(random.uniform(0.005, 0.1, (count, 3))).float(),
        torch.from_numpy(random.uniform(0.02, 1, count)).float().requires_grad_(),
        torch.from_numpy(random.uniform(0, 1, (count, 3))).float(),
    )
    seen = footprints(gaussians, camera, 0.3)
    columns, rows = -(-camera.width // TILE), -(-camera.height // TILE)
    features = torch.cat(
        [seen.colours, seen.depths[:, None], torch.ones_like(seen.depths)[:, None]], dim=1
    )
    canvas = blend_batches(seen, features, *_tiles(seen, columns, rows), columns).view(
        rows, columns, TILE, TILE, -1
    )
    image = canvas.permute(0, 2, 1, 3, 4).reshape(rows * TILE, columns * TILE, -1)[
        : camera.height, : camera.width
    ]
    one_by_one = blend_gaussians(gaussians, camera, 0.3)
    assert bool(one_by_one.any()) == (count > 0)
    # a pixel may be done a Gaussian later
    torch.testing.assert_close(image, one_by_one, atol=2e-4, rtol=1e-4)
    if count:
        there, here = (
            torch.autograd.grad(each.square().sum(), gaussians.opacities)[0]
            for each in (image, one_by_one)
        )
        assert (there - here).norm() < 1e-3 * here.norm()
