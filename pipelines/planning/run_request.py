"""A run that somebody wants, before anything of it is planned."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED, NetworkOptions
from ggvs_eval.pipelines.offline.depth.depth_choice import DepthRunOptions
from ggvs_eval.protocol import Protocol


@dataclass(frozen=True)
class RunRequest:
    """One run that somebody wants.

    Attributes:
        root: run folder.
        capture: at its own size.
        protocol: what is evaluated.
        labels: methods; none where it is only prepared.
        depth: how depth is found; as the folder says, or the default.
        networks: with which weights and where networks compute.
        shared: folder whose truth/ and depth/ it uses together with others; its own where None.
        views: units of a shard, test views or ``path``; None for all.
    """

    root: Path
    capture: Capture
    protocol: Protocol
    labels: Sequence[str]
    depth: DepthRunOptions | None = None
    networks: NetworkOptions = field(default_factory=lambda: AS_SHIPPED)
    shared: Path | None = None
    views: Collection[str] | None = None
