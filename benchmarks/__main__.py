"""``make bench``: every benchmark of this folder, printed and written to out/bench.json; ``...

PART PART``: some.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from benchmarks import (
    bench_baselines,
    bench_decoding,
    bench_depth,
    bench_fit,
    bench_full_reference,
    bench_gaussians,
    bench_geometry,
    bench_growth,
    bench_metrics,
    bench_no_reference,
    bench_online,
    bench_page,
    bench_roofline,
)
from ggvs_eval.run_folder import read_json, write_json

PARTS = {
    "geometry": bench_geometry.measure,
    "gaussians": bench_gaussians.measure,
    "fit": bench_fit.measure,
    "online": bench_online.measure,
    "roofline": bench_roofline.measure,
    "metrics": bench_metrics.measure,
    "full_reference": bench_full_reference.measure,
    "no_reference": bench_no_reference.measure,
    "decoding": bench_decoding.measure,
    "depth": bench_depth.measure,
    "page": bench_page.measure,
    "baselines": bench_baselines.measure,
    "growth": bench_growth.measure,
}


def main(words: Sequence[str] | None = None) -> None:
    """Measure all or some parts; one line per figure.

    Figures of parts that are not measured stay in the file.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; all by default"
    )
    parser.add_argument(
        "--json", type=Path, default=Path("out/bench.json"), help="file of the figures"
    )
    arguments = parser.parse_args(words)
    if unknown := sorted(set(arguments.parts) - PARTS.keys()):
        parser.error(
            f"wanted parts of {', '.join(PARTS)}, got {', '.join(unknown)}; correct the name"
        )
    figures = {
        name: figure for part in arguments.parts or PARTS for name, figure in PARTS[part]().items()
    }
    for name, figure in figures.items():
        peer = (
            f"  {figure['peer']}: {figure['peer_value']:.4g}, ratio {figure['ratio']:.3g}"
            if figure.get("peer")
            else ""
        )
        target = f"  (target {figure['target']:g})" if figure.get("target") is not None else ""
        print(f"{name}: {figure['value']:.4g} {figure['unit']}{target}{peer}")
    write_json(
        arguments.json, (read_json(arguments.json) if arguments.json.is_file() else {}) | figures
    )


if __name__ == "__main__":
    main()
