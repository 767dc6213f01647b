"""Captures that their authors publish: fetched by name, kept where they are found again, known by
``DATASET:SCENE``.
"""

import re
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

from ggvs_eval.errors import CaptureError, did_you_mean
from ggvs_eval.files.archive import Limits, unpack
from ggvs_eval.files.atomic import scratch_folder
from ggvs_eval.files.download import DownloadError, cache_folder, download
from ggvs_eval.files.toml_tables import build_table, parse_toml

FILE = "public_captures.toml"
NAME = re.compile(r"[a-z0-9-]+:[\w.-]*")
# of an archive; the disk's room is looked at too
LIMITS = Limits(n_files=500_000, n_bytes=200 << 30)


@dataclass(frozen=True)
class ByHand:
    """Scenes without a single address, with instructions to get one; its place follows them."""

    scenes: tuple[str, ...]
    remedy: str


@dataclass(frozen=True)
class PublicDataset:
    """A data set and where its scenes are.

    Attributes:
        name: the part before the colon.
        title: what people call it, with authors and venue.
        licence: under which it is published.
        url: of an archive, ``{archive}`` being its name.
        archives: names of the archives, each a scene or all of them.
        folders: scenes of the only archive; none if each archive is a scene.
        by_hand: scenes that are not at one address.
        size: of what is fetched, in words.
        protocols: packaged ones of its scenes, ``{scene}`` being the name of one.
    """

    name: str
    title: str
    licence: str
    page: str
    url: str = ""
    archives: tuple[str, ...] = ()
    folders: tuple[str, ...] = ()
    by_hand: tuple[ByHand, ...] = ()
    size: str = "size as the server states it"
    protocols: tuple[str, ...] = ()

    @property
    def scenes(self) -> tuple[str, ...]:
        """Names of all scenes."""
        return (
            *(self.folders or self.archives),
            *(scene for part in self.by_hand for scene in part.scenes),
        )

    def terms(self, scene: str) -> str:
        """Return title, size, licence, page and protocols, in one line."""
        protocols = ", ".join(self.protocols).format(scene=scene)
        choice = f"; --protocol: {protocols}" if protocols else ""
        return f"{self.title}; {self.size}; licence: {self.licence}; {self.page}{choice}"

    def folder(self) -> Path:
        """Return the folder of its captures."""
        return cache_folder() / "captures" / self.name

    def place(self, scene: str) -> Path:
        """Return the folder of a scene, present or not."""
        return (
            self.folder() / self.archives[0] / scene
            if scene in self.folders
            else self.folder() / scene
        )

    def way(self, by_hand: ByHand, scene: str) -> str:
        """Return what to fetch by hand, where to put it, and the page that says more."""
        return f"{by_hand.remedy} to {self.place(scene)} ({self.page})"


@dataclass(frozen=True)
class DatasetTable:
    """The whole file."""

    dataset: tuple[PublicDataset, ...]


@cache
def public_datasets() -> dict[str, PublicDataset]:
    """Return all of them by name."""
    text = resources.files(__package__).joinpath(FILE).read_text(encoding="utf-8")
    table = build_table(DatasetTable, parse_toml(text, FILE, CaptureError), FILE, "", CaptureError)
    return {dataset.name: dataset for dataset in table.dataset}


def find_scene(name: str) -> tuple[PublicDataset, str]:
    """Return the data set and the scene that ``DATASET:SCENE`` names."""
    dataset_name, _, scene = name.partition(":")
    datasets = public_datasets()
    if dataset_name not in datasets:
        raise CaptureError(
            f"{name}: wanted DATASET:SCENE, the data sets are "
            f"{', '.join(datasets)}{did_you_mean(dataset_name, datasets)}"
        )
    dataset = datasets[dataset_name]
    if scene not in dataset.scenes:
        scenes_text = f"{', '.join(dataset.scenes)}{did_you_mean(scene, dataset.scenes)}"
        where = "" if scene or dataset.archives else f"; {dataset.way(dataset.by_hand[0], 'SCENE')}"
        raise CaptureError(f"{name}: wanted one of {scenes_text}; {dataset.terms('SCENE')}{where}")
    return dataset, scene


def locate(path: Path) -> Path:
    """Return the folder of a capture: the path itself, or where ``DATASET:SCENE`` was put by
    `get_capture`.
    """
    name = str(path)
    if path.exists() or not NAME.fullmatch(name) or name.partition(":")[0] not in public_datasets():
        return path
    dataset, scene = find_scene(name)
    place = dataset.place(scene)
    if not place.is_dir():
        raise CaptureError(
            f"{name}: wanted the capture in {place}, got none; run 'ggvs-eval get {name}'"
        )
    return place


def get_capture(name: str) -> Path:
    """Fetch a capture, unpack it and return its folder; nothing is done where it is there already.

    The archive is removed once it is unpacked; its size and SHA-256 stay next to it, and an archive
    that is fetched again must be the same.

    Args:
        name: ``DATASET:SCENE``.

    Raises:
        CaptureError: no such scene, or an archive that is damaged or does not hold it.
        DownloadError: it cannot be fetched, or it is another than at the first time.
    """
    dataset, scene = find_scene(name)
    place = dataset.place(scene)
    if place.is_dir():
        return place
    for part in dataset.by_hand:
        if scene in part.scenes:
            raise DownloadError(f"{name}: {dataset.way(part, scene)}")
    archive = dataset.archives[0] if dataset.folders else scene
    file = dataset.folder() / f"{archive}.zip"
    download(dataset.url.format(archive=archive), file, file.with_suffix(".json"))
    with scratch_folder(dataset.folder() / f"{archive}.unpacked") as scratch:
        unpack(file, scratch, LIMITS, CaptureError).replace(dataset.folder() / archive)
    file.unlink()
    if not place.is_dir():
        raise CaptureError(
            f"{name}: wanted {scene} in the archive, it holds no such folder; see {dataset.page}"
        )
    return place
