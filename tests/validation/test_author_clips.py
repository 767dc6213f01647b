"""The benchmark of the authors' clips, on small clips of its own: halves, means, resuming, and what
is refused.
"""

import numpy as np
import pytest

from benchmarks.author_clips import LABEL_ROWS, OURS, find_clips, main, measure
from ggvs_eval.files.video import write_video
from ggvs_eval.run_folder import read_json

NAME = "dynerf_flame_steak_{}_vs_ours.mp4"


def write_clip(path, flicker, frames=4):
    """Grey halves below a row of labels: the left one flickers by some levels, the right one stands
    still.
    """
    images = []
    for index in range(frames):
        image = np.full((LABEL_ROWS + 64, 128, 3), 100, np.uint8)
        image[:LABEL_ROWS, ::2] = 40 * index
        image[LABEL_ROWS:, :64] += np.uint8(flicker * (index % 2))
        images.append(image)
    write_video(path, images, 30, crf=0)


@pytest.fixture
def folder(tmp_path):
    """Two baselines of one sequence, and a file of another kind."""
    clips = tmp_path / "clips"
    clips.mkdir()
    for baseline, flicker in (("enerf", 10), ("gpsg", 20)):
        write_clip(clips / NAME.format(baseline), flicker)
    (clips / "notes.txt").write_text("nothing")
    return clips


def test_each_half_has_its_own_values(folder, tmp_path, capsys):
    """The flicker is the baseline's, the labels count for nobody, and what is measured is not
    measured again.
    """
    out = tmp_path / "out.json"
    main([str(folder), "--out", str(out)])
    clips = read_json(out)["clips"]

    assert {
        name: (clip["dataset"], clip["sequence"], clip["n_frames"]) for name, clip in clips.items()
    } == dict.fromkeys((NAME.format("enerf"), NAME.format("gpsg")), ("dynerf", "flame_steak", 4))
    for baseline, flicker in (("enerf", 10), ("gpsg", 20)):
        values = clips[NAME.format(baseline)]["values"]
        assert values[baseline]["mTV"] == pytest.approx(100 * flicker / 255, abs=0.5)
        assert values[baseline]["mTV2"] == pytest.approx(200 * flicker / 255, abs=1)
        assert values[OURS] == pytest.approx({"mTV": 0, "mTV2": 0, "Sharpness": 0}, abs=0.05)
    assert capsys.readouterr().out.count("of 2:") == 2
    main([str(folder), "--out", str(out)])
    assert capsys.readouterr().out == ""
    write_clip(folder / NAME.format("gpsg"), 30)
    measure(folder, out)
    assert capsys.readouterr().out == f"2 of 2: {NAME.format('gpsg')}\n"


def test_wrong_input_is_one_line(folder, tmp_path):
    """No folder, no clips, a clip that ends too early, one of another shape, one of two frames."""

    def refusal(path):
        with pytest.raises(SystemExit) as caught:
            main([str(path), "--out", str(tmp_path / "none.json")])
        assert "\n" not in str(caught.value.code)
        return str(caught.value.code)

    assert "wanted the folder of the authors' clips, there is none" in refusal(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    assert "wanted clips like dynerf_flame_steak_enerf_vs_ours.mp4, got 0 other files" in refusal(
        tmp_path / "empty"
    )
    clip = find_clips(folder)[0].path
    write_clip(clip, 5, frames=2)
    assert (
        "wanted 3 frames or more of two equal halves and more than 80 rows, got 2 of 128 x 104"
        in refusal(folder)
    )
    write_clip(clip, 5)
    clip.write_bytes(clip.read_bytes()[: clip.stat().st_size // 2])
    assert f"author_clips: {clip}: " in refusal(folder)
