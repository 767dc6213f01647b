"""Offline-to-online evaluation of multi-view 3D video synthesis: captures in, scores with intervals
and a page out.

The names below are the public interface. Each is loaded when it is first asked for, so that
``import ggvs_eval`` stays light:

    >>> import ggvs_eval
    >>> ggvs_eval.load_protocol("dynerf").synthesis.k
    4

Metrics are in `ggvs_eval.metrics`.
"""

from importlib import import_module
from importlib.metadata import version
from typing import Any

# Module of each public name. As text, since these rooms are above the package itself; __init__.pyi
# tells type checkers.
_PUBLIC = {
    "Camera": "camera",
    "Capture": "capture",
    "GgvsError": "errors",
    "Instant": "method",
    "Method": "method",
    "OnlineSynthesizer": "pipelines.play.synthesizer",
    "Protocol": "protocol",
    "Rendering": "method",
    "Results": "results",
    "RunFolder": "run_folder",
    "SourceView": "method",
    "evaluate": "pipelines.run.evaluate",
    "import_renders": "pipelines.run.import_renders",
    "load_protocol": "protocol",
    "open_capture": "datasets",
    "score": "pipelines.run.score",
}
__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    """Return a public name, loaded now (PEP 562)."""
    if name == "__version__":
        return version("ggvs-eval")
    if name not in _PUBLIC:
        raise AttributeError(
            f"module 'ggvs_eval' has no attribute {name!r}; public are {', '.join(__all__)}"
        )
    value = getattr(import_module(f"ggvs_eval.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, in addition to loaded attributes."""
    return sorted({*globals(), *_PUBLIC})
