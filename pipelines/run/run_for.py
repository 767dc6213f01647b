"""The run folder that renders are scored in: one that there is, or one made of a capture and a protocol."""

import os
from collections.abc import Callable
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.errors import ProtocolError
from ggvs_eval.pipelines.run.asked_protocol import asked_protocol
from ggvs_eval.pipelines.run.claim import require_protocol
from ggvs_eval.pipelines.run.import_renders import plain_label
from ggvs_eval.pipelines.run.prepare import prepare_truth
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from ggvs_eval.run_folder import RunFolder

SCORES_ROOT = Path("scores")


def run_for(root: Path | None, open_capture: Callable[[], Capture] | None, protocol: str | None, workers: int) -> RunFolder:
    """Open a run folder, or make one that holds the captured frames of the test views and nothing else.

    Args:
        root: the folder; ``scores/<capture's folder>`` where None.
        open_capture: opens what was rendered, once all else is known to be right; None where the folder has a run.
        protocol: a .toml file or a packaged name; the folder's own, or the packaged one that fits, where None.

    Raises:
        ProtocolError: neither a folder nor a capture, or a folder of another protocol or capture.
    """
    asked = asked_protocol(protocol) if protocol else None
    if root is None and open_capture is None:
        raise ProtocolError("wanted a run folder, or --capture CAPTURE and --protocol PROTOCOL to make one, got neither")
    capture = open_capture() if open_capture else None
    run = RunFolder(root or SCORES_ROOT / (capture.path.resolve().name if capture else ""))
    own = run.protocol() if run.protocol_file.is_file() else None
    if asked:
        require_protocol(run, asked.over(own.frames.numbers.stop) if own else asked)
    if capture:
        prepare_truth(run.root, capture, asked or own or suggest_protocol(capture), workers)
    return run


def named_renders(items: tuple[str, ...]) -> dict[str, Path]:
    """Name -> path of ``NAME=PATH`` or of a bare path, which is called by its last part, as far as that is free and plain."""
    named: dict[str, Path] = {}
    for item in items:
        name, separator, path = item.partition("=")
        if not separator or "/" in name:  # a path may hold = too
            name, path = plain_label(Path(os.path.abspath(item)).name.split(".")[0]), item
        if name in named:
            raise ProtocolError(f"--renders: {named[name]} and {path} would both be called {name}; give NAME=PATH")
        named[name] = Path(path)
    return named
