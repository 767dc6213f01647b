"""A short trial of scoring: one method's frames through the cheap metrics, one picture through LPIPS, the rest by counting."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ggvs_eval.files.images import read_image, resize
from ggvs_eval.metrics.fetch_lpips import weights_path
from ggvs_eval.pipelines.run.coverage import Coverage
from ggvs_eval.pipelines.run.prepare import Prepared
from ggvs_eval.pipelines.run.score_view import view_job
from ggvs_eval.protocol import Measurement
from ggvs_eval.run_folder import RunFolder, frame_path

LPIPS = "LPIPS"  # what the names of metrics begin with that take a network
WARM_UP_PX = 64  # side of a picture that loads the network and is soon done


def try_scoring(
    planned: Prepared, scratch: RunFolder, view: str, frames: range, labels: Sequence[str], truth: Path
) -> tuple[float, float, float]:
    """Seconds until the metrics are loaded, per instant of all methods, and per instant of one without LPIPS.

    Args:
        planned: the run.
        scratch: a run folder with the renders of the first of the methods.
        view: that was rendered.
        frames: that were rendered.
        labels: methods.
        truth: folder of the captured frames, by view.

    Reading:
        LPIPS is nearly all of the time. Its network sees the truth once and each method's frame once per metric, so one picture
        tells the whole; the others are measured on one method and taken that often.
    """
    if not labels:
        return 0.0, 0.0, 0.0
    scratch.truth(view).parent.mkdir(parents=True, exist_ok=True)
    scratch.truth(view).symlink_to((truth / view).resolve(), target_is_directory=True)
    measurement, coverage = planned.protocol.measurement, Coverage(frames, {}, {}, {})
    learned = [name for name in measurement.metrics if name.startswith(LPIPS)]
    plain = replace(measurement, metrics=tuple(name for name in measurement.metrics if name not in learned))
    job = view_job(scratch, replace(planned.protocol, measurement=plain), coverage, labels[:1], view)
    first_s, again_s = (timed(lambda: job.work(scratch.root)) for _ in range(2)) if plain.metrics else (0.0, 0.0)
    setup_s, network_s, distance_s = (0.0, 0.0, 0.0)
    if learned and weights_path(measurement.lpips_net).is_file():
        setup_s, network_s, distance_s = _try_lpips(frame_path(truth / view, frames[0]), measurement)
    plain_s, compared = again_s / len(frames), len(labels) * len(learned)
    whole_s = len(labels) * plain_s + (1 + compared) * network_s + compared * distance_s
    return max(first_s - again_s, 0.0) + setup_s, whole_s, plain_s


def _try_lpips(file: Path, measurement: Measurement) -> tuple[float, float, float]:
    """Seconds until LPIPS is loaded, of its network on one picture, and of the comparison of two."""
    from ggvs_eval.metrics.lpips import lpips_between, lpips_features

    net, small = measurement.lpips_net, np.zeros((WARM_UP_PX, WARM_UP_PX, 3), np.uint8)
    setup_s = timed(lambda: lpips_features(small, net))
    image = read_image(file)
    if measurement.width:
        image = resize(image, measurement.width, measurement.height, measurement.resize_filter)
    begun_s = time.perf_counter()
    features = lpips_features(image, net)
    network_s = time.perf_counter() - begun_s
    return setup_s, network_s, timed(lambda: lpips_between(features, features, net))


def timed(work: Callable[[], object]) -> float:
    """Seconds that something takes."""
    begun_s = time.perf_counter()
    work()
    return time.perf_counter() - begun_s
