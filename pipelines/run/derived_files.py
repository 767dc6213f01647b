"""Folders that a run derives from others: frames, masks, path depth, the report; made anew when what they come from changes."""

import hashlib
import os
import shutil
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ggvs_eval.camera import Camera
from ggvs_eval.errors import ResultsError
from ggvs_eval.files.digest import digest_files
from ggvs_eval.run_folder import read_json, write_json

NOTE = "made_from.json"
DIGESTS = ".digests.json"  # hidden: it holds times of this machine, and runs are merged without it
RECORDS = (".json", ".toml", ".parquet", ".csv")


def seen_from(target: Camera, keys: Mapping[str, str]) -> dict[str, Any]:
    """A target and its sources' depth, as a note says them.

    Args:
        target: camera at synthesis size.
        keys: source camera -> key of its depth in the depth store.
    """
    return {
        "target": target.to_json(),
        "depth": dict(keys),
    }


def is_stale(folder: Path, made_from: Mapping[str, Any]) -> bool:
    """Tell whether files of a folder, if there are any, were made from something else, or from unknown inputs."""
    try:
        return read_json(folder / NOTE) != made_from
    except ResultsError:
        return True


def drop_stale(folder: Path, made_from: Mapping[str, Any]) -> None:
    """Empty a folder whose files are stale, and note what those that follow are made from.

    Args:
        folder: made if absent.
        made_from: all that they depend on, as JSON values.
    """
    if is_stale(folder, made_from):
        shutil.rmtree(folder, ignore_errors=True)
        write_json(folder / NOTE, dict(made_from))


def digest_folder(folder: Path, without: Collection[str] = ()) -> str:
    """SHA-256 of what a folder holds: records by content, since they are written again as they were; others by size and time.

    Args:
        folder: links in it are not followed.
        without: names of folders that do not count, at any depth.
    """
    digest = hashlib.sha256()
    for place, names, files in os.walk(folder):
        names[:] = sorted(name for name in names if name not in without)
        for file in sorted(Path(place, name) for name in files if name != DIGESTS):
            about = file.stat()
            content = file.read_bytes() if file.suffix in RECORDS else f"{about.st_size} {about.st_mtime_ns}".encode()
            digest.update(f"{file.relative_to(folder)}\0".encode() + content)
    return digest.hexdigest()


@dataclass(frozen=True)
class MadeFiles:
    """Files of a folder that are made once, and again where they are lost, changed since, or made from something else.

    A record holds the digest of each file and its status (inode, size, times); while the status is the same, so is the content,
    since whatever writes a file sets a time (ctime) that nobody can set back. Files with another status are hashed.

    Attributes:
        folder: holds the files and the record.
        made_from: identifies all that they depend on.
    """

    folder: Path
    made_from: str

    def missing(self, names: Iterable[str]) -> list[str]:
        """Which of the wanted files are not here as they were made from just this."""
        noted = self._noted()
        return [name for name in names if not _is_as_noted(self.folder / name, noted.get(name))]

    def are_whole(self) -> bool:
        """Tell whether files have been noted, and each of them is as it was."""
        noted = self._noted()
        return bool(noted) and not self.missing(noted)

    def note(self, names: Iterable[str]) -> None:
        """Note files that have just been made, or that are as they were made."""
        noted = self._noted()
        files = {name: self.folder / name for name in names}
        changed = {name: _entry(file) for name, file in files.items() if noted.get(name, ())[:-1] != _status(file)}
        if changed:
            write_json(self.folder / DIGESTS, {"made_from": self.made_from, "files": noted | changed})

    def _noted(self) -> dict[str, list[Any]]:
        """File name -> status and digest, as far as made from the same."""
        try:
            record = read_json(self.folder / DIGESTS)
            return dict(record["files"]) if record["made_from"] == self.made_from else {}
        except (ResultsError, KeyError, TypeError, ValueError):  # none yet, or damaged
            return {}


def _is_as_noted(file: Path, noted: list[Any] | None) -> bool:
    return noted is not None and file.is_file() and (noted[:-1] == _status(file) or noted[-1] == digest_files([file]))


def _entry(file: Path) -> list[Any]:
    return [*_status(file), digest_files([file])]  # the status first: what is written meanwhile shows in the next one


def _status(file: Path) -> list[int]:
    about = file.stat()
    return [about.st_ino, about.st_size, about.st_mtime_ns, about.st_ctime_ns]
