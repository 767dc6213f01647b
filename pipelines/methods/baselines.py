"""The methods that the paper compares itself with."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Literal, NoReturn

from ggvs_eval.baselines.method import Method
from ggvs_eval.errors import WeightsError
from ggvs_eval.pipelines.methods.spec import BASELINE_CODE, MethodSpec


def _no_blending() -> Method:
    from ggvs_eval.baselines.no_blending import NoBlending

    return NoBlending()


def _distance_based() -> Method:
    from ggvs_eval.baselines.distance_based import DistanceBased

    return DistanceBased()


def _ibrnet(checkpoint: Path) -> Method:
    from ggvs_eval.baselines.ibrnet.method import IBRNet

    return IBRNet(checkpoint)


def _enerf(checkpoint: Path) -> Method:
    from ggvs_eval.baselines.enerf.method import ENeRF

    return ENeRF(checkpoint)


def _gps_gaussian(checkpoint: Path, depth: Literal["own", "given"] = "own") -> Method:
    from ggvs_eval.baselines.gps_gaussian.method import GpsGaussian

    return GpsGaussian(checkpoint, depth=depth)


def _fwd(checkpoint: Path) -> Method:
    from ggvs_eval.baselines.fwd.method import Fwd

    return Fwd(checkpoint)


def _without_checkpoint(title: str, label: str, checkpoint: str) -> NoReturn:
    method = label.partition("+")[0]
    raise WeightsError(f"{title}: its weights do not ship; wanted {checkpoint}, give it by --weights {method}=FILE")


def _learned(label: str, title: str, describe: str, checkpoint: str, make_from: Callable[[Path], Method]) -> MethodSpec:
    """A network that renders with a checkpoint of its authors, or of whoever trained it."""
    return MethodSpec(
        title,
        describe,
        partial(_without_checkpoint, title, label, checkpoint),
        BASELINE_CODE,
        usual=False,
        checkpoint=checkpoint,
        make_from=make_from,
    )


BASELINES: dict[str, MethodSpec] = {
    "no-blending": MethodSpec(
        "No Blending", "all Gaussians of the K views in one pass, the nearest wins", _no_blending, BASELINE_CODE
    ),
    "distance-based": MethodSpec(
        "Distance-based Blending", "splatted views weighted by camera distance (LLFF)", _distance_based, BASELINE_CODE
    ),
    "fwd": _learned(
        "fwd", "FWD", "features splatted by the given depth, fused by attention", "a checkpoint of our network", _fwd
    ),
    "ibrnet": _learned(
        "ibrnet", "IBRNet", "colours of the views blended along rays", "model_255000.pth of googleinterns/IBRNet", _ibrnet
    ),
    "gps-gaussian": _learned(
        "gps-gaussian",
        "GPS-Gaussian",
        "Gaussians of the nearest pair by its own stereo",
        "GPS-GS_stage2_final.pth of aipixel/GPS-Gaussian",
        _gps_gaussian,
    ),
    "gps-gaussian+given-depth": _learned(
        "gps-gaussian+given-depth",
        "GPS-Gaussian, Given Depth",
        "Gaussians of the nearest pair by the depth that the others get",
        "GPS-GS_stage2_final.pth of aipixel/GPS-Gaussian",
        partial(_gps_gaussian, depth="given"),
    ),
    "enerf": _learned(
        "enerf", "ENeRF", "radiance near the surface of a cost volume", "dtu_pretrain/latest.pth of zju3dv/ENeRF", _enerf
    ),
}
