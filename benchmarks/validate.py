"""``make validate``: the heavier proofs, on real input if it is next to the checkout and on the
demo capture.

Prints tables and writes out/validate.json: name -> value, unit, target, direction, command, and the
peer where there is one with the ratio by which this package is better.
"""

import argparse
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.calibration_errors import measure_against
from benchmarks.depth_validation.evaluate_matcher import validate_depth
from ggvs_eval.datasets import open_capture
from ggvs_eval.kernels import usable_cpus
from ggvs_eval.pipelines.methods.registry import usual_methods
from ggvs_eval.pipelines.run.evaluate import evaluate
from ggvs_eval.protocol import load_protocol
from ggvs_eval.results import Results
from ggvs_eval.run_folder import write_json

COMMAND = "make validate"
OURS = ("ours", "")
NO_TEMPORAL = ("ours", "no-temporal")
GEOMETRIC = ("ours-geometric", "")
PEERS = (("distance-based", ""), ("no-blending", ""))
# average of its two DyNeRF test scenes
PAPER_DYNERF = {"PSNR": 31.17, "SSIM": 0.936, "LPIPS": 0.191, "L1": 5.09}
HIGHER_IS_BETTER = ("PSNR", "SSIM")
# sources by distance, as in the paper, and by what they see
REAL_PROTOCOLS = ("real_frame", "real_frame_coverage")
SHIPPED_MATCHERS = ("sgbm", "sweep", "raft")

Figures = dict[str, dict[str, Any]]
# metric -> target (the peer's value where None), higher is better
Targets = Mapping[str, tuple[float | None, bool]]


def main() -> None:
    """Run every proof whose input is there; what is absent is named, not skipped in silence."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--data", type=Path, default=Path("../shared/data"), help="folder with n3v_flame_steak"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out"), help="folder for validate.json and the run folders"
    )
    arguments = parser.parse_args()
    figures = validate_demo(arguments.out / "demo")
    figures |= validate_depth(arguments.data, arguments.out, SHIPPED_MATCHERS)
    real = arguments.data / "n3v_flame_steak"
    if real.is_dir():
        figures |= validate_calibration(real, arguments.out / "calibration")
        for protocol in REAL_PROTOCOLS:
            figures |= validate_real_frame(real, arguments.out / protocol, protocol)
    else:
        print(f"real frame: not computed: no capture at {real}; give --data")
    write_json(arguments.out / "validate.json", figures)
    print(arguments.out / "validate.json")


def validate_calibration(capture: Path, out: Path) -> Figures:
    """Return the cameras found from the images alone, against those that come with the capture."""
    from ggvs_eval.pipelines.offline.calibration.calibrate import CalibrationOptions, calibrate

    shutil.rmtree(out, ignore_errors=True)
    given = open_capture(capture)
    start = time.perf_counter()
    errors = measure_against(
        given, calibrate(capture / "images", out, CalibrationOptions(shared_intrinsics=True))
    )
    errors["seconds"] = time.perf_counter() - start
    targets: dict[str, tuple[float | None, bool]] = {
        "n_registered": (float(len(given.cameras)), True),
        "mean_reprojection_error_px": (1.0, False),
        "centre_error_percent_max": (1.0, False),
        "rotation_error_deg_max": (0.2, False),
        "seconds": (None, False),
    }
    units = dict(zip(targets, ("cameras", "px", "% of the extent", "deg", "s"), strict=True))
    print(
        pd.Series({name: errors[name] for name in targets}, name="calibration").round(4).to_string()
    )
    return {
        f"calibration.{name}": {
            "value": errors[name],
            "unit": units[name],
            "target": target,
            "higher_is_better": higher,
            "command": COMMAND,
        }
        for name, (target, higher) in targets.items()
    }


def validate_real_frame(capture: Path, run: Path, protocol: str) -> Figures:
    """Return one real instant, leave-one-out on nine views.

    The target takes no part in any depth.
    """
    # variants differ over time only
    labels = [label for label in usual_methods() if "+" not in label]
    evaluate(run, open_capture(capture), load_protocol(protocol), labels, usable_cpus())
    results = Results.read(run)
    for metric in ("PSNR", "PSNR_cc", "SSIM", "LPIPS", "L1"):
        if metric not in results.not_computed:
            print(_shown(results.per_view(metric), metric))
    means = _means(results)
    targets: Targets = {
        metric: (value, metric in HIGHER_IS_BETTER) for metric, value in PAPER_DYNERF.items()
    }
    figures = _compared(protocol, means, targets, OURS, GEOMETRIC)
    return figures | _compared(protocol, means, {"PSNR": (None, True)}, PEERS[0], PEERS[1])


def validate_demo(run: Path) -> Figures:
    """The demo room of `make reports` over time: ours against both baselines, and against itself
    without its temporal term.
    """
    from ggvs_eval.synthetic.shipped import write_room

    capture = write_room(run.with_name(f"{run.name}-capture"))
    evaluate(run, open_capture(capture), load_protocol("demo"), usual_methods(), usable_cpus())
    means = _means(Results.read(run))
    print(means.round(4).to_string())
    targets: Targets = {"PSNR": (None, True), "TCC": (None, True), "STED": (None, False)}
    figures: Figures = {}
    for peer in PEERS:
        figures |= _compared("demo", means, targets, OURS, peer)
    return figures | _compared("demo", means, {"STED": (None, False)}, OURS, NO_TEMPORAL)


def _means(results: Results) -> pd.DataFrame:
    return results.summary().droplevel("dataset")


def _compared(
    data: str, means: pd.DataFrame, targets: Targets, ours: tuple[str, str], peer: tuple[str, str]
) -> Figures:
    """Return the figures of one method against one peer.

    Without a target, the peer's value is the target.
    """
    figures = {}
    for metric, (target, higher) in targets.items():
        if metric not in means.columns:
            continue
        value, other = (float(means[metric].to_dict()[method]) for method in (ours, peer))
        figures[
            f"{data}.{metric}.{'+'.join(filter(None, ours))}.vs.{'+'.join(filter(None, peer))}"
        ] = {
            "value": value,
            "unit": "dB" if metric.startswith("PSNR") else "",
            "target": other if target is None else target,
            "higher_is_better": higher,
            "command": COMMAND,
            "peer": "+".join(filter(None, peer)),
            "peer_value": other,
            "ratio": value / other if higher else other / value,
        }
    return figures


def _shown(table: pd.DataFrame, metric: str) -> str:
    """Return one metric per view with its mean, as text."""
    return f"\n{metric}\n{table.assign(mean=table.mean(axis=1)).round(4).to_string()}"


if __name__ == "__main__":
    main()
