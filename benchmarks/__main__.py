"""``make bench``: every benchmark of this folder, printed and written to out/bench.json."""

from pathlib import Path

from benchmarks import (
    bench_baselines,
    bench_decoding,
    bench_depth,
    bench_fit,
    bench_full_reference,
    bench_gaussians,
    bench_geometry,
    bench_metrics,
    bench_no_reference,
    bench_online,
    bench_page,
    bench_roofline,
)
from ggvs_eval.run_folder import write_json


def main() -> None:
    """Measure everything; one line per figure."""
    figures = (
        bench_geometry.measure()
        | bench_gaussians.measure()
        | bench_fit.measure()
        | bench_online.measure()
        | bench_roofline.measure()
        | bench_metrics.measure()
        | bench_full_reference.measure()
        | bench_no_reference.measure()
        | bench_decoding.measure()
        | bench_depth.measure()
        | bench_page.measure()
        | bench_baselines.measure()
    )
    for name, figure in figures.items():
        peer = f"  {figure['peer']}: {figure['peer_value']:.4g}, ratio {figure['ratio']:.3g}" if figure.get("peer") else ""
        target = f"  (target {figure['target']:g})" if figure.get("target") is not None else ""
        print(f"{name}: {figure['value']:.4g} {figure['unit']}{target}{peer}")
    write_json(Path("out/bench.json"), figures)


if __name__ == "__main__":
    main()
