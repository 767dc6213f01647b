"""Folders of pictures that a run derives from its depth: masks and path depth, made anew when what they are made from changes."""

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ggvs_eval.camera import Camera
from ggvs_eval.errors import ResultsError
from ggvs_eval.run_folder import read_json, write_json

NOTE = "made_from.json"


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
    """Whether files of a folder, if there are any, were made from something else, or from nobody knows what."""
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
