"""Draw the pictures of the real video, docs/images/real_video_*.jpg: ``python docs/draw_real_video.py [RUN [PATH_RUN]]``.

Strips of all test views, the worst squares of ours, a row of the image over time, and a row along a path between cameras. The
commands of both runs stand in docs/results.md.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from ggvs_eval.reports.figures.paper_figures import write_figure
from ggvs_eval.run_folder import RunFolder, frame_path

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
STRIPS = {
    "truth": "Captured",
    "distance-based": "Distance-based Blending",
    "enerf": "ENeRF",
    "ours-geometric": "Ours (geometric weights)",
    "ours": "Ours",
}
WIDTH, HEIGHT, GAP, TITLE = 320, 180, 4, 20
LONGEST, QUALITY = 1600, 72  # of a figure's side, pixels; of JPEG
INK = (40, 40, 40)
TIME_VIEW = "0"  # the ball passes through it


def main(run: Path, path_run: Path) -> None:
    """Draw what the runs have, and print the size of each picture."""
    _write(_strips(RunFolder(run)), "strips")
    for folder, kind, options in (
        (run, "failures", {"method": "ours", "boxes": 4}),
        (run, "time", {"view": TIME_VIEW}),
        (path_run, "epi", {}),
    ):
        with TemporaryDirectory() as scratch:
            drawn = Path(scratch) / f"{kind}.png"
            write_figure(folder, kind, drawn, **options)
            picture = Image.open(drawn).convert("RGB")
        picture.thumbnail((LONGEST, LONGEST))
        _write(picture, kind)


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
            picture = Image.open(frame_path(folder, frame)).resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS)
            canvas.paste(picture, (left, TITLE + row * (HEIGHT + GAP)))
    return canvas


def _write(picture: Image.Image, name: str) -> None:
    path = IMAGES / f"real_video_{name}.jpg"
    picture.save(path, quality=QUALITY, optimize=True)
    print(path, path.stat().st_size, "bytes")


if __name__ == "__main__":
    given = [Path(each) for each in sys.argv[1:]]
    main(*given, *(ROOT / "out" / name for name in ("real_video/dome", "real_video_path")[len(given) :]))
