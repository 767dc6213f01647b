"""Folders that a run derives from others: masks, path depth, the report; made anew when what they are made from changes."""

import hashlib
import os
import shutil
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from ggvs_eval.camera import Camera
from ggvs_eval.errors import ResultsError
from ggvs_eval.run_folder import read_json, write_json

NOTE = "made_from.json"
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
        for file in sorted(Path(place, name) for name in files):
            about = file.stat()
            content = file.read_bytes() if file.suffix in RECORDS else f"{about.st_size} {about.st_mtime_ns}".encode()
            digest.update(f"{file.relative_to(folder)}\0".encode() + content)
    return digest.hexdigest()
