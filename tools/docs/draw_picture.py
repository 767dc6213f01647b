"""Draw the README's moving picture from a scored run: ``python tools/docs/draw_picture.py [RUN]``
after `make reports`.

Each method beside the captured frames, as on the page: first the scene moves and the x-t slice of
the marked row grows below each picture, then the camera moves along its path and the epipolar plane
image of the row grows.
"""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from ggvs_eval.arrays import Image8
from ggvs_eval.files.images import read_image
from ggvs_eval.reports.figures.slices import most_textured_row, stacked_rows
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder, frame_path

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs" / "images" / "demo.webp"
METHODS = {
    "no-blending": "No Blending",
    "distance-based": "Distance-based Blending",
    "ours": "GGVS (online)",
    "truth": "Captured",
}
VIEW, POSES, POSE_STEP = "cam07", 48, 2
LEFT, TOP, CROP_WIDTH, CROP_HEIGHT = 130, 100, 240, 180  # of 480 x 360: what the methods differ in
WIDTH, HEIGHT, SLICE_HEIGHT, GAP, TITLE, CAPTION = 232, 174, 64, 6, 22, 20
FRAME_MS, REST_MS, QUALITY = 110, 1200, 52
INK, MARK, PAPER = (40, 40, 40), (255, 214, 0), (255, 255, 255)
FONT = font_manager.findfont("DejaVu Sans")


def main(root: Path) -> None:
    """Write the animation and tell its size."""
    run = RunFolder(root)
    frames = [*moving_scene(run), *moving_camera(run)]
    first, *others = (Image.fromarray(frame) for frame in frames)
    lasting = [
        REST_MS if index in (len(frames) - 1, run.protocol().frames.count - 1) else FRAME_MS
        for index in range(len(frames))
    ]
    PICTURE.parent.mkdir(exist_ok=True)
    first.save(
        PICTURE,
        save_all=True,
        append_images=others,
        duration=lasting,
        loop=0,
        quality=QUALITY,
        method=6,
    )
    print(
        f"{PICTURE}: {PICTURE.stat().st_size / 1e6:.2f} MB, {len(frames)} frames of {first.width} "
        f"x {first.height}"
    )


def moving_scene(run: RunFolder) -> Iterator[Image8]:
    """One test view over time, with the x-t slice of a row."""
    span = run.protocol().frames
    indices = range(span.start, span.start + span.count)
    folders = {
        label: run.truth(VIEW) if label == "truth" else run.renders(label, VIEW)
        for label in METHODS
    }
    row = most_textured_row([read_image(frame_path(folders["truth"], indices[len(indices) // 2]))])
    slices = {label: stacked_rows(folder, indices, row) for label, folder in folders.items()}
    told = f"test view {VIEW} over time; below, row {row} of each frame, stacked (x-t slice)"
    for shown, index in enumerate(indices, start=1):
        yield drawn(
            run,
            told,
            row,
            shown / len(indices),
            lambda label, index=index: frame_path(folders[label], index),
            slices,
        )


def moving_camera(run: RunFolder) -> Iterator[Image8]:
    """The camera path at one instant, with the epipolar plane image of a row."""
    row = most_textured_row([read_image(frame_path(run.path("truth"), POSES // 2))])
    slices = {label: stacked_rows(run.path(label), range(POSES), row) for label in METHODS}
    told = f"along a camera path; below, row {row} of each pose, stacked (epipolar plane image)"
    for pose in range(0, POSES, POSE_STEP):
        shown = (pose + POSE_STEP) / POSES
        yield drawn(
            run,
            told,
            row,
            shown,
            lambda label, pose=pose: frame_path(run.path(label), pose),
            slices,
        )


def drawn(
    run: RunFolder,
    told: str,
    row: int,
    shown: float,
    file_of: Callable[[str], Path],
    slices: dict[str, Image8],
) -> Image8:
    """One picture of the animation: a column per method.

    Args:
        run: whose mean PSNR stands in the titles.
        told: the line below.
        row: of the image that is cut out.
        shown: share of the slices that has been seen so far.
        file_of: picture of a method.
        slices: of each method, (T, W, 3).
    """
    psnr_db = Results.read(run.root).summary().droplevel("dataset")["PSNR"]
    canvas = Image.new(
        "RGB",
        (len(METHODS) * (WIDTH + GAP) - GAP, TITLE + HEIGHT + GAP + SLICE_HEIGHT + CAPTION),
        PAPER,
    )
    draw = ImageDraw.Draw(canvas)
    font = ImageFont.truetype(FONT, 12)
    for column, (label, title) in enumerate(METHODS.items()):
        left = column * (WIDTH + GAP)
        value = "" if label == "truth" else f", {psnr_db[label, '']:.1f} dB"
        draw.text((left + 2, 3), title + value, fill=INK, font=font)
        window = (LEFT, TOP, LEFT + CROP_WIDTH, TOP + CROP_HEIGHT)
        frame = Image.fromarray(read_image(file_of(label))).crop(window)
        canvas.paste(frame.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS), (left, TITLE))
        line = TITLE + round((row + 0.5 - TOP) * HEIGHT / CROP_HEIGHT)
        draw.line([(left, line), (left + WIDTH - 1, line)], fill=MARK, width=1)
        cut = Image.fromarray(np.asarray(slices[label][:, LEFT : LEFT + CROP_WIDTH]))
        cut = cut.resize((WIDTH, SLICE_HEIGHT), Image.Resampling.BILINEAR)
        height_px = round(SLICE_HEIGHT * shown)
        canvas.paste(cut.crop((0, 0, WIDTH, height_px)), (left, TITLE + HEIGHT + GAP))
    draw.text((2, canvas.height - CAPTION + 3), told, fill=INK, font=font)
    return np.asarray(canvas, dtype=np.uint8)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "out" / "demo")
