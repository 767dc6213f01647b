"""Videos: frame t is frame t, colours keep, damage is named."""

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.digest import digest_files
from ggvs_eval.files.video import VideoFrames, write_video
from helpers.refusals import refused

N_FRAMES = 40
# x264 settings that make frame numbers hard to keep: reordering, references across key frames, no
# key frames at all.
GROUPS = {
    "closed groups with B-frames": "bframes=5:b-adapt=0:keyint=12:min-keyint=12",
    "open groups with B-frames": "bframes=3:b-adapt=0:b-pyramid=normal:open-gop=1:keyint=12:min-keyint=12",  # noqa: E501
    "key frames only": "keyint=1",
    "intra refresh": "intra-refresh=1:bframes=0:keyint=12",
}


def make_frame(index: int, width: int = 64, height: int = 48) -> Image8:
    """Moving stripes; red tells the frame."""
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    stripes = 128 + 60 * np.sin((columns + 3 * index) / 12) * np.cos((rows - 2 * index) / 9)
    return np.stack([np.full_like(stripes, 5 * index), stripes, stripes], axis=-1).astype(np.uint8)


def frame_numbers(frames: Iterator[Image8]) -> list[int]:
    return [round(float(image[..., 0].mean()) / 5) for image in frames]


def encode(path: Path, x264_params: str, colour: str = "bt709", value_range: str = "tv") -> None:
    """Encode the frames as another program may have done."""
    import av
    from av.video.reformatter import ColorRange, Colorspace

    space = {"bt709": Colorspace.ITU709, "smpte170m": Colorspace.ITU601}[colour]
    limits = {"tv": ColorRange.MPEG, "pc": ColorRange.JPEG}[value_range]
    with av.open(str(path), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(30))
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.colorspace, stream.codec_context.color_range = space, limits
        stream.options = {"crf": "4", "x264-params": x264_params}
        for index in range(N_FRAMES):
            rgb = av.VideoFrame.from_ndarray(make_frame(index), format="rgb24")
            container.mux(
                stream.encode(
                    rgb.reformat(format="yuv420p", dst_colorspace=space, dst_color_range=limits)
                )
            )
        container.mux(stream.encode())


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("video") / "cam00.mp4"
    write_video(path, (make_frame(index) for index in range(N_FRAMES)), 30.0)
    return path


def test_written_video_reads_back(video):
    """A written video has its size, rate and number of frames, and colours within the loss of 4:2:0
    coding, without bias.
    """
    frames = VideoFrames(video)
    assert (frames.n_frames, frames.size, frames.fps) == (N_FRAMES, (64, 48), 30.0)
    errors = [
        image.astype(int) - make_frame(index)
        for index, image in enumerate(frames.frames(0, N_FRAMES))
    ]
    assert len(errors) == N_FRAMES
    assert np.std(errors) < 2.5
    assert np.abs(np.mean(errors, axis=(0, 1, 2))).max() < 0.5


@pytest.mark.parametrize("rate", [Fraction(30000, 1001), Fraction(25), Fraction(60000, 1001)])
def test_rates_of_television_are_exact(tmp_path, rate):
    """29.97 frames per second are 30000 / 1001, in the file and as it is read."""
    import av

    write_video(tmp_path / "a.mp4", [make_frame(0), make_frame(1)], float(rate))
    with av.open(str(tmp_path / "a.mp4")) as container:
        assert container.streams.video[0].average_rate == rate
    assert VideoFrames(tmp_path / "a.mp4").fps == pytest.approx(float(rate), rel=1e-9)


def test_equal_frames_give_equal_bytes(video, tmp_path):
    """Encoding the same frames twice gives the same file, and leaves no other file behind."""
    write_video(tmp_path / "cam00.mp4", (make_frame(index) for index in range(N_FRAMES)), 30.0)
    assert (tmp_path / "cam00.mp4").read_bytes() == video.read_bytes()
    assert VideoFrames(tmp_path / "cam00.mp4").digest == VideoFrames(video).digest
    assert [file.name for file in tmp_path.iterdir()] == ["cam00.mp4"]


@pytest.mark.parametrize("x264_params", GROUPS.values(), ids=list(GROUPS))
def test_frame_numbers_survive_seeking(tmp_path, x264_params):
    """Whatever the order of coding, frame t after a seek is bit for bit frame t of the
    whole video.
    """
    path = tmp_path / "video.mp4"
    encode(path, x264_params)
    frames = VideoFrames(path)
    whole = list(frames.frames(0, N_FRAMES))
    assert frame_numbers(iter(whole)) == list(range(N_FRAMES))
    for start in range(0, N_FRAMES, 3):
        window = list(frames.frames(start, min(start + 2, N_FRAMES)))
        assert all(
            np.array_equal(image, whole[start + offset]) for offset, image in enumerate(window)
        )
        assert len(window) == min(2, N_FRAMES - start)


@pytest.mark.parametrize("colour", ["bt709", "smpte170m"])
@pytest.mark.parametrize("value_range", ["tv", "pc"])
def test_colour_follows_the_tags(tmp_path, colour, value_range):
    """Both colour matrices and both value ranges decode to the colours that were encoded."""
    path = tmp_path / "video.mp4"
    encode(path, "keyint=12", colour, value_range)
    errors = [
        image.astype(float) - make_frame(index)
        for index, image in enumerate(VideoFrames(path).frames(0, N_FRAMES))
    ]
    assert np.abs(np.mean(errors, axis=(0, 1, 2))).max() < 2.0


def test_empty_range_and_frames_out_of_range(video):
    """No frames are an empty sequence; frames past the end are an error that tells how many there
    are.
    """
    assert list(VideoFrames(video).frames(N_FRAMES, N_FRAMES)) == []
    with refused(CaptureError, "38..40", "has 40"):
        next(VideoFrames(video).frames(38, 41))


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([], "at least one frame"),
        ([np.zeros((45, 64, 3), np.uint8)], "even width and height, got 64 x 45"),
        (
            [make_frame(0), make_frame(1, width=62)],
            r"frame 1 does not fit.*\(48, 64, 3\).*\(48, 62, 3\)",
        ),
        ([np.zeros((48, 64, 3), np.float32)], "frame 0 does not fit.*float32"),
    ],
)
def test_frames_that_cannot_be_encoded(tmp_path, frames, message):
    """What the format cannot hold is refused in one line, and no file is left."""
    with pytest.raises(CaptureError, match=message):
        write_video(tmp_path / "video.mp4", frames, 30.0)
    assert not list(tmp_path.iterdir())


def test_truncated_video(video, tmp_path):
    """A file cut before its index is refused, naming the file, the frames left and the mend."""
    path = tmp_path / "cam05.mp4"
    path.write_bytes(video.read_bytes()[:-200])
    with refused(CaptureError, "cam05.mp4", "0 frames", "encode this video again"):
        _ = VideoFrames(path).n_frames


def test_truncated_video_with_leading_index(video, tmp_path):
    """A file whose index lies in front but whose data end early tells how many of how many frames
    are whole.
    """
    import av

    path = tmp_path / "cam05.mp4"
    with (
        av.open(str(video)) as source,
        av.open(str(path), "w", options={"movflags": "faststart"}) as target,
    ):
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                target.mux(packet)
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * 0.7)])
    with pytest.raises(
        CaptureError, match=r"cam05\.mp4: damaged, \d+ of 40 frames.*the file ends after"
    ):
        _ = VideoFrames(path).n_frames


def test_damaged_frame_stops_the_stream(video, tmp_path):
    """Frames before a damaged one are decoded, then an error says which one it was; concealed
    frames are never handed out.
    """
    import av

    with av.open(str(video)) as container:
        packet = next(
            packet
            for packet in container.demux(video=0)
            if (packet.pts or 0) * packet.time_base * 30 == 14
        )
    content = bytearray(video.read_bytes())
    begin = packet.pos or 0
    content[begin : begin + packet.size] = bytes(packet.size)
    path = tmp_path / "cam05.mp4"
    path.write_bytes(content)
    decoded: list[Image8] = []
    with pytest.raises(
        CaptureError, match=r"cam05\.mp4: damaged, (\d|1[0-4]) of 40 frames can be decoded"
    ) as caught:
        decoded.extend(VideoFrames(path).frames(0, N_FRAMES))
    whole = list(VideoFrames(video).frames(0, N_FRAMES))
    assert "damaged, 0 of" not in str(caught.value)
    assert all(np.array_equal(image, whole[index]) for index, image in enumerate(decoded))


def test_other_containers_are_refused(tmp_path):
    """A container without an index of frames is refused with the command that copies it
    into MP4.
    """
    import av

    path = tmp_path / "cam00.mp4"
    with av.open(str(path), "w", format="matroska") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(make_frame(0), format="rgb24")))
        container.mux(stream.encode())
    with refused(CaptureError, "MP4 or MOV", "matroska", "ffmpeg -i IN -c copy OUT.mp4"):
        _ = VideoFrames(path).n_frames


def test_missing_video(tmp_path):
    """An absent file is called absent."""
    with refused(CaptureError, "cam07.mp4", "no such file"):
        _ = VideoFrames(tmp_path / "cam07.mp4").n_frames


def test_digest_sees_every_frame_of_a_large_file(tmp_path):
    """A stack of 24 frames, 12 MB, of which the first, a middle or the last one is replaced, has
    another digest each time.
    """
    frames = np.random.default_rng(0).integers(0, 256, (24, 360, 480, 3), dtype=np.uint8)
    stack, digests = tmp_path / "stack.npy", set()
    for replaced in (None, 0, 9, 23):
        changed = frames.copy()
        if replaced is not None:
            changed[replaced] = 255 - changed[replaced]
        np.save(stack, changed)
        digests.add(digest_files([stack]))
    assert len(digests) == 4


def trim(source: Path, target: Path, first: int, from_start: bool) -> None:
    """Cut a video without encoding it again, as `ffmpeg -ss -c copy` and phones do: the lead-in
    stays, hidden by an edit list.

    It begins at the last key frame, or at the start where key frames lead nowhere by themselves
    (intra refresh).
    """
    import av

    with (
        av.open(str(source)) as given,
        av.open(str(target), "w", options={"avoid_negative_ts": "disabled"}) as made,
    ):
        stream = given.streams.video[0]
        copy = made.add_stream_from_template(stream)
        packets = [packet for packet in given.demux(stream) if packet.dts is not None]
        start = sorted(packet.pts for packet in packets)[first]
        keys = [
            index
            for index, packet in enumerate(packets)
            if packet.is_keyframe and packet.pts <= start
        ]
        for packet in packets[0 if from_start else keys[-1] :]:
            packet.pts, packet.dts, packet.stream = packet.pts - start, packet.dts - start, copy
            made.mux(packet)


# With intra refresh FFmpeg drops the lead-in of a cut at a point of recovery, from which nothing
# can be decoded exactly.
CUTS = [
    (group, first)
    for group in GROUPS
    for first in (1, 12, 13, 30)
    if group != "intra refresh" or first not in (12, 13)
]


@pytest.mark.parametrize(("group", "first"), CUTS)
def test_a_trimmed_video_has_the_frames_that_it_shows(group, first, tmp_path):
    """Cut at a key frame, next to one and between: frame t is the t-th that is shown, from wherever
    reading begins.
    """
    encode(tmp_path / "whole.mp4", GROUPS[group])
    trim(tmp_path / "whole.mp4", tmp_path / "cut.mp4", first, from_start=group == "intra refresh")
    video = VideoFrames(tmp_path / "cut.mp4")
    shown = list(range(first, N_FRAMES))
    assert video.n_frames == len(shown)
    assert frame_numbers(video.frames(0, video.n_frames)) == shown
    for start in (0, 1, 5, video.n_frames - 1):
        assert frame_numbers(video.frames(start, start + 1)) == [shown[start]]


def test_interlaced_video_is_told(tmp_path):
    """By the order of fields in its stream, and a plain one is not."""
    import av

    write_video(tmp_path / "plain.mp4", [np.full((48, 64, 3), 90, np.uint8)] * 2, 25)
    with av.open(str(tmp_path / "woven.mp4"), "w") as container:
        stream = container.add_stream(
            "libx264",
            rate=25,
            options={"flags": "+ildct+ilme", "field_order": "tt", "x264-params": "tff=1"},
        )
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for level in (40, 90, 140):
            woven = np.full((48, 64, 3), level, np.uint8)
            woven[1::2] += 25
            container.mux(stream.encode(av.VideoFrame.from_ndarray(woven, format="rgb24")))
        container.mux(stream.encode())

    assert VideoFrames(tmp_path / "woven.mp4").interlaced
    assert not VideoFrames(tmp_path / "plain.mp4").interlaced


@pytest.mark.parametrize(
    ("matrix", "shown"),
    [
        ((-1, 0, 0, 1), lambda image: image[:, ::-1]),
        ((1, 0, 0, -1), lambda image: image[::-1]),
        ((0, 1, -1, 0), lambda image: np.rot90(image, -1)),
        ((0, 1, 1, 0), lambda image: image.transpose(1, 0, 2)),
    ],
    ids=["mirrored", "upside down and mirrored", "turned", "transposed"],
)
def test_a_display_matrix_is_applied_as_ffmpeg_does(tmp_path, matrix, shown):
    """Turns and mirrorings that the header of a track states; the pixels are those of the file
    without.
    """
    image = np.zeros((48, 64, 3), np.uint8)
    image[:24, :32], image[24:] = (200, 40, 40), (40, 40, 200)
    write_video(tmp_path / "plain.mp4", [image], 30)
    content = bytearray((tmp_path / "plain.mp4").read_bytes())
    start = content.index(b"tkhd") + 44
    entries = np.array([*matrix[:2], 0, *matrix[2:]], ">i4") << 16
    content[start : start + 20] = entries.astype(">i4").tobytes()
    (tmp_path / "turned.mp4").write_bytes(content)
    plain, turned = (
        next(VideoFrames(tmp_path / f"{name}.mp4").frames(0, 1)) for name in ("plain", "turned")
    )
    assert np.array_equal(turned, shown(plain))
    assert VideoFrames(tmp_path / "turned.mp4").size == turned.shape[1::-1]
