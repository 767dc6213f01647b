"""Every method by the name that the command line and the folders use."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any, cast

from ggvs_eval import built_in
from ggvs_eval.errors import AbsentPartError, RenderError, did_you_mean
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED, NetworkOptions
from ggvs_eval.pipelines.methods.spec import MethodSpec, OnlineMethod
from ggvs_eval.plugins import Registry, imported
from ggvs_eval.results import split_label


def _checked(name: str, offered: object) -> MethodSpec:
    """Return a method of a plug-in: a `MethodSpec`, or what makes an object with `Method.step`."""
    if isinstance(offered, MethodSpec):
        return replace(offered, foreign=True)
    if not callable(offered):
        raise TypeError(f"wanted a MethodSpec or a class with a step, got {type(offered).__name__}")
    about = (getattr(offered, "__doc__", None) or "").strip().partition("\n")[0]
    return OnlineMethod(name, about or f"{name}, of a plug-in", offered, foreign=True)


# Every method by its label, `method` or `method+variant`; its renders are in a folder of that name.
METHODS: Registry[MethodSpec] = Registry("methods", built_in.METHODS, _checked)


STORED_SCENES: Registry[Any] = Registry("stored scenes", built_in.STORED_SCENES)
SPLATS = "splats"


def named_scenes(labels: Sequence[str]) -> tuple[tuple[str, ...], dict[str, Path]]:
    """Give each scene of others among some methods, ``splats:PATH``, a name that folders can bear.

    Returns:
        The labels, and label -> path of those that are scenes.
    """
    if not any(f"{SPLATS}:" in label for label in labels):
        return tuple(labels), {}
    return cast("tuple[tuple[str, ...], dict[str, Path]]", STORED_SCENES[SPLATS].named(labels))


def usual_methods() -> tuple[str, ...]:
    """Return the labels of the methods that are rendered where none are named."""
    return tuple(label for label in built_in.USUAL_METHODS if label in METHODS)


def weights_takers() -> list[str]:
    """Return the labels of the methods whose weights the user can give."""
    return [
        name
        for name, spec in METHODS.built_in().items()
        if isinstance(spec, OnlineMethod) and "weights" in spec.takes
    ]


def find_method(label: str, networks: NetworkOptions = AS_SHIPPED) -> MethodSpec:
    """The method of that label.

    ``METHOD+OPTION=VALUE+...`` is one with other options, ``METHOD+scale=0.5`` at half the size.

    Args:
        label: ``method`` or ``method+variant``.
        networks: the user's weights, instead of those that ship, and the device; a method that has
            neither weights is found but cannot be made.
    """
    if label in networks.splats:
        return STORED_SCENES[SPLATS].of(label, networks.splats[label])
    spec = _as_shipped(label)
    method, _ = split_label(label)
    if method in networks.checkpoints:
        if not isinstance(spec, OnlineMethod) or "weights" not in spec.takes:
            able = ", ".join(weights_takers())
            raise RenderError(
                f"method {label}: {spec.title} takes no weights from outside; these do: {able}"
            )
        spec = spec.rendering_with(networks.checkpoints[method])
    return spec.on(networks.device)


def known_method(label: str) -> MethodSpec | None:
    """Return the method of that label as it ships; None for frames that were rendered elsewhere."""
    try:
        return find_method(label)
    except RenderError:
        return None


def _as_shipped(label: str) -> MethodSpec:
    """Return the method of a label with the weights that ship, on the CPU."""
    parts = takewhile(lambda part: "=" not in part, label.split("+"))
    named = label if label in METHODS else "+".join(parts)  # ours of ours+scale=0.5
    if named in METHODS:
        spec = METHODS[named]
        if isinstance(spec, OnlineMethod):  # without its weights it cannot be made
            spec = replace(spec, weights=tuple(file for file in spec.weights if file.is_file()))
        return spec if named == label else spec.configured(label, label.removeprefix(f"{named}+"))
    if reason := METHODS.why_absent(label) or METHODS.why_absent(named):
        raise AbsentPartError(reason)
    if ":" in label:
        return _checked(label, imported(label))
    suggestion = did_you_mean(label, METHODS)
    raise RenderError(
        f"unknown method {label!r}{suggestion or '.'} Known are {', '.join(METHODS)}; one of your "
        f"own needs --plugin FILE.py"
    )
