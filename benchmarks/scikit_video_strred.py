"""ST-RRED of this package and of scikit-video by turns, in a separate process: scikit-video needs
names that numpy has dropped.

``python -m benchmarks.scikit_video_strred`` prints one line of JSON; without scikit-video, one line
that says so, and exit 1. scikit-video is no dependency: ``pip install --no-deps scikit-video``, or
its folder on PYTHONPATH.
"""

import builtins
import importlib
import json
import sys
import time
import warnings
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage import data

from ggvs_eval.metrics.time.strred import luma, strred

WIDTH, HEIGHT, FRAMES = 1352, 1014, 4
ROUNDS = 4
ABSENT = "peer not installed: pip install --no-deps scikit-video"


def main() -> None:
    """Score one clip with both and print times and values."""
    peer = patched_peer()
    if peer is None:
        sys.exit(ABSENT)
    rendered, truth = make_clip()
    ours_s, peer_s = [], []
    for _ in range(ROUNDS):
        seconds, ours = _timed(lambda: strred(rendered, truth))
        ours_s.append(seconds)
        seconds, theirs = _timed(lambda: peer(truth, rendered))
        peer_s.append(seconds)
    values = {
        "value": ours.strred,
        "peer_value": float(theirs[1]),
        "single": ours.strred_ssn,
        "peer_single": float(theirs[2]),
    }
    print(
        json.dumps(
            {"ours_ms": min(ours_s) * 1e3 / FRAMES, "peer_ms": min(peer_s) * 1e3 / FRAMES} | values
        )
    )


def patched_peer() -> Callable[..., Any] | None:
    """scikit-video's function with numpy's old names put back, or None where it is not
    installed.
    """
    warnings.simplefilter("ignore")
    for name in ("int", "float", "bool", "complex", "object"):
        if name not in vars(np):  # numpy 2 has its own np.bool
            setattr(np, name, getattr(builtins, name))
    try:
        function: Callable[..., Any] = importlib.import_module("skvideo.measure.strred").strred
    except ImportError:
        return None
    return function


def make_clip() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Rounded luma (T, H, W) of a photograph that moves by three pixels per frame, with and without
    noise.
    """
    photograph = cv2.resize(data.astronaut(), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    truth = np.stack([np.rint(luma(np.roll(photograph, 3 * t, axis=1))) for t in range(FRAMES)])
    noise = np.random.default_rng(0).normal(0, 5, truth.shape)
    return np.clip(np.rint(truth + noise), 0, 255).astype(np.uint8), truth.astype(np.uint8)


def _timed(call: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    result = call()
    return time.perf_counter() - start, result


if __name__ == "__main__":
    main()
