"""Draw the pictures of the real video, docs/images/real_video_*.jpg: ``python
tools/docs/draw_real_video.py [RUN]``.

Strips of all test views, failures among them, and a row over time. The command of the run stands in
docs/results.md.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from ggvs_eval.reports.figures.paper_figures import write_figure
from ggvs_eval.run_folder import RunFolder, frame_path

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
STRIPS = {
    "truth": "Captured",
    "distance-based": "Distance-based Blending",
    "no-blending": "No Blending",
    "ours-geometric": "GGVS (online), geometric weights",
    "ours": "GGVS (online)",
}
WIDTH, HEIGHT, GAP, TITLE = 320, 180, 4, 20
LONGEST, QUALITY = 1600, 72  # of a figure's side, pixels; of JPEG
INK = (40, 40, 40)
TIME_VIEW = "0"  # the ball passes through it


def main(run: Path) -> None:
    """Draw what the runs have, and print the size of each picture."""
    _write(_strips(RunFolder(run)), "strips")
    with TemporaryDirectory() as scratch:
        (file,) = write_figure(run, "time", Path(scratch) / "time.png", view=TIME_VIEW)
        picture = Image.open(file).convert("RGB")
    picture.thumbnail((LONGEST, LONGEST))
    _write(picture, "time")


def _strips(run: RunFolder) -> Image.Image:
    """The middle frame: a row per test view, a column per method."""
    protocol = run.protocol()
    frame = protocol.frames.start + protocol.frames.count // 2
    views, font = protocol.views.test, ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 13)
    size = len(STRIPS) * (WIDTH + GAP) - GAP, TITLE + len(views) * (HEIGHT + GAP)
    canvas = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(canvas)
    for column, (label, title) in enumerate(STRIPS.items()):
        left = column * (WIDTH + GAP)
        draw.text((left + 2, 2), title, INK, font)
        for row, view in enumerate(views):
            folder = run.truth(view) if label == "truth" else run.renders(label, view)
            picture = Image.open(frame_path(folder, frame)).resize(
                (WIDTH, HEIGHT), Image.Resampling.LANCZOS
            )
            canvas.paste(picture, (left, TITLE + row * (HEIGHT + GAP)))
    return canvas


def _write(picture: Image.Image, name: str) -> None:
    path = IMAGES / f"real_video_{name}.jpg"
    picture.save(path, quality=QUALITY, optimize=True)
    print(path, path.stat().st_size, "bytes")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "out" / "real_video" / "dome")
