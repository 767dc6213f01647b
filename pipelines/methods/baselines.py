"""The methods that the paper compares itself with."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Literal, NoReturn

from ggvs_eval.errors import WeightsError
from ggvs_eval.method import Method
from ggvs_eval.pipelines.methods.spec import MethodSpec, shipped


def _no_blending() -> Method:
    from ggvs_eval.baselines.no_blending import NoBlending

    return NoBlending()


def _distance_based() -> Method:
    from ggvs_eval.baselines.distance_based import DistanceBased

    return DistanceBased()


def _ibrnet(checkpoint: Path, device: str = "cpu") -> Method:
    from ggvs_eval.baselines.ibrnet.method import IBRNet

    return IBRNet(checkpoint, device=device)


def _enerf(checkpoint: Path, device: str = "cpu") -> Method:
    from ggvs_eval.baselines.enerf.method import ENeRF

    return ENeRF(checkpoint, device=device)


def _gps_gaussian(checkpoint: Path, depth: Literal["own", "given"] = "own", device: str = "cpu") -> Method:
    from ggvs_eval.baselines.gps_gaussian.method import GpsGaussian

    return GpsGaussian(checkpoint, depth=depth, device=device)


def _fwd(checkpoint: Path, device: str = "cpu") -> Method:
    from ggvs_eval.baselines.fwd.method import Fwd

    return Fwd(checkpoint, device=device)


def _without_checkpoint(title: str, label: str, checkpoint: str, device: str = "cpu") -> NoReturn:
    """Without weights there is nothing to put on a device."""
    method = label.partition("+")[0]
    raise WeightsError(f"{title}: its weights do not ship; wanted {checkpoint}, give it by --weights {method}=FILE")


def _retrained(title: str, label: str, checkpoint: str, make_from: Callable[..., Method], device: str = "cpu") -> Method:
    """With the weights that ship, if they do."""
    weights = shipped(_weights_name(label))
    if not weights.is_file():
        _without_checkpoint(title, label, checkpoint)
    return make_from(weights, device=device)


def _weights_name(label: str) -> str:
    return f"{label.partition('+')[0]}.safetensors"


def _learned(
    label: str,
    title: str,
    describe: str,
    checkpoint: str,
    module: str,
    make_from: Callable[..., Method],
    retrained: str = "",
) -> MethodSpec:
    """A network that renders with a checkpoint of its authors, or of whoever trained it.

    `module` is where its class stands; `retrained` says in what configuration we trained it; without, it needs a checkpoint.
    """
    make: Callable[..., Method] = partial(_without_checkpoint, title, label, checkpoint)
    weights: tuple[Path, ...] = ()
    if retrained:
        make = partial(_retrained, title, label, checkpoint, make_from)
        weights = (shipped(_weights_name(label)),)
    return MethodSpec(
        f"{title} (retrained, {retrained})" if retrained else title,
        describe,
        make,
        (module,),
        usual=False,
        weights=weights,
        checkpoint=checkpoint,
        make_from=make_from,
        title_from=title,
    )


BASELINES: dict[str, MethodSpec] = {
    "no-blending": MethodSpec(
        "No Blending",
        "all Gaussians of the K views in one pass, the nearest wins",
        _no_blending,
        ("ggvs_eval.baselines.no_blending",),
    ),
    "distance-based": MethodSpec(
        "Distance-based Blending",
        "splatted views weighted by camera distance (LLFF)",
        _distance_based,
        ("ggvs_eval.baselines.distance_based",),
    ),
    "fwd": _learned(
        "fwd",
        "FWD",
        "features splatted by the given depth, fused by attention",
        "a checkpoint of our network",
        "ggvs_eval.baselines.fwd.method",
        _fwd,
        "compact",
    ),
    "ibrnet": _learned(
        "ibrnet",
        "IBRNet",
        "colours of the views blended along rays",
        "model_255000.pth of googleinterns/IBRNet",
        "ggvs_eval.baselines.ibrnet.method",
        _ibrnet,
        "compact",
    ),
    "gps-gaussian": _learned(
        "gps-gaussian",
        "GPS-Gaussian",
        "Gaussians of the nearest pair by its own stereo",
        "GPS-GS_stage2_final.pth of aipixel/GPS-Gaussian",
        "ggvs_eval.baselines.gps_gaussian.method",
        _gps_gaussian,
    ),
    "gps-gaussian+given-depth": _learned(
        "gps-gaussian+given-depth",
        "GPS-Gaussian, Given Depth",
        "Gaussians of the nearest pair by the depth that the others get",
        "GPS-GS_stage2_final.pth of aipixel/GPS-Gaussian",
        "ggvs_eval.baselines.gps_gaussian.method",
        partial(_gps_gaussian, depth="given"),
        "compact",
    ),
    "enerf": _learned(
        "enerf",
        "ENeRF",
        "radiance near the surface of a cost volume",
        "dtu_pretrain/latest.pth of zju3dv/ENeRF",
        "ggvs_eval.baselines.enerf.method",
        _enerf,
        "compact",
    ),
}
