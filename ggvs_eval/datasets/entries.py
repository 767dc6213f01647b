"""Entries of calibration files: the one list of those that say where a pixel looks, and numbers of
strangers.
"""

import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.errors import CaptureError

# What says where a pixel looks: lens models, fields of view, projections, turned axes. Such an
# entry is read or refused.
VIEW_ENTRY = re.compile(
    r"^(xi|alpha|beta|gamma|mu|omega|skew|[kps][1-9])$|lens|distort|dist_|omni|polynomial|coeff"
    r"|fov|theta|lat_?long|equirect|panoram|spheric|ortho|projection|fisheye|camera_(model|type)|^from_",
    re.I,
)
SAID = re.compile(r"[1-9]|\btrue\b|equirect|panoram|spheric|fisheye|ortho|omni", re.I)


def unknown_entries(
    path: Path, entries: Mapping[str, Any], known_keys: Collection[str]
) -> list[str]:
    """The entries of a file that its reader skips.

    Raises:
        CaptureError: one of them says where a pixel looks (`VIEW_ENTRY`), and is not 0 or no.
    """
    unknown = [key for key in entries if key not in known_keys]
    for key in unknown:
        value = str(entries[key]).strip()
        if VIEW_ENTRY.search(key) and SAID.search(value):
            why = "it is cv::omnidir's model; " if key == "xi" else ""
            raise CaptureError(
                f"{path}: {key}: {value:.40} belongs to the lens and is not read; {why}undistort "
                "the frames with it first, or write the lens in OpenCV's entries"
            )
    return unknown


def plain_numbers(value: object) -> Array:
    """Return numbers in lists as an array; an empty one of anything else."""
    try:
        values = np.array(value)
    except ValueError:  # lists of different lengths
        return np.empty(0)
    return values.astype(np.float64) if values.dtype.kind in "if" else np.empty(0)
