"""Draw the README's picture from a finished demo run: ``python docs/draw_picture.py`` after `make reports`."""

from pathlib import Path

import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from ggvs_eval.files.images import read_image
from ggvs_eval.reports.figures.slices import epipolar_plane_image, most_textured_row
from ggvs_eval.run_folder import RunFolder, frame_path

ROOT = Path(__file__).parents[1]
VIEW, FRAME, POSES = "cam07", 12, 48
WIDTH, HEIGHT, EPI_HEIGHT, GAP, TITLE_HEIGHT = 360, 270, 110, 8, 26
SHOWN = {
    "no-blending": "No Blending",
    "distance-based": "Distance-based Blending",
    "ours": "Ours",
    "truth": "Truth",
}


def main() -> None:
    """One column per method: a frame, and the epipolar plane image of the camera path."""
    run = RunFolder(ROOT / "out" / "demo")
    row = most_textured_row([read_image(frame_path(run.path("truth"), POSES // 2))])
    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 15)
    size = len(SHOWN) * (WIDTH + GAP) - GAP, TITLE_HEIGHT + HEIGHT + GAP + EPI_HEIGHT
    canvas = Image.new("RGB", size, "white")
    for column, (label, title) in enumerate(SHOWN.items()):
        left = column * (WIDTH + GAP)
        folder = run.truth(VIEW) if label == "truth" else run.renders(label, VIEW)
        ImageDraw.Draw(canvas).text((left + 2, 4), title, fill="black", font=font)
        frame = Image.fromarray(read_image(frame_path(folder, FRAME)))
        canvas.paste(frame.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS), (left, TITLE_HEIGHT))
        slices = Image.fromarray(np.asarray(epipolar_plane_image(run.path(label), POSES, row), dtype=np.uint8))
        canvas.paste(slices.resize((WIDTH, EPI_HEIGHT), Image.Resampling.NEAREST), (left, TITLE_HEIGHT + HEIGHT + GAP))
    picture = ROOT / "docs" / "images" / "demo.jpg"
    picture.parent.mkdir(exist_ok=True)
    canvas.save(picture, quality=88)
    print(picture)


if __name__ == "__main__":
    main()
