"""Live synthesis: sources follow the target, history is kept as the method keeps it, and what does
not fit is one line.
"""

import re
import warnings
from dataclasses import fields, replace

import numpy as np
import pytest
import torch

from ggvs_eval.camera import Camera
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import CameraError, DepthError, GgvsError, RenderError
from ggvs_eval.files.images import quantise, read_image
from ggvs_eval.method import Rendering
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.offline.depth.rig_depth import RigDepth
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided
from ggvs_eval.pipelines.play.synthesizer import DEFAULT_METHOD, OnlineSynthesizer
from helpers.itermvs_weights import write_checkpoint
from helpers.packed_films import unpack_film
from helpers.photographs import psnr_db
from helpers.places import ROOT
from helpers.refusals import refused
from helpers.scenes import camera_at, instant, look

RIG = [camera_at(x) for x in (-0.45, -0.15, 0.15, 0.45)]
UNITS_PER_METRE = 2.5  # of `scenes.instant`
DOCUMENT = ROOT / "docs" / "online.md"
LIVE_RIG = ROOT / "docs" / "live_rig.md"


def seen(square_x: float = 0.0):
    looks = {camera.name: look(camera, square_x) for camera in RIG}
    return {name: image for name, (image, _) in looks.items()}, {
        name: depth for name, (_, depth) in looks.items()
    }


def synthesizer(k: int = 2, **options) -> OnlineSynthesizer:
    return OnlineSynthesizer(RIG, k, UNITS_PER_METRE, **options)


@pytest.mark.parametrize("label", [DEFAULT_METHOD, "distance-based"])
def test_steps_are_the_steps_of_the_method(label):
    """The same bits as the method gives when it is shown the same instants."""
    method, live, target = (
        find_method(label).make(),
        synthesizer(method=label),
        camera_at(0.05, name="virtual"),
    )
    for t, square_x in enumerate((0.0, 0.1, 0.2)):
        expected = method.step(instant(t, target, live.sources(target), square_x))
        np.testing.assert_array_equal(live.step(*seen(square_x), target).image, expected.image)


def test_depth_that_is_not_given_is_found():
    """The picture is that of the depth which the matcher finds, its time a stage of its own; `live`
    unless another is named.
    """
    target, (images, _) = camera_at(0.05, name="virtual"), seen()
    for options in ({}, {"depth": "sgbm"}):
        live = synthesizer(**options)
        needed = live.needed(target)
        assert {camera.name for camera in live.sources(target)} <= set(needed)
        rendering = live.step({name: images[name] for name in needed}, None, target)
        assert next(iter(rendering.seconds)) == "depth"
        assert rendering.seconds["depth"] > 0
        finder = RigDepth(RIG, DepthRunOptions(options.get("depth", "live")).options())
        depths = finder.estimate([camera.name for camera in live.sources(target)], images)
        np.testing.assert_array_equal(
            rendering.image, synthesizer().step(images, depths, target).image
        )


class Kept:
    """A method that keeps what it was shown."""

    def __init__(self, takes_device_depth):
        self.takes_device_depth, self.shown = takes_device_depth, []

    def step(self, instant):
        self.shown.append(instant)
        return Rendering(np.zeros((4, 4, 3), np.float32))


@pytest.mark.slow
def test_depth_stays_on_the_device_for_a_method_that_takes_it_there(tmp_path):
    """IterMVS' depth as tensors, of the same numbers as the arrays that any other method is
    given.
    """
    checkpoint, (images, _), shown = write_checkpoint(tmp_path / "model.ckpt"), seen(), {}
    for takes in (True, False):
        method = Kept(takes)
        live = OnlineSynthesizer(
            RIG,
            2,
            UNITS_PER_METRE,
            lambda method=method: method,
            "cpu:0",
            depth=f"itermvs:{checkpoint}",
        )
        for _ in range(2):
            live.step(images, None, camera_at(0.05, name="virtual"))
        shown[takes] = method.shown
    there, here = (shown[takes][1].sources for takes in (True, False))
    assert all(
        isinstance(view.depth, torch.Tensor) and isinstance(view.confidence, torch.Tensor)
        for view in there
    )
    assert all(
        isinstance(view.depth, np.ndarray) and isinstance(view.confidence, np.ndarray)
        for view in here
    )
    for one, other in zip(there, here, strict=True):
        np.testing.assert_array_equal(one.depth.numpy(), other.depth)
        np.testing.assert_array_equal(one.image, other.image)
        assert (one.camera.name, one.share) == (other.camera.name, other.share)


def test_sources_follow_the_target():
    """The K nearest cameras of each pose, nearest first; the view is right before and after they
    change.
    """
    live = synthesizer()
    for x, names in (
        (-0.33, ["x-0.45", "x-0.15"]),
        (0.02, ["x+0.15", "x-0.15"]),
        (0.4, ["x+0.45", "x+0.15"]),
    ):
        target = camera_at(x, name="virtual")
        assert [camera.name for camera in live.sources(target)] == names
        assert psnr_db(live.step(*seen(), target).image, look(target)[0]) > 24


def test_a_camera_of_the_rig_is_not_its_own_source():
    """A target of a source's name is synthesised from the others: leave-one-out."""
    assert RIG[1].name not in [camera.name for camera in synthesizer(k=3).sources(RIG[1])]


def test_arrays_may_be_overwritten():
    """A camera that writes each frame into the same memory gives the same bits as one that does
    not.
    """
    target, fresh, reused = camera_at(0.0, name="virtual"), synthesizer(), synthesizer()
    images, depths = seen()
    for square_x in (0.0, 0.3):
        now_images, now_depths = seen(square_x)
        for name in images:
            images[name][:], depths[name][:] = now_images[name], now_depths[name]
        expected = fresh.step(now_images, now_depths, target).image
        np.testing.assert_array_equal(reused.step(images, depths, target).image, expected)


def test_a_restart_forgets():
    """After a restart a step gives the bits of a first step; without, it does not."""
    target, live = camera_at(0.0, name="virtual"), synthesizer()
    first = live.step(*seen(), target).image
    images, depths = seen()
    noisy = {name: depth + np.float32(0.03) for name, depth in depths.items()}
    second = live.step(images, noisy, target).image
    live.restart()
    np.testing.assert_array_equal(live.step(*seen(), target).image, first)
    live.restart()
    assert not np.array_equal(live.step(images, noisy, target).image, second)


def test_confidence_comes_with_a_depth_map():
    """The method is shown the confidence of a DepthMap, and 1 where a bare array has depth."""
    shown = []

    class Watching(GeometryGuided):
        def step(self, instant):
            shown.append(instant.sources[0].confidence)
            return super().step(instant)

    live, target = synthesizer(k=1, method=Watching), camera_at(-0.5, name="virtual")
    images, depths = seen()
    depths[RIG[0].name][:5] = 0
    live.step(images, depths, target)
    live.step(
        images,
        {name: DepthMap(depth, np.full_like(depth, 0.25)) for name, depth in depths.items()},
        target,
    )
    np.testing.assert_array_equal(shown[0], depths[RIG[0].name] > 0)
    assert (shown[1] == 0.25).all()


def with_a_value(value):
    """Depth with that value in one pixel."""
    return lambda depth: np.where(
        np.indices(depth.shape).sum(axis=0) == 7, np.float32(value), depth
    )


@pytest.mark.parametrize(
    ("part", "change", "words"),
    [
        (
            0,
            None,
            r"camera virtual: wanted an image of each of its sources x\+0.15, x-0.15, got none of "
            r"x\+0.15",
        ),
        (
            0,
            lambda image: image[::2, ::2],
            r"camera x\+0.15: wanted a uint8 image of \(72, 96, 3\), got uint8 \(36, 48, 3\)",
        ),
        (0, lambda image: image / 255, r"got float64 \(72, 96, 3\); .*255 \* image"),
        (0, lambda image: image.astype(np.uint16) * 257, r"got uint16 \(72, 96, 3\); .*// 257"),
        (
            0,
            lambda image: np.dstack([image, image[..., :1]]),
            r"got uint8 \(72, 96, 4\); leave the fourth channel out",
        ),
        (
            0,
            lambda image: np.moveaxis(image, -1, 0),
            r"got uint8 \(3, 72, 96\); channels come last: np\.moveaxis",
        ),
        (0, lambda image: image[..., 0], r"got uint8 \(72, 96\); repeat grey"),
        (1, None, r"wanted depth of each of its sources .* got none of x\+0.15"),
        (
            1,
            lambda depth: depth[:-1],
            r"camera x\+0.15: wanted float depth of \(72, 96\), got float32 \(71, 96\)",
        ),
        (
            1,
            lambda depth: depth.astype(np.uint16),
            r"got uint16 \(72, 96\); .*/ 1000 \* units_per_metre",
        ),
        (
            1,
            lambda depth: DepthMap(depth, depth[:2, :2]),
            r"wanted confidence of \(72, 96\) like its depth, got \(2, 2\)",
        ),
        (
            1,
            with_a_value(np.nan),
            r"camera x\+0.15: depth must be finite and not negative, got nan",
        ),
        (1, with_a_value(-1), r"got -1 \.\. 5"),
        (1, with_a_value(np.inf), r"\.\. inf; write 0"),
    ],
)
def test_what_does_not_fit_is_one_line(part, change, words):
    """The camera, what was wanted and what came; the next step works as if nothing had been."""
    live, untouched, target = synthesizer(), synthesizer(), camera_at(0.02, name="virtual")
    given, name = seen(), RIG[2].name
    if change is None:
        del given[part][name]
    else:
        given[part][name] = change(given[part][name])
    with pytest.raises((RenderError, DepthError), match=words) as caught:
        live.step(*given, target)
    assert "\n" not in str(caught.value)
    np.testing.assert_array_equal(
        live.step(*seen(), target).image, untouched.step(*seen(), target).image
    )


def doubts_of(step) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        step()
    return [str(each.message) for each in caught if issubclass(each.category, UserWarning)]


def test_what_is_hardly_meant_is_said_once():
    """Depth in millimetres, a normalised K and a target far off the rig give one warning each, with
    the number and the mend.
    """
    images, depths = seen()
    in_millimetres = {name: depth * np.float32(1000) for name, depth in depths.items()}
    live, target = synthesizer(), camera_at(0.02, name="virtual")
    (said,) = doubts_of(lambda: [live.step(images, in_millimetres, target) for _ in range(2)])
    assert "near..far" in said
    assert "divide millimetres by 1000" in said
    far_off = camera_at(50.0, name="virtual")
    (said,) = doubts_of(
        lambda: [synthesizer(sources="nearest").step(images, depths, far_off) for _ in range(1)]
    )
    assert "is 49.55 units from the nearest camera" in said
    normalised = [
        replace(camera, K=np.diag([1 / camera.width, 1 / camera.height, 1]) @ camera.K)
        for camera in RIG
    ]
    (said,) = doubts_of(lambda: OnlineSynthesizer(normalised, 2))
    assert "K is in pixels" in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"k": 5}, "wanted 1 to 4 source views, got 5"),
        ({"k": 0}, "got 0"),
        ({"method": "ours-geometrc"}, "did you mean ours-geometric"),
        (
            {"method": "ours-geometric+offline"},
            "needs the whole sequence before its first step; choose an online method",
        ),
        ({"cameras": [*RIG, RIG[0]]}, "wanted each camera once, got x-0.45 several times"),
        (
            {"units_per_metre": float("nan")},
            "wanted a positive number of world units per metre, got nan",
        ),
    ],
)
def test_a_rig_that_cannot_work_is_refused(arguments, words):
    """Before any frame is seen."""
    with pytest.raises(GgvsError, match=words):
        OnlineSynthesizer(**{"cameras": RIG, "k": 2, **arguments})


def test_too_few_cameras_beside_the_target():
    """As many sources as cameras, and the target is one of them."""
    with refused(CameraError, "4 source cameras", "3 others"):
        synthesizer(k=4).step(*seen(), RIG[0])


@pytest.mark.slow
@pytest.mark.skipif(not DOCUMENT.is_file(), reason="reads the checkout")
def test_the_example_of_the_page_works(tmp_path, monkeypatch):
    """The code of docs/online.md, run as it stands on a small demo capture, writes views that
    resemble what is rendered there.
    """
    unpack_film("path", tmp_path / "room", with_depth=False)
    (example,) = re.findall(
        r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), flags=re.DOTALL
    )
    code = [line for line in example.splitlines() if line and not line.startswith("from ")]
    monkeypatch.chdir(tmp_path)

    names: dict = {}
    exec(compile(example, str(DOCUMENT), "exec"), names)

    assert len(code) <= 14  # of 100 columns; ten of 130 before
    assert [file.name for file in sorted((tmp_path / "view").iterdir())] == [
        f"{t:04d}.png" for t in range(4)
    ]
    for t in range(4):
        view, rendered = (
            read_image(tmp_path / "view" / f"{t:04d}.png"),
            names["room"].frame("cam01", t),
        )
        assert view.shape == rendered.shape
        assert psnr_db(
            view / 255.0, quantise(np.full(rendered.shape, rendered.mean() / 255))
        ) < psnr_db(view / 255.0, rendered)


@pytest.mark.skipif(not LIVE_RIG.is_file(), reason="reads the checkout")
def test_the_live_rig_of_the_page_works(tmp_path, monkeypatch, capsys):
    """The code of docs/live_rig.md, run as it stands, gives the wall as seen between the cameras;
    every field is explained.
    """
    text = LIVE_RIG.read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(compile(example, str(LIVE_RIG), "exec"), names)
    left = round(names["FOCAL_PX"] * 0.34 / names["WALL_M"])
    assert psnr_db(names["picture"] / 255.0, names["wall"][:, left : left + names["WIDTH"]]) > 25
    assert len(capsys.readouterr().out.splitlines()) == 3
    assert len([line for line in example.splitlines() if line]) <= 34
    given = [field.name for field in fields(Camera) if not field.kw_only]
    assert f"`Camera({', '.join(given)})`" in text
    assert all(re.search(rf"^\|.*`{name}`.* \|", text, flags=re.MULTILINE) for name in given)
