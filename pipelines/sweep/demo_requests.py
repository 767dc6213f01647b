"""What `ggvs-eval run OUT` wants where no capture is given, to be planned without filming."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED, NetworkOptions
from ggvs_eval.pipelines.offline.depth.depth_choice import DepthRunOptions
from ggvs_eval.pipelines.planning.demo_plan import demo_to_plan
from ggvs_eval.pipelines.planning.run_request import RunRequest
from ggvs_eval.pipelines.sweep.cells import run_requests
from ggvs_eval.pipelines.sweep.demo_runs import K_PROTOCOL, capture_beside, demo_root, k_root, k_sweep
from ggvs_eval.protocol import load_protocol
from ggvs_eval.synthetic.demo_rooms import DEMO_ROOMS, MAIN


def demo_requests(
    root: Path,
    labels: Mapping[str, Sequence[str]],
    open_demo: Callable[[Path], Capture],
    depth: DepthRunOptions | None = None,
    networks: NetworkOptions = AS_SHIPPED,
) -> Iterator[list[RunRequest]]:
    """The runs of each demo room, and those over K, as `evaluate_demos` evaluates them; nothing is written.

    Args:
        root: run folder of the main room.
        labels: name of a room -> its methods.
        open_demo: opens the folder of a capture that was rendered already.
        depth: how depth is found.
        networks: with which weights and where networks compute.
    """
    for name, options in DEMO_ROOMS.items():
        place = demo_root(root, name)
        capture = demo_to_plan(capture_beside(place), options, open_demo)
        yield [RunRequest(place, capture, load_protocol(name), labels[name], depth, networks)]
    if (sweep := k_sweep(labels[MAIN])).row:
        main = demo_to_plan(capture_beside(root), DEMO_ROOMS[MAIN], open_demo)
        over_k = run_requests(k_root(root), {"": (main, load_protocol(K_PROTOCOL))}, sweep, depth, networks)
        yield [replace(request, shared=root) for request in over_k]
