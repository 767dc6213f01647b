"""Every method by the name that the command line and the folders use."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from ggvs_eval.errors import RenderError, did_you_mean
from ggvs_eval.files.toml_tables import build_table
from ggvs_eval.pipelines.methods.baselines import baseline_methods
from ggvs_eval.pipelines.methods.fitted import FITTED, configured_fit, splats_method
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED, NetworkOptions
from ggvs_eval.pipelines.methods.ours import OURS
from ggvs_eval.pipelines.methods.spec import MethodSpec, option_values
from ggvs_eval.plugins import Registry, imported


def _checked(name: str, offered: object) -> MethodSpec:
    """A method of a plug-in: a `MethodSpec`, or what makes an object with `Method.step`."""
    if isinstance(offered, MethodSpec):
        return replace(offered, usual=False)
    if not callable(offered):
        raise TypeError(f"wanted a MethodSpec or a class with a step, got {type(offered).__name__}")
    about = (getattr(offered, "__doc__", None) or "").strip().partition("\n")[0]
    return MethodSpec(name, about or f"{name}, of a plug-in", offered, (offered.__module__,), usual=False)


def all_methods() -> Registry[MethodSpec]:
    """Every method by its label, `method` or `method+variant`; its renders lie in a folder of that name."""
    return Registry("methods", baseline_methods() | FITTED | OURS, _checked)


METHODS = all_methods()


def usual_methods() -> tuple[str, ...]:
    """Labels of the methods that are rendered where nobody names any."""
    return tuple(label for label, spec in METHODS.shipped.items() if spec.usual)


def find_method(label: str, networks: NetworkOptions = AS_SHIPPED) -> MethodSpec:
    """The method of that label; ``METHOD+OPTION=VALUE+...`` is one with other `OnlineOptions`.

    Args:
        label: ``method`` or ``method+variant``.
        networks: the user's weights, instead of those that ship, and the device; a method that has neither weights is found but
            cannot be made.

    Raises:
        RenderError: unknown; the message names the nearest known one.
    """
    if label in networks.splats:
        return splats_method(label, networks.splats[label])
    return _found(label, networks.checkpoints).on(networks.device)


def _found(label: str, checkpoints: Mapping[str, Path]) -> MethodSpec:
    """The method of a label on the CPU."""
    method, variant = split_label(label)
    if method in checkpoints:
        return _with_checkpoint(label, checkpoints[method])
    if method in METHODS and "=" in variant:
        return _configured(label, METHODS[method], variant)
    if label not in METHODS and ":" in label:
        return _checked(label, imported(label))
    if label not in METHODS:
        suggestion = did_you_mean(label, METHODS, cutoff=0.0)
        raise RenderError(f"unknown method {label!r}{suggestion} Known are {', '.join(METHODS)}")
    spec = METHODS[label]
    return replace(spec, weights=tuple(file for file in spec.weights if file.is_file()))  # without them it cannot be made


def _with_checkpoint(label: str, checkpoint: Path) -> MethodSpec:
    """A method with the weights that the user gave."""
    spec = find_method(label)
    if spec.make_from is None:
        able = ", ".join(name for name, each in METHODS.shipped.items() if each.make_from)
        raise RenderError(f"method {label}: {spec.title} takes no weights from outside; these do: {able}")
    title = spec.title_from or spec.title
    return replace(spec, title=title, make=partial(spec.make_from, checkpoint), make_from=None, weights=(checkpoint,))


def _configured(label: str, spec: MethodSpec, variant: str) -> MethodSpec:
    """A method with the options that its label names."""
    from ggvs_eval.pipelines.online.geometry_guided import OnlineOptions

    if spec.is_fitted:
        return configured_fit(label, spec, variant)
    if spec.make_with is None:
        able = ", ".join(name for name, each in METHODS.shipped.items() if each.make_with or each.is_fitted)
        raise RenderError(f"method {label}: {spec.title} has no options to set; these have: {able}")
    options = build_table(OnlineOptions, option_values(variant), f"method {label}", "", RenderError)
    title = f"{spec.title}, {variant.replace('+', ', ')}"
    return replace(spec, title=title, make=partial(spec.make_with, options), usual=False)


def split_label(label: str) -> tuple[str, str]:
    """(method, variant) of a label; the variant of a plain method is the empty string."""
    method, _, variant = label.partition("+")
    return method, variant
