"""Captures that were filmed once and lie in `tests/data/films`: who needs a capture unpacks one, in
milliseconds.

Filming itself is tested in `tests/contrib/worlds`. ``python tests/helpers/packed_films.py [NAME
...]`` films them again, after a change of the rooms or of an option here; a proof in
`tests/contrib/worlds/test_packed_films.py` tells when that is due.
"""

import shutil
import sys
from pathlib import Path

FILMS_FOLDER = Path(__file__).resolve().parents[1] / "data" / "films"
# Name -> options of `DemoOptions`, but for those that all have in common.
COMMON = {"path_poses": 0, "supersampling": 1, "depth_stride": 0}
FILMS: dict[str, dict[str, object]] = {
    # Six cameras in two rows, twelve frames, exact depth: what most tests mean by "a capture".
    "small": {"width": 64, "height": 48, "n_frames": 12, "cameras_per_row": 3, "depth_stride": 1},
    # One instant of eight cameras, sharp and without noise: features enough for COLMAP.
    "calibration": {
        "width": 640,
        "height": 480,
        "n_frames": 1,
        "cameras_per_row": 4,
        "noise_sigma_255": 0,
    },
    # The same rig, four frames, and a camera path with its true pictures.
    "path": {"width": 64, "height": 48, "n_frames": 4, "cameras_per_row": 3, "path_poses": 5},
    # Four cameras without noise, coded without loss: faults of renders are planted in it.
    "plain": {
        "width": 192,
        "height": 144,
        "n_frames": 12,
        "cameras_per_row": 2,
        "noise_sigma_255": 0,
        "crf": 0,
    },
    # Six cameras, two frames, exact depth of a size at which features are matched.
    "deep": {"width": 160, "height": 120, "n_frames": 2, "cameras_per_row": 3, "depth_stride": 1},
}


def unpack_film(name: str, folder: Path, with_depth: bool = True) -> Path:
    """Write a packed capture into a new folder, which is returned; its exact depth too, if it was
    filmed with any.
    """
    left_out = None if with_depth else shutil.ignore_patterns("depth")
    return Path(shutil.copytree(FILMS_FOLDER / name, folder, ignore=left_out))


def film_again(name: str, folder: Path) -> Path:
    """Film a capture as it was filmed for the pack."""
    from ggvs_eval.contrib.worlds.demo import film_demo
    from ggvs_eval.contrib.worlds.film.options import DemoOptions

    return film_demo(folder, DemoOptions(**(COMMON | FILMS[name])), workers=1)  # type: ignore[arg-type]


if __name__ == "__main__":
    for chosen in sys.argv[1:] or FILMS:
        shutil.rmtree(FILMS_FOLDER / chosen, ignore_errors=True)
        print(film_again(chosen, FILMS_FOLDER / chosen))
