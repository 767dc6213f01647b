"""The whole online step at 1352 x 1014 with K = 4, stage by stage, decoding excluded: ``python -m benchmarks.bench_online``."""

from typing import Any

import numpy as np

from benchmarks.bench_geometry import WIDTH, Scene, make_scene
from ggvs_eval.baselines.method import Instant, SourceView
from ggvs_eval.images import quantise
from ggvs_eval.kernels import get_threads
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided

WARM_UP, STEPS = 2, 8
COMMAND = "python -m benchmarks.bench_online"


def measure() -> dict[str, dict[str, Any]]:
    """Median milliseconds of the step and of its stages after warm-up; the scene stands still, which costs the same."""
    scene, method = make_scene(WIDTH), GeometryGuided()
    seconds = [method.step(_instant(scene, index)).seconds for index in range(WARM_UP + STEPS)][WARM_UP:]
    stages = {stage: float(np.median([frame[stage] for frame in seconds])) * 1e3 for stage in seconds[0]}
    total = float(np.median([sum(frame.values()) for frame in seconds])) * 1e3
    figures = {f"online_step_{stage}": _figure(value, None) for stage, value in stages.items()}
    return {"online_step": _figure(total, 1000.0)} | figures


def _instant(scene: Scene, index: int) -> Instant:
    image = quantise(scene.image)
    views = zip(scene.cameras, scene.depths, strict=True)
    sources = tuple(SourceView(camera, image, depth, np.ones_like(depth)) for camera, depth in views)
    return Instant(index, scene.target, sources, units_per_metre=1.0)


def _figure(value: float, target: float | None) -> dict[str, Any]:
    command = f"{COMMAND} ({get_threads()} threads)"
    return {"value": value, "unit": "ms", "target": target, "higher_is_better": False, "command": command}


if __name__ == "__main__":
    for name, figure in measure().items():
        print(f"{name}: {figure['value']:.1f} ms")
