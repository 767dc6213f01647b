"""The demo rooms evaluated one after another, and one page of them all: `ggvs-eval run OUT` where no capture is given."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from ggvs_eval.capture import Capture
from ggvs_eval.pipelines.evaluate import measure, report
from ggvs_eval.pipelines.jobs.engine import Workers, as_engine
from ggvs_eval.pipelines.methods.registry import NO_CHECKPOINTS, Checkpoints
from ggvs_eval.pipelines.offline.depth_choice import DepthChoice
from ggvs_eval.pipelines.planning.wish import Wish
from ggvs_eval.protocol import load_protocol
from ggvs_eval.synthetic.demo import write_demo
from ggvs_eval.synthetic.demo_rooms import DEMO_ROOMS, MAIN
from ggvs_eval.synthetic.options import DemoOptions

SMALL_ROOMS_METHODS = ("no-blending", "distance-based", "ours")


def evaluate_demos(
    root: Path,
    labels: Sequence[str],
    small_labels: Sequence[str],
    workers: Workers,
    open_demo: Callable[[Path], Capture],
    depth: DepthChoice | None = None,
    checkpoints: Checkpoints = NO_CHECKPOINTS,
    rooms: Mapping[str, DemoOptions] = MappingProxyType(DEMO_ROOMS),
    tell: Callable[[Wish], None] | None = None,
) -> Path:
    """Film and evaluate every demo room; a second call does only what is missing.

    Args:
        root: run folder of the main room; the others' lie beside it, and each capture beside its run.
        labels: methods of the main room.
        small_labels: methods of the others.
        workers: where jobs run.
        open_demo: opens the folder of a capture.
        depth: how depth is found.
        checkpoints: of methods whose weights do not ship.
        rooms: name of the protocol -> what is filmed.
        tell: is called before each evaluation.

    Returns:
        The page of all rooms, in the main room's run folder.
    """
    roots = {name: demo_root(root, name) for name in rooms}
    for name, options in rooms.items():
        capture = open_demo(write_demo(capture_beside(roots[name]), options, as_engine(workers).jobs))
        wish = Wish(roots[name], capture, load_protocol(name), labels if name == MAIN else small_labels, depth, checkpoints)
        if tell is not None:
            tell(wish)
        measure(wish.root, capture, wish.protocol, wish.labels, workers, depth, checkpoints)
    return report([*roots.values()])


def demo_root(root: Path, name: str) -> Path:
    """Run folder of a demo room: the given one, or ``<root>-<layout>`` beside it."""
    return root.with_name(root.name + name.removeprefix(MAIN))


def capture_beside(root: Path) -> Path:
    """Where the capture of a demo's run lies."""
    return root.with_name(f"{root.name}-capture")
