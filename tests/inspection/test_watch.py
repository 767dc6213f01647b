"""A rig that is watched while it films: lights that turn when a camera is pushed or drifts, and a
page that shows them.
"""

import json
import shutil
from pathlib import Path

import pytest

from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from ggvs_eval.pipelines.inspection.capture.watch import Watch, watch
from helpers.small_rig import Frames, bump, expose

pytestmark = pytest.mark.slow
NAMES = ("cam01", "cam02", "cam04", "cam05")


def shoot(folder: Path, frames: dict[str, Frames], start: int, stop: int) -> None:
    """Cameras write their pictures; each folder has one more that is not finished."""
    for name in NAMES:
        for index in range(start, min(stop + 1, len(frames[name]))):
            write_image(folder / name / f"{index:04d}.png", frames[name][index])


def states(lights) -> dict[str, str]:
    return {light.camera: light.verdict for light in lights}


def test_a_push_turns_one_light_within_two_rounds_and_says_when(filmed, tmp_path):
    """cam04 is pushed by 6 px at frame 9: its light turns in the second round that sees it, with
    size and frame; others stay.
    """
    frames = dict(filmed.frames, cam04=bump(6, 0, 9)(filmed.frames["cam04"]))
    shoot(tmp_path, frames, 0, 8)
    watched = Watch(tmp_path)
    assert states(watched.look(0.0)) == dict.fromkeys(NAMES, "ok")
    for round_s, stop in ((5.0, 14), (10.0, 18)):
        shoot(tmp_path, frames, 8, stop)
        lights = {light.camera: light for light in watched.look(round_s)}

    assert states(lights.values()) == {**dict.fromkeys(NAMES, "ok"), "cam04": "bad"}
    assert "moved by 6." in lights["cam04"].reason
    assert "at frame 9" in lights["cam04"].reason
    assert (lights["cam04"].time, lights["cam02"].time, lights["cam04"].n_frames) == (10.0, 0.0, 18)


def test_an_exposure_that_drifts_wants_the_rig_and_lamps_turn_no_light(
    filmed, written_rig, tmp_path
):
    """With the poses of the rig a camera that grows brighter is named, while lamps that fade for
    all leave every light ok.
    """
    brighter = dict(filmed.frames, cam02=expose(1.3)(filmed.frames["cam02"]))
    faded = {name: expose(0.6)(each) for name, each in filmed.frames.items()}
    for folder, frames in (("brighter", brighter), ("faded", faded)):
        shoot(tmp_path / folder, frames, 0, 20)
    lights = {light.camera: light for light in Watch(tmp_path / "brighter", written_rig).look(0.0)}

    assert lights["cam02"].verdict == "bad"
    assert "colour over time: brighter by" in lights["cam02"].reason
    assert states(Watch(tmp_path / "faded", written_rig).look(0.0)) == dict.fromkeys(NAMES, "ok")


def test_lines_page_and_json_of_a_shoot(filmed, tmp_path):
    """Sentences only where something changed, JSON lines in every round, and a page that refreshes
    itself.
    """
    shots = tmp_path / "shots"
    times = iter(range(100))

    def film_on(_: float) -> None:
        shoot(shots, filmed.frames, 6, 12)

    waiting = next(watch(shots, 1.0, rounds=1))
    assert waiting.startswith("waiting: ")
    shoot(shots, filmed.frames, 0, 6)
    page = tmp_path / "rig.html"
    lines = list(
        watch(shots, 1.0, page=page, rounds=3, clock=lambda: float(next(times)), sleep=film_on)
    )
    assert [line.split(":")[0] for line in lines] == list(NAMES)
    text = page.read_text(encoding="utf-8")
    assert 'http-equiv="refresh"' in text
    assert text.count('<tr class="ok">') == len(NAMES)
    parsed = [
        json.loads(line) for line in watch(shots, 1.0, as_json=True, rounds=2, sleep=lambda _: None)
    ]
    assert [each["camera"] for each in parsed] == [*NAMES, *NAMES]
    assert {each["verdict"] for each in parsed} == {"ok"}


def test_a_camera_that_stops_and_one_that_is_strange_are_named(filmed, written_rig, tmp_path):
    """A picture that cannot be read turns its camera's light; a camera that the rig does not have
    is an error.
    """
    shoot(tmp_path / "shots", filmed.frames, 0, 6)
    (tmp_path / "shots" / "cam02" / "0004.png").write_bytes(b"\x89PNG")
    lights = {light.camera: light for light in Watch(tmp_path / "shots").look(0.0)}
    assert lights["cam02"].verdict == "bad"
    assert "0004.png" in lights["cam02"].reason

    shutil.move(tmp_path / "shots" / "cam02", tmp_path / "shots" / "side")
    with pytest.raises(CaptureError, match="wanted cameras of the rig, got side"):
        Watch(tmp_path / "shots", written_rig).look(0.0)
