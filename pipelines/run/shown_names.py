"""What a report says of methods and metrics beside their numbers; it reads this from disk and imports neither."""

from collections.abc import Sequence

from ggvs_eval.errors import RenderError
from ggvs_eval.metrics.registry import metric_notes
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.methods.spec import LEARNED, MethodSpec, OnlineMethod, digest_weights
from ggvs_eval.pipelines.run.score_view import metric_options
from ggvs_eval.protocol import Protocol
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json, write_json

GIVEN = "weights that were given"


def write_shown_names(run: RunFolder, protocol: Protocol, labels: Sequence[str]) -> None:
    """Write titles of methods, what differs between them by design, and notes on metrics."""
    specs = {label: spec for label in labels if (spec := _method_of(label))}
    given = [
        label
        for label, spec in specs.items()
        if isinstance(spec, OnlineMethod) and _has_given_weights(run, protocol, label, spec)
    ]
    titles = {label: _title(specs[label], label in given) if label in specs else label for label in labels}
    looks = [label for label in specs if not specs[label].online]
    write_json(
        run.root / "methods.json",
        {
            "labels": list(labels),
            "names": titles,
            "ours": [label for label in specs if specs[label].ours],
            "from_sources": [label for label in specs if isinstance(specs[label], OnlineMethod)],
            "declared": {label: spec.declared | ({LEARNED: GIVEN} if label in given else {}) for label, spec in specs.items()},
            **({"look_ahead": looks} if looks else {}),
        },
    )
    notes = metric_notes(protocol.measurement.metrics, metric_options(protocol.measurement))
    write_json(run.root / "metrics.json", notes)


def _method_of(label: str) -> MethodSpec | None:
    """Entry of the registry under a label; None for frames that were rendered elsewhere."""
    try:
        return find_method(label)
    except RenderError:
        return None


def _has_given_weights(run: RunFolder, protocol: Protocol, label: str, spec: OnlineMethod) -> bool:
    """Tell whether renders are of a file that the user gave, and not of the weights that ship."""
    files = (run.renders(label, view) / JOB_FILE for view in protocol.views.test)
    identities = [read_json(file).get("identity", {}) for file in files if file.is_file()]
    shipped = [digest_weights(file) for file in spec.weights if file.is_file()]
    return any(identity.get("weights", shipped) != shipped for identity in identities)


def _title(spec: MethodSpec, is_given: bool) -> str:
    return spec.title_from or spec.title if is_given and isinstance(spec, OnlineMethod) else spec.title
