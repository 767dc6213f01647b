"""Advice is followed once: the command, the edit or the form that a refusal names makes its input
open.
"""

import ast
import json
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

import ggvs_eval.datasets
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.camera_frames import find_rig_frames
from ggvs_eval.datasets.find_cameras import file_marks
from ggvs_eval.datasets.instants import write_pairing
from ggvs_eval.errors import CaptureError, RenderError
from ggvs_eval.files import listing, video
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import VideoFrames, write_video
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.inspection.capture import check, frames
from ggvs_eval.pipelines.inspection.capture.frames import TO_SDR
from ggvs_eval.renders import view_streams
from ggvs_eval.renders.request import FrameRequest
from helpers.calibration_files import write_opencv
from helpers.captures import (
    NAMES,
    make_image,
    make_rig,
    refusal,
    write_colmap,
    write_colmap_model,
    write_dynerf,
    write_folders,
    write_poses,
    write_videos,
)
from helpers.community_layouts import write_panoptic
from helpers.fuzz import write_d3dmv
from helpers.packed_films import unpack_film
from helpers.small_layouts import (
    camera_toml,
    opencv_K,
    transforms,
    write_capture_toml,
    write_easymocap,
    write_nerfstudio,
    write_storage,
)
from helpers.small_rig import film, make_cameras, write_rig

# Commands that refusals and notes of captures print


def ffmpeg(line: str, folder: Path, **files: str) -> None:
    """Run a printed line in a folder; words in capitals are the names of files."""
    program = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    words = [files.get(word.partition(".")[0], word) for word in shlex.split(line)]
    assert words[0] == "ffmpeg"
    subprocess.run(
        [program, "-v", "error", "-y", *words[1:]], cwd=folder, check=True, capture_output=True
    )


def quoted(message: str, program: str = "ggvs-eval") -> list[str]:
    """The words of the command in quotes that a message names."""
    (command,) = dict.fromkeys(re.findall(rf"['`]({program} [^'`]*)['`]", message))
    return shlex.split(command)


def call(words: list[str], **places: Path) -> None:
    """Run a command of this package as it is printed; words in capitals are places."""
    run_command([str(places.get(word, word)) for word in words[1:]])


def follow_unread_videos(folder: Path) -> None:
    """A video in a container that is not read."""
    write_dynerf(folder)
    ffmpeg("ffmpeg -i cam02.mp4 cam02.avi", folder)
    (folder / "cam02.mp4").unlink()
    (line,) = re.findall(r"ffmpeg -i \S+ -crf 8 [\w.]+", refusal(folder))
    ffmpeg(line, folder)
    assert open_capture(folder).camera_names == NAMES


def follow_copy(folder: Path) -> None:
    """A video without an index, whose name says MP4."""
    write_dynerf(folder)
    ffmpeg("ffmpeg -i cam02.mp4 -c copy -f matroska IN", folder, IN="raw")
    shutil.move(folder / "raw", folder / "cam02.mp4")
    line = refusal(folder).rpartition("copy it: ")[2]
    shutil.move(folder / "cam02.mp4", folder / "raw")
    ffmpeg(line, folder, IN="raw", OUT="cam02.mp4")
    (folder / "raw").unlink()
    assert open_capture(folder).camera_names == NAMES


def noted(folder: Path, words: str) -> str:
    """The note of a capture with some words; empty if there is none."""
    return next((note for note in open_capture(folder).notes if words in note), "")


def follow_note(folder: Path, make: str, words: str) -> None:
    """A note on videos with a line that makes others of them, of which nothing is to be said."""
    write_dynerf(folder)
    for name in NAMES:
        ffmpeg(make, folder, IN=f"{name}.mp4", OUT="raw.mp4")
        shutil.move(folder / "raw.mp4", folder / f"{name}.mp4")
    (line,) = re.findall(r"ffmpeg -i IN .*?OUT\.mp4", noted(folder, words))
    for name in NAMES:
        ffmpeg(line, folder, IN=f"{name}.mp4", OUT="raw.mp4")
        shutil.move(folder / "raw.mp4", folder / f"{name}.mp4")
    assert not noted(folder, words)


def follow_deinterlacing(folder: Path) -> None:
    """Two instants in each frame."""
    follow_note(
        folder, "ffmpeg -i IN -vf setfield=tff -c:v libx264 -flags +ilme+ildct OUT", "interlaced"
    )


def follow_tags(folder: Path) -> None:
    """Colour that no tag states."""
    follow_note(
        folder, "ffmpeg -i IN -vf setparams=colorspace=unknown -c:v libx264 OUT", "no tag states"
    )


def follow_tone_mapping(folder: Path) -> None:
    """Levels of high dynamic range; `check` prints the line."""
    write_dynerf(folder)
    hlg = "setparams=color_trc=arib-std-b67:color_primaries=bt2020:colorspace=bt2020nc"
    ffmpeg(f"ffmpeg -i IN -vf {hlg} -c:v libx264 OUT", folder, IN="cam02.mp4", OUT="raw.mp4")
    assert VideoFrames(folder / "raw.mp4").transfer == "HLG"
    ffmpeg(TO_SDR, folder, IN="raw.mp4", OUT="cam02.mp4")
    assert not VideoFrames(folder / "cam02.mp4").transfer
    (folder / "raw.mp4").unlink()
    assert open_capture(folder).n_frames == 5


def follow_steps(folder: Path) -> None:
    """Videos of other rates, lengths and lost frames: one line for all of them, and no second
    round.
    """
    write_poses(folder, make_rig())
    for index, (name, fps, n_frames) in enumerate(
        zip(NAMES, (30, 25, 30, 30), (24, 20, 22, 30), strict=True)
    ):
        write_video(folder / f"{name}.mp4", (make_image(index, 0) for _ in range(n_frames)), fps)
    ffmpeg(
        "ffmpeg -i IN -vf 'select=not(eq(n\\,7))' -fps_mode vfr OUT",
        folder,
        IN="cam03.mp4",
        OUT="raw.mp4",
    )
    shutil.move(folder / "raw.mp4", folder / "cam03.mp4")
    message = refusal(folder)
    assert "got cam00 24, cam01 20, cam02 22, cam03 29" in message
    call([*quoted(message), "--out", "JSON"], JSON=folder.with_name("check.json"))
    capture = open_capture(folder)
    assert (capture.n_frames, capture.fps) == (17, 25.0)
    # every sixth of 30 has no partner among 25
    assert not any("jumps after frame 2," in note for note in capture.notes)


def follow_repeats(folder: Path) -> None:
    """A camera that recorded 25 frames per second, stored as 30: its line leaves the repeats out,
    that of the rates follows.
    """
    cameras = make_cameras()
    footage = {camera.name: film(camera) for camera in cameras}
    odd = cameras[3].name
    footage[odd] = [footage[odd][frame * 5 // 6] for frame in range(len(footage[odd]))]
    write_rig(folder, cameras, footage)
    found = next(
        finding
        for finding in check.check_capture(folder).of("frozen frames")
        if finding.subject == odd
    )
    assert (found.verdict, found.values["recorded_fps"]) == ("bad", 25.0)
    ffmpeg(found.advice.rpartition(": ")[2], folder, IN=f"{odd}.mp4", OUT="raw.mp4")
    shutil.move(folder / "raw.mp4", folder / f"{odd}.mp4")
    assert check.pair_by_time(folder)
    checked = check.check_capture(folder)
    assert open_capture(folder).fps == 25.0
    assert {finding.verdict for finding in checked.of("frozen frames")} == {"ok"}


def follow_chapters(folder: Path) -> None:
    """Recordings that a camera cut into chapters."""
    for index in range(2):
        for chapter in (1, 2):
            images = [make_image(index, frame) for frame in range(3)]
            write_video(folder / f"GX{chapter:02d}{index:04d}.mp4", images, 30)
    with pytest.raises(CaptureError) as caught:
        find_rig_frames(folder)
    (entry,) = re.findall(r'write "(file .*?)" and the like into LIST', str(caught.value))
    line = str(caught.value).rpartition("then ")[2]
    for index in range(2):
        names = [
            entry.replace("GX010000.MP4", f"GX{chapter:02d}{index:04d}.mp4") for chapter in (1, 2)
        ]
        (folder / "list").write_text("\n".join(names))
        (folder / "joined").mkdir(exist_ok=True)
        ffmpeg(line, folder, LIST="list", OUT=f"joined/cam{index}.mp4")
    assert [frames.n_frames for frames in find_rig_frames(folder / "joined").values()] == [6, 6]


def follow_halves(folder: Path) -> None:
    """Both eyes of a ZED in one picture."""
    wide = [np.hstack([make_image(0, frame), make_image(1, frame)]) for frame in range(3)]
    write_video(folder / "zed.mp4", wide, 30)
    (folder / "SN12345678.conf").write_text("[LEFT_CAM_HD]\nfx=1")
    message = refusal(folder)
    crops = re.findall(r"crop=[\w/:]+", message)
    rig = make_rig(("left", "right"))
    for camera, crop in zip(rig, crops, strict=True):
        ffmpeg(f"ffmpeg -i IN -vf {crop} OUT", folder, IN="zed.mp4", OUT=f"{camera.name}.mp4")
    assert "write K into capture.toml" in message
    (folder / "capture.toml").write_text(
        "".join(camera_toml(camera, f"{camera.name}.mp4") for camera in rig)
    )
    assert open_capture(folder).n_frames == 3


def follow_rate_of_renders(folder: Path) -> None:
    """Renders of another rate and number: their line repeats the nearest frames."""
    write_video(folder / "cam00.mp4", (make_image(0, frame) for frame in range(8)), 24)
    request = FrameRequest(
        "mine", ("cam00",), range(10), 12, {"cam00": (64, 48)}, NAMES, folder, fps=30.0
    )
    with pytest.raises(RenderError) as caught:
        view_streams.find_videos(folder, request, is_temporary=False)
    (folder / "new").mkdir()
    ffmpeg(str(caught.value).rpartition(": ")[2], folder, **{"OUT/cam00": "new/cam00.mp4"})
    found = view_streams.find_videos(folder / "new", request, is_temporary=False)
    assert found.views["cam00"].numbers == tuple(range(10))
    shown = VideoFrames(folder / "new" / "cam00.mp4").frames(0, 10)
    given = [*VideoFrames(folder / "cam00.mp4").frames(0, 8)]
    nearest = [
        int(np.argmin([np.abs(image.astype(int) - frame).mean() for frame in given]))
        for image in shown
    ]
    assert max(abs(index / 24 - number / 30) for number, index in enumerate(nearest)) < 1 / 30


def follow_raw_videos(folder: Path) -> None:
    """Videos without poses: what `check` advises where nothing else is wrong."""
    unpack_film("deep", folder, with_depth=False)
    (folder / "poses_bounds.npy").unlink()
    (advice,) = {
        finding.advice
        for finding in check.check_capture(folder).findings
        if "calibrate" in finding.advice
    }
    call(shlex.split(advice.partition(",")[0]), RIG=folder.with_name("rig"))
    assert open_capture(folder.with_name("rig")).n_frames == 2


def follow_cards(folder: Path) -> None:
    """Videos one folder deeper than usual: the refusal of other commands."""
    unpack_film("deep", folder, with_depth=False)
    (folder / "poses_bounds.npy").unlink()
    for file in folder.glob("*.mp4"):
        (folder / file.stem).mkdir()
        file.rename(folder / file.stem / "GX010023.MP4")
    call(quoted(refusal(folder)), RIG=folder.with_name("rig"))
    assert open_capture(folder.with_name("rig")).n_frames == 2


def follow_several_sets(folder: Path) -> None:
    """Two sets of videos that are equally good."""
    for name in ("first", "second"):
        unpack_film("deep", folder / name / "recordings", with_depth=False)
        (folder / name / "recordings" / "poses_bounds.npy").unlink()
        (folder / name / "recordings" / "demo.json").unlink()
    message = refusal(folder)
    call(
        quoted(message),
        FOLDER=folder / re.findall(r"got several: (\S*?)CAM", message)[0],
        RIG=folder.with_name("rig"),
    )
    assert open_capture(folder.with_name("rig")).n_frames == 2


def follow_lenses(folder: Path) -> None:
    """Intrinsics without poses."""
    unpack_film("deep", folder, with_depth=False)
    for camera in open_capture(folder).cameras:
        entries = {"camera_matrix": opencv_K(camera), "image_width": 160, "image_height": 120}
        write_storage(
            folder / f"{camera.name}.yml", entries | {"distortion_coefficients": np.zeros((1, 5))}
        )
    for name in ("poses_bounds.npy", "demo.json"):
        (folder / name).unlink()
    call(quoted(refusal(folder)), RIG=folder.with_name("rig"))
    assert open_capture(folder.with_name("rig")).n_frames == 2


def follow_first_instant(folder: Path) -> None:
    """A folder per instant without a model."""
    film = open_capture(unpack_film("deep", folder.with_name("film"), with_depth=False))
    for frame in range(2):
        for name in film.camera_names:
            write_image(
                folder / f"frame{frame:06d}" / "images" / f"{name}.png", film.frame(name, frame)
            )
    message = refusal(folder)
    call(quoted(message), RIG=folder.with_name("rig"))
    assert "copy its sparse/ there" in message
    shutil.copytree(folder.with_name("rig") / "sparse", folder / "frame000000" / "sparse")
    assert open_capture(folder).layout == "3dgstream"


def follow_undistort(folder: Path) -> None:
    """Frames of a layout that has no folder, picture or video per camera."""
    write_d3dmv(folder)
    with pytest.raises(CaptureError) as caught:
        find_rig_frames(folder)
    call([*quoted(str(caught.value)), str(folder), "RIG"], RIG=folder.with_name("rig"))
    assert len(find_rig_frames(folder.with_name("rig"))) > 1


def follow_crop(folder: Path) -> None:
    """Frames that are a part of the calibrated picture."""
    write_colmap(folder)
    for index, name in enumerate(NAMES):
        write_image(folder / "images" / f"{name}.png", make_image(index, 0)[:40])
    call([*quoted(refusal(folder)), "--out", "JSON"], JSON=folder.with_name("check.json"))
    assert open_capture(folder).cameras[0].size == (64, 40)


def follow_track(folder: Path) -> None:
    """Depth and colour in one file: the track that is marked is read, the line takes another."""
    write_dynerf(folder)
    for index, name in enumerate(NAMES):
        write_video(
            folder / "depth", (np.full((48, 64, 3), 40 * index, np.uint8) for _ in range(5)), 30
        )
        both = "-map 0 -map 1 -c copy -disposition:v:0 0 -disposition:v:1 default"
        ffmpeg(f"ffmpeg -i depth -i {name}.mp4 {both} OUT", folder, OUT="raw.mp4")
        (folder / "raw.mp4").rename(folder / f"{name}.mp4")
    (folder / "depth").unlink()
    (line,) = re.findall(r"ffmpeg -i IN .*?OUT\.mp4", noted(folder, "from track 1 of 2"))
    colour = open_capture(folder).frame("cam03", 0)
    assert np.ptp(colour) > 100
    for name in NAMES:
        ffmpeg(line.replace("TRACK", "0"), folder, IN=f"{name}.mp4", OUT="raw.mp4")
        shutil.move(folder / "raw.mp4", folder / f"{name}.mp4")
    assert np.ptp(open_capture(folder).frame("cam03", 0)) < 10


def follow_linear_light(folder: Path) -> None:
    """OpenEXR pictures of a scene that names them."""
    write_nerfstudio(folder)
    images = folder / "images"
    before = cv2.imread(str(images / "cam01.png"))
    for file in sorted(images.glob("*.png")):
        image = (cv2.imread(str(file)) / 255.0) ** 2.2
        file.with_suffix(".raw").write_bytes(
            np.asarray(image[..., [1, 0, 2]].transpose(2, 0, 1), "<f4").tobytes()
        )
        size = f"{image.shape[1]}x{image.shape[0]}"
        ffmpeg(
            f"ffmpeg -f rawvideo -pix_fmt gbrpf32le -s {size} -i {file.stem}.raw -frames:v 1 "
            f"{file.stem}.exr",
            images,
        )
        file.unlink()
    frames = [
        {**frame, "file_path": frame["file_path"].replace("png", "exr")}
        for frame in transforms()["frames"]
    ]
    changed_json(folder / "transforms.json", frames=frames)
    line = refusal(folder).rpartition(": ")[2]
    for file in images.glob("*.exr"):
        ffmpeg(line, images, IN=file.name, OUT=f"{file.stem}.png")
        file.unlink()
    assert len(open_capture(folder).cameras) == len(NAMES)
    assert np.abs(cv2.imread(str(images / "cam01.png")).astype(int) - before).max() < 8


def follow_pictures_side_by_side(folder: Path) -> None:
    """Two cameras in each picture."""
    wide = [np.hstack([make_image(0, frame), make_image(1, frame)]) for frame in range(3)]
    for frame, image in enumerate(wide):
        write_image(folder / "rgb" / f"{frame}.png", image)
    rig = make_rig(("left", "right"))
    write_opencv(folder, rig)
    line = refusal(folder).rpartition("folder per camera, ")[2].removesuffix(" for the first")
    for camera, left in zip(rig, ("0", "iw/2"), strict=True):
        (folder / camera.name).mkdir()
        crop = line.replace("OUT.mp4", f"{camera.name}/%d.png").replace(":0:0", f":{left}:0")
        ffmpeg(crop, folder, IN="rgb/%d.png")
    shutil.rmtree(folder / "rgb")
    assert open_capture(folder).n_frames == 3


# What a printed command contains -> the case that follows it.
COMMANDS: dict[str, Callable[[Path], None]] = {
    "ffmpeg -i {source} -crf 8": follow_unread_videos,
    "ffmpeg -i IN -c copy OUT.mp4": follow_copy,
    "-vf bwdif": follow_deinterlacing,
    "-bsf:v h264_metadata": follow_tags,
    "tonemap=mobius": follow_tone_mapping,
    "ggvs-eval check {path} --repair": follow_steps,
    "-map 0:v:TRACK": follow_track,
    "zscale=tin=linear": follow_linear_light,
    "crop=iw/{n_beside}": follow_pictures_side_by_side,
    "-vf decimate": follow_repeats,
    "-f concat": follow_chapters,
    "crop=iw/2": follow_halves,
    "ffmpeg -i {video.path.name}": follow_rate_of_renders,
    "ggvs-eval calibrate {capture.path} RIG": follow_raw_videos,
    "ggvs-eval calibrate {path} RIG": follow_cards,
    "ggvs-eval calibrate FOLDER RIG": follow_several_sets,
    "--known-intrinsics {path}": follow_lenses,
    "ggvs-eval calibrate {first} RIG": follow_first_instant,
    "ggvs-eval undistort": follow_undistort,
    "ggvs-eval check {path} --crop": follow_crop,
}
# Commands that a test cannot follow here, or that are followed elsewhere.
ELSEWHERE = {
    "ggvs-eval demo": "films a room, tests/contrib/worlds",
    "ggvs-eval get": "fetches, tests/datasets/test_public_captures.py",
    "ggvs-eval calibrate --known-poses": "tests/offline/test_calibrate.py",
    "exiftool": "a program that is not at hand",
    "mkvmerge": "a program that is not at hand",
    "by `ggvs-eval check`": "a source",
    "by COLMAP (`ggvs-eval calibrate`)": "a source",
}
PRINTS = re.compile(r"ffmpeg -|ggvs-eval [a-z]+|exiftool")


def texts(file: Path) -> Iterator[str]:
    """The texts of a module but for docstrings, with the expressions in them in braces; the advice
    of a table.
    """
    if file.suffix == ".toml":
        yield from re.findall(r'= "(.*)"', file.read_text())
        return
    tree = ast.parse(file.read_text())
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    parts = {
        id(value)
        for node in ast.walk(tree)
        if isinstance(node, ast.JoinedStr)
        for value in node.values
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(
                v.value if isinstance(v, ast.Constant) else f"{{{ast.unparse(v.value)}}}"
                for v in node.values
            )
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in docstrings | parts
        ):
            yield node.value


def test_every_printed_command_is_followed():
    """None of a reader, nor of an opening, is without a case below."""
    folder = Path(ggvs_eval.datasets.__file__).parent
    files = [
        *folder.glob("*.py"),
        *folder.glob("*.toml"),
        *(Path(str(m.__file__)) for m in (listing, video, view_streams, check, frames)),
    ]
    printed = [text for file in files for text in texts(file) if PRINTS.search(text)]
    assert len(printed) >= len(COMMANDS) - 1
    assert [
        text for text in printed if not any(mark in text for mark in (*COMMANDS, *ELSEWHERE))
    ] == []


@pytest.mark.slow
@pytest.mark.parametrize("follow", COMMANDS.values(), ids=lambda follow: follow.__name__)
def test_a_printed_command_is_followed(tmp_path, follow):
    """It ends well, and what was refused opens."""
    follow(tmp_path / "room")


# Forms that the refusal of an unread calibration advises


def write_sequence(folder: Path) -> None:
    """A sequence of one RGB-D camera."""
    for index, camera in enumerate(make_rig()):
        write_image(folder / "images" / f"{index}.png", make_image(index, 0))
        (folder / "depth").mkdir(exist_ok=True)
        cv2.imwrite(
            str(folder / "depth" / f"{index}.png"),
            np.full((camera.height, camera.width), 3000 + index, np.uint16),
        )
    poses = [np.linalg.inv(camera.world_to_camera).ravel() for camera in make_rig()]
    np.savetxt(folder / "poses.txt", poses)
    np.savetxt(folder / "K.txt", make_rig()[0].K)


def write_rows(folder: Path) -> None:
    """Folders of pictures and a row for each in poses_bounds.npy."""
    write_poses(folder, make_rig())
    write_folders(folder, pattern="frames/{}")


def write_lenses(folder: Path) -> None:
    """OpenCV's YAML of each camera beside its video."""
    write_videos(folder)
    write_opencv(folder, make_rig())


FORMS: dict[str, Callable[[Path], object]] = {
    "capture.toml": write_capture_toml,
    "transforms.json": write_nerfstudio,
    "sparse/0": write_colmap,
    "OpenCV's YAML": write_lenses,
    "intri.yml and extri.yml": write_easymocap,
    "images/, depth/, poses.txt and K.txt": write_sequence,
    "poses_bounds.npy": write_rows,
}
# What a file holds for the content that a mark asks for, where that is no plain text.
CONTENTS = {
    r"<document[^>]*>\s*<chunk": "<document>\n<chunk",
    r'"shots"\s*:': '"shots":',
    r"extrinsic\s": "extrinsic\n",
    r"\A\s*\d+\s+\S+\.(png|jpg|ppm)\s": "1\na.png 1",
    r"(?m)^(cam0=|P0:|P_rect_00:|S_00:)": "P0: 1",
    r"\A\s*\d+ \d+ \d+\s+(\S+\s+){3}\S+\s*\n": "0 0 1\n1 0 0 0\n",
    r'"perFrameIntrinsicCoeffs"|"poses".*"(initPose|K)"': '"perFrameIntrinsicCoeffs"',
    r"(?s)\A(Kaydara FBX|; FBX|#usda|PXR-USDC|Ogawa|BLENDER|.HDF.*Alembic)": "#usda",
    r'"cam_from_rig|"ref_(camera_id|sensor)"': '"cam_from_rig',
    r'"\[[-+.\de]+ [-+.\de]+ [-+.\de]+ [-+.\de]+\] \[': '"[1 0 0 0] [',
}


def marked_file(folder: Path, mark: dict[str, str]) -> None:
    """A file that a mark knows."""
    name = re.sub(r"\[(.).*?\]", r"\1", mark["pattern"]).replace("y*ml", "yaml").replace("*", "0")
    content = CONTENTS.get(
        mark.get("content", ""), mark.get("content", "x").split("|")[0].removeprefix("\\A")
    )
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(content)


def alternatives() -> Iterator[pytest.ParameterSet]:
    """Every mark with each form that its advice names."""
    for mark in file_marks():
        forms = [form for form in FORMS if form in mark["advice"]]
        assert forms, mark
        yield from (
            pytest.param(mark, FORMS[form], id=f"{mark['pattern']} {form}") for form in forms
        )


@pytest.mark.parametrize(("mark", "write"), [*alternatives()])
def test_the_form_that_is_advised_opens_beside_the_file(tmp_path, mark, write):
    """The file stays where it is."""
    marked_file(tmp_path, mark)
    assert mark["advice"] in refusal(tmp_path)
    write(tmp_path)
    assert len(open_capture(tmp_path).cameras) > 1


# Edits that refusals advise


def replaced(file: Path, old: str, new: str) -> None:
    """A text file with other words, which it must have."""
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


def changed_json(file: Path, **values: object) -> None:
    """A table with other entries; those of None are taken out."""
    table = json.loads(file.read_text()) | values
    file.write_text(json.dumps({key: value for key, value in table.items() if value is not None}))


Edit = Iterator[Path | None]


def edit_empty_folder(folder: Path) -> Edit:
    folder.mkdir()
    yield
    write_dynerf(folder)


def edit_another_file(folder: Path) -> Edit:
    write_dynerf(folder)
    yield folder / "cam00.mp4"
    yield folder


def edit_a_level_too_high(folder: Path) -> Edit:
    write_dynerf(folder / "scenes" / "room")
    yield
    yield folder / "scenes" / "room"


def edit_name_of_a_camera(folder: Path) -> Edit:
    write_capture_toml(folder)
    replaced(folder / "capture.toml", '"cam01"', '"left/1"')
    yield
    replaced(folder / "capture.toml", '"left/1"', '"left 1"')


def edit_equal_names(folder: Path) -> Edit:
    write_capture_toml(folder)
    replaced(folder / "capture.toml", '"cam01"', '"cam00"')
    yield
    replaced(folder / "capture.toml", '"cam00"', '"cam01"')


def edit_near_alone(folder: Path) -> Edit:
    write_capture_toml(folder)
    replaced(folder / "capture.toml", "width", "near = 1.0\nwidth")
    yield
    replaced(folder / "capture.toml", "width", "far = 9.0\nwidth")


def edit_masks(folder: Path) -> Edit:
    write_capture_toml(folder)
    write_image(folder / "mask.png", make_image(0, 0))
    replaced(folder / "capture.toml", "width", 'mask = "mask.png"\nwidth')
    yield
    replaced(folder / "capture.toml", 'mask = "mask.png"\n', "")


def edit_leading_zeros(folder: Path) -> Edit:
    write_dynerf(folder)
    (folder / "cam03.mp4").rename(folder / "cam3.mp4")
    yield
    (folder / "cam3.mp4").rename(folder / "cam03.mp4")


def edit_two_of_a_number(folder: Path) -> Edit:
    write_rows(folder)
    for file in list((folder / "frames" / "cam00").iterdir()):
        shutil.copy(file, file.with_name(f"other_{file.name}"))
    yield
    (folder / "elsewhere").mkdir()
    for file in (folder / "frames" / "cam00").glob("other_*"):
        file.rename(folder / "elsewhere" / file.name)


def edit_gap(folder: Path) -> Edit:
    write_rows(folder)
    for name in NAMES:
        (folder / "frames" / name / "0004.png").rename(folder / "frames" / name / "0009.png")
    yield
    for name in NAMES:
        (folder / "frames" / name / "0009.png").rename(folder / "frames" / name / "0004.png")


def edit_lengths(folder: Path) -> Edit:
    write_rows(folder)
    write_image(folder / "frames" / "cam02" / "0005.png", make_image(2, 0))
    yield
    write_pairing(folder)


def edit_parts(folder: Path) -> Edit:
    """Videos that are called by the numbers of their first frames; their joining is followed with
    chapters.
    """
    for name in NAMES:
        write_videos(folder / name, ("0",))
        write_videos(folder / name, ("5",))
    yield
    for name in NAMES:
        shutil.rmtree(folder / name)
    write_lenses(folder)


def edit_two_files_of_a_camera(folder: Path) -> Edit:
    write_lenses(folder)
    shutil.copy(folder / "cam01.mp4", folder / "cam01.MOV")
    yield
    (folder / "elsewhere").mkdir()
    (folder / "cam01.MOV").rename(folder / "elsewhere" / "old.MOV")


def edit_proxies(folder: Path) -> Edit:
    write_lenses(folder)
    write_videos(folder, [f"{name}_Proxy" for name in NAMES])
    for name in NAMES:
        (folder / f"{name}.yml").unlink()
    yield
    folder.with_name("elsewhere").mkdir()
    for file in folder.glob("*_Proxy.mp4"):
        file.rename(folder.with_name("elsewhere") / file.name)
    write_opencv(folder, make_rig())


def edit_names_of_videos(folder: Path) -> Edit:
    write_videos(folder / "recordings", ["left", "right", "top", "low"])
    write_opencv(folder, make_rig())
    yield
    for name, camera in zip(("left", "right", "top", "low"), NAMES, strict=True):
        (folder / "recordings" / f"{name}.mp4").rename(folder / "recordings" / f"{camera}.mp4")


def edit_no_frames(folder: Path) -> Edit:
    folder.mkdir()
    write_opencv(folder, make_rig())
    yield
    write_videos(folder)


def edit_several_scenes(folder: Path) -> Edit:
    write_d3dmv(folder)
    for suffix in (".h5", "_pb.npy"):
        shutil.copy(folder / f"scene000{suffix}", folder / f"scene001{suffix}")
    yield
    yield folder / "scene001.h5"


def edit_size_of_K(folder: Path) -> Edit:
    write_nerfstudio(folder)
    changed_json(folder / "transforms.json", w=128, h=96)
    yield
    changed_json(folder / "transforms.json", w=64, h=48)


def edit_lens(folder: Path) -> Edit:
    write_nerfstudio(folder)
    changed_json(folder / "transforms.json", ftheta_p1=0.01)
    yield
    changed_json(folder / "transforms.json", ftheta_p1=None, k1=0.01)


def edit_camera_model(folder: Path) -> Edit:
    write_nerfstudio(folder)
    changed_json(folder / "transforms.json", camera_model="FISHEYE624")
    yield
    changed_json(folder / "transforms.json", camera_model="PINHOLE")


def edit_two_lenses(folder: Path) -> Edit:
    write_nerfstudio(folder)
    changed_json(folder / "transforms.json", camera_model="OPENCV", is_fisheye=True)
    yield
    changed_json(folder / "transforms.json", camera_model=None)


def edit_instants(folder: Path) -> Edit:
    write_nerfstudio(folder)
    frames = transforms()["frames"]
    for index, frame in enumerate(frames):
        frame["time"] = index
    changed_json(folder / "transforms.json", frames=frames)
    yield
    (folder / "transforms.json").rename(folder.with_name("transforms.json"))
    shutil.rmtree(folder / "images")
    write_videos(folder)
    write_opencv(folder, make_rig())


def edit_moving_camera(folder: Path) -> Edit:
    write_panoptic(folder)
    table = json.loads((folder / "train_meta.json").read_text())
    poses = np.array(table["w2c"])
    poses[1, 0, 0, 3] += 0.01
    changed_json(folder / "train_meta.json", w2c=poses.tolist())
    yield
    changed_json(folder / "train_meta.json", w2c=[poses[0].tolist()] * len(poses))


def edit_four_coefficients(folder: Path) -> Edit:
    rig = make_rig(("left", "right"))
    write_videos(folder, ("left", "right"))
    step = rig[1].world_to_camera @ np.linalg.inv(rig[0].world_to_camera)
    entries = {f"M{number}": opencv_K(camera) for number, camera in enumerate(rig, 1)} | {
        "R": step[:3, :3].copy()
    }
    entries |= {"T": step[:3, 3:].copy(), "D1": np.full((1, 4), 0.01), "D2": np.full((1, 4), 0.01)}
    write_storage(folder / "stereo.yml", entries)
    yield
    replaced(folder / "stereo.yml", "---\n", "---\nfisheye_model: 1\n")


def edit_units(folder: Path) -> Edit:
    write_dynerf(folder)
    (folder / "units.toml").write_text(
        'units_per_metre = 1.0\n[baseline]\ncameras = ["cam00", "cam01"]\nmetres = 1.0\n'
    )
    yield
    (folder / "units.toml").write_text("units_per_metre = 1.0\n")


def edit_marked_point(folder: Path) -> Edit:
    write_dynerf(folder)
    marks = (
        "[points]\nmetres = 1.0\na = { cam00 = [30.0, 20.0] }\nb = { cam00 = [20.0, 20.0], "
        "cam01 = [20.0, 20.0] }\n"
    )
    (folder / "units.toml").write_text(marks)
    yield
    replaced(folder / "units.toml", "[30.0, 20.0] }", "[30.0, 20.0], cam01 = [30.0, 20.0] }")


def edit_corrections(folder: Path) -> Edit:
    write_dynerf(folder)
    entry = '[[camera]]\nname = "cam00"\noffset_frames = 1\n'
    (folder / "corrections.toml").write_text(2 * entry)
    yield
    (folder / "corrections.toml").write_text(entry)


def edit_backgrounds(folder: Path) -> Edit:
    write_rows(folder)
    for name in NAMES[1:]:
        write_image(folder / "background" / f"{name}.png", make_image(0, 0))
    yield
    (folder / "background").rename(folder.with_name("background"))


def edit_unread_form(folder: Path) -> Edit:
    write_videos(folder)
    (folder / "mine.json").write_text(json.dumps({"K": make_rig()[0].K.tolist()}))
    yield
    write_opencv(folder, make_rig())


def edit_unread_form_elsewhere(folder: Path) -> Edit:
    write_videos(folder)
    (folder / "mine.json").write_text(json.dumps({"K": make_rig()[0].K.tolist()}))
    yield
    (folder / "mine.json").rename(folder.with_name("mine.json"))
    with pytest.raises(CaptureError, match="makes a capture of them"):
        open_capture(folder)
    write_opencv(folder, make_rig())


def changed(
    write: Callable[[Path], object], spoil: Callable[[Path], object], mend: Callable[[Path], object]
) -> Callable[[Path], Edit]:
    """A capture with one thing wrong, and what puts it right."""

    def edit(folder: Path) -> Edit:
        write(folder)
        spoil(folder)
        yield
        mend(folder)

    return edit


def keys(**values: object) -> Callable[[Path], None]:
    """Write entries of transforms.json; those of None are taken out."""
    return lambda folder: changed_json(folder / "transforms.json", **values)


def K_of(shift_px: float) -> Callable[[Path], None]:
    """Write K.txt with another principal point."""
    return lambda folder: np.savetxt(
        folder / "K.txt", make_rig()[0].K + np.array([[0, 0, shift_px], [0, 0, 0], [0, 0, 0]])
    )


def leave_out(folder: Path) -> None:
    """One frame of a sequence with its depth and its pose."""
    for name in ("images", "depth"):
        (folder / name / "3.png").unlink()
    np.savetxt(folder / "poses.txt", np.loadtxt(folder / "poses.txt")[:3])


def several_instants(folder: Path) -> None:
    """Two pictures of each camera in the model."""
    write_colmap_model(
        folder / "sparse" / "0",
        [f"{name}/{number}.png" for name in NAMES[:2] for number in range(2)],
    )


def no_depth(folder: Path) -> None:
    """Nothing measured in one frame."""
    cv2.imwrite(str(folder / "depth" / "3.png"), np.zeros((48, 64), np.uint16))


def copy_of(folder: Path) -> Path:
    """A second picture of a number."""
    return Path(shutil.copy(folder / "images" / "0.png", folder / "images" / "a0.png"))


# What a refusal says to do -> an edit that does it.
EDITS: list[tuple[str, Callable[[Path], Edit]]] = [
    ("add frames and poses", edit_empty_folder),
    ("give its folder", edit_another_file),
    ("name one of the captures in it: scenes/room", edit_a_level_too_high),
    ("rename this camera", edit_name_of_a_camera),
    ("correct the calibration", edit_equal_names),
    ("add the other", edit_near_alone),
    ("drop the key", edit_masks),
    ("add leading zeros, in the order of rows", edit_leading_zeros),
    (
        "give each a number of its own, or put those of other cameras into other folders",
        edit_two_of_a_number,
    ),
    ("restore the frames or renumber them", edit_gap),
    ("takes the span that all have and pairs frames by time", edit_lengths),
    ("these are parts of one recording each", edit_parts),
    ("rename the others or move them elsewhere", edit_two_files_of_a_camera),
    ("move the copies into a folder elsewhere", edit_proxies),
    ("call these like the cameras", edit_names_of_videos),
    ("put them in CAM.mp4", edit_no_frames),
    ("name one of these files", edit_several_scenes),
    ("correct the size, or K", edit_size_of_K),
    ("undistort the frames with it first, or write the lens in OpenCV's entries", edit_lens),
    ("undistort the images first", edit_camera_model),
    ("keep the one that is right", edit_two_lenses),
    ("keep the right one", changed(write_nerfstudio, keys(K=np.eye(3).tolist()), keys(K=None))),
    ("undistort the images", changed(write_nerfstudio, keys(k4=0.1), keys(k4=0.0))),
    ("scale the intrinsics as the images were scaled", changed(write_sequence, K_of(36), K_of(0))),
    ("leave this frame out", changed(write_sequence, no_depth, leave_out)),
    (
        "rename it or move it elsewhere",
        changed(write_sequence, copy_of, lambda folder: (folder / "images" / "a0.png").unlink()),
    ),
    ("calibrate with one instant", changed(write_colmap, several_instants, write_colmap)),
    ("give videos of several cameras", edit_instants),
    ("if it stands still, write the first instant's for all", edit_moving_camera),
    ("add 'fisheye_model: 1' where they are of cv::fisheye", edit_four_coefficients),
    ("keep one", edit_units),
    ("keep one", edit_corrections),
    ("mark it in another", edit_marked_point),
    ("restore them, or move the folder elsewhere", edit_backgrounds),
    ("write them as transforms.json, OpenCV's YAML or capture.toml", edit_unread_form),
    ("or move what is not of these cameras elsewhere", edit_unread_form_elsewhere),
]


@pytest.mark.parametrize(("advice", "edit"), EDITS, ids=[edit.__name__ for _, edit in EDITS])
def test_an_edit_that_is_advised_is_enough(tmp_path, advice, edit):
    """The refusal ends with it, and what is then named opens."""
    steps = edit(folder := tmp_path / "room")
    assert advice in refusal(next(steps) or folder)
    opened = next(steps, None) or folder
    assert len(open_capture(opened).cameras) > 1


# What says no more than that the input is damaged, or what of it: the same input without the damage
# opens.
UNDO = re.compile(
    r"restore|export it|(copy|export|convert|calibrate|track|write|open)\b.* again|write it "
    r"by|correct|check the path|"
    r"see \S+|there are"
)
# Not followed: data that is not at hand, or of no refusal of a capture on disk.
NOT_FOLLOWED = (
    "give a part of them",  # of 10,000 cameras
    "give hold_frames",  # of an option
    "add it",  # the size of images that nothing names, of which no frames are there
    "colmap image_undistorter",
    "undistort the frames first",
    "undistort its frames and list them in capture.toml",
    "as TUM RGB-D has it; rename it",
    "write the extrinsics in metres",
    "write the intrinsics of this sequence",
    "write both from the same frames",
    "the cameras are",
    "number all from one frame on",  # tests/datasets/test_instants.py
    "if they begin together",
    "frames of {} are there",  # and the command for them
    "ggvs-eval get",
)


def advice_of(file: Path) -> Iterator[str]:
    """What refusals of a module say to do, with the expressions in it in braces."""
    for node in ast.walk(ast.parse(file.read_text())):
        is_remedy = isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in (
            "remedy",
            "advice",
        )
        said = (
            node.value
            if is_remedy
            else node.exc.args[0]
            if isinstance(node, ast.Raise) and is_call(node.exc)
            else None
        )
        if isinstance(said, ast.JoinedStr | ast.Constant):
            text = "".join(
                part.value if isinstance(part, ast.Constant) else "{}"
                for part in getattr(said, "values", [said])
            )
            yield from text.rsplit("; ", 1)[0 if is_remedy else 1 :]


def is_call(node: ast.expr | None) -> bool:
    """An error with a text of its own."""
    return (
        isinstance(node, ast.Call) and bool(node.args) and ast.unparse(node.func).endswith("Error")
    )


def test_every_advice_is_followed_or_undoes_damage():
    """A refusal with other advice needs a case."""
    folder = Path(ggvs_eval.datasets.__file__).parent
    said = {text.strip() for file in folder.glob("*.py") for text in advice_of(file)}
    cases = [re.sub(r"\{.*?\}", "{}", mark) for mark in COMMANDS]
    cases += [advice for advice, _ in EDITS]
    assert len(said) > 60
    is_known = {
        text: any(
            case in text or (len(text) > 5 and text in case) for case in (*cases, *NOT_FOLLOWED)
        )
        for text in said
    }
    assert [
        text for text in said if text.strip("{}") and not is_known[text] and not UNDO.search(text)
    ] == []
