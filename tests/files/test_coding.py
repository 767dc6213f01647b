"""How a video was coded: read back from what x264 wrote into it, and enough to code the same frames
to the same bytes.
"""

from fractions import Fraction

import av
import numpy as np
import pytest

from ggvs_eval.errors import CaptureError
from ggvs_eval.files.coding import read_coding
from ggvs_eval.files.video import X264, VideoFrames, write_video

STILL = np.kron(np.random.default_rng(0).integers(40, 200, (6, 8, 3)), np.ones((8, 8, 1)))
FRAMES = [
    (STILL + np.random.default_rng(t).integers(0, 9, STILL.shape)).astype(np.uint8)
    for t in range(6)
]


def write_with(path, codec, **options):
    """The frames by any encoder."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=Fraction(30), options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for frame in FRAMES:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


@pytest.mark.parametrize("crf", [0, 12, 23])
def test_frames_coded_with_what_was_read_are_the_same_bytes(tmp_path, crf):
    """Rate factor, settings, size and bytes of frames come back; of a part of the video, those of
    that part.
    """
    settings = f"{X264}:keyint=4:bframes=1:subme=5:aq-strength=0.8"
    write_video(tmp_path / "first.mp4", FRAMES, 30, crf, settings)
    coding = read_coding(tmp_path / "first.mp4", range(6))
    write_video(tmp_path / "again.mp4", FRAMES, 30, coding.crf, f"{coding.settings}:{X264}")

    assert (coding.crf, coding.size, coding.unknown) == (crf, (64, 48), "")
    assert (tmp_path / "again.mp4").read_bytes() == (tmp_path / "first.mp4").read_bytes()
    assert 0 < len(coding.frame_bytes) < len(FRAMES)  # without key frames
    assert sum(coding.frame_bytes) < (tmp_path / "first.mp4").stat().st_size
    assert read_coding(tmp_path / "first.mp4", range(1, 3)).frame_bytes == coding.frame_bytes[:2]


def test_the_step_of_the_quantiser_doubles_every_six():
    """As in H.264: 1 at 4; a rate factor of 0 is lossless."""
    from ggvs_eval.files.coding import Coding

    assert [Coding(crf=crf).step_255 for crf in (0, 4, 10, 16)] == [0, 1, 2, 4]


def test_what_cannot_be_coded_again_has_a_reason(tmp_path):
    """Another encoder, a bit rate instead of a rate factor; a file that is no video is an error."""
    write_with(tmp_path / "mpeg4.mp4", "mpeg4")
    write_with(tmp_path / "rate.mp4", "libx264", b="400000")
    (tmp_path / "text.mp4").write_text("no video")

    assert (
        read_coding(tmp_path / "mpeg4.mp4", range(6)).unknown
        == "coded by another encoder than x264"
    )
    assert read_coding(tmp_path / "rate.mp4", range(6)).unknown == "coded without a rate factor"
    with pytest.raises(CaptureError, match="wanted a video"):
        read_coding(tmp_path / "text.mp4", range(6))
    assert VideoFrames(tmp_path / "rate.mp4").n_frames == len(FRAMES)
