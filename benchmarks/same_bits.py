"""Bit-equality of results across processors: ``python -m benchmarks.same_bits``.

Libraries choose their code by the instruction sets that they find. Their own variables make them
believe in an older processor: a small demo is filmed, its depth found, rendered and scored under
each setting, and everything is compared with what this processor makes alone. A table is printed
and written to out/same_bits.json.
"""

import argparse
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from ggvs_eval.files.images import read_image
from ggvs_eval.run_folder import RunFolder, write_json

NO_AVX = "-AVX,-AVX2,-AVX512F,-FMA,-FMA4"
# By the generation of processors whose instruction sets are left; the names are those of each
# library.
SETTINGS: dict[str, dict[str, str]] = {
    "this processor": {},
    "OpenBLAS as on Skylake-X": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "OpenBLAS as on Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "OpenBLAS as on Zen": {"OPENBLAS_CORETYPE": "Zen"},
    "NumPy without AVX2": {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL"},
    "C library without AVX": {"GLIBC_TUNABLES": f"glibc.cpu.hwcaps={NO_AVX}"},
    "OpenCV without AVX2, IPP": {
        "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FMA3,AVX",
        "OPENCV_IPP": "disabled",
    },
    "oneDNN, ATen with AVX2": {"ONEDNN_MAX_CPU_ISA": "AVX2", "ATEN_CPU_CAPABILITY": "avx2"},
    "Haswell (2013)": {
        "OPENBLAS_CORETYPE": "Haswell",
        "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL",
        "OPENCV_CPU_DISABLE": "AVX512-SKX",
        "OPENCV_IPP": "avx2",
        "ONEDNN_MAX_CPU_ISA": "AVX2",
        "ATEN_CPU_CAPABILITY": "avx2",
        "MKL_ENABLE_INSTRUCTIONS": "AVX2",
        "GGVS_EVAL_SIMD": "avx2",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F",
    },
    "Nehalem (2008)": {
        "OPENBLAS_CORETYPE": "Nehalem",
        "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL",
        "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FMA3,FP16,AVX",
        "OPENCV_IPP": "sse42",
        "ONEDNN_MAX_CPU_ISA": "SSE41",
        "ATEN_CPU_CAPABILITY": "default",
        "MKL_ENABLE_INSTRUCTIONS": "SSE4_2",
        "GGVS_EVAL_SIMD": "baseline",
        "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={NO_AVX}",
        "JSIMD_FORCESSE2": "1",
    },
}
CAPTURES = {
    "dynerf": ["--cameras-per-row", "2", "--n-frames", "2", "--path-poses", "0"],
    "enerf-outdoor": [
        "--layout",
        "enerf-outdoor",
        "--rig",
        "arc",
        "--seed",
        "1",
        "--cameras-per-row",
        "2",
        "--n-frames",
        "2",
    ],
    "d3dmv": [
        "--layout",
        "d3dmv",
        "--rig",
        "grid",
        "--seed",
        "2",
        "--cameras-per-row",
        "2",
        "--n-frames",
        "2",
    ],
}
SIZE = ["--width", "128", "--height", "96"]
METHODS = ("no-blending", "distance-based", "ours-geometric", "ours", "enerf", "ibrnet")
SHORT = {
    '["cam00", "cam03", "cam07"]': '["cam00", "cam01"]',
    "count = 24": "count = 2",
    "k = 4": "k = 2",
}
KEY = ["method", "view", "metric", "frame"]


@dataclass(frozen=True)
class Difference:
    """Difference between something and its reference.

    Attributes:
        equal: of all values or files.
        total: values or files.
        largest: largest difference; nothing where bytes alone are compared.
        unit: of it.
    """

    equal: int
    total: int
    largest: float
    unit: str

    def __str__(self) -> str:
        if self.equal == self.total:
            return "same"
        most = f", by at most {self.largest:.3g} {self.unit}" if self.unit else ""
        return f"{self.total - self.equal} of {self.total} differ{most}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run every setting and print what differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out", type=Path, default=Path("out/same_bits"), help="folder of the captures and runs"
    )
    parser.add_argument(
        "--settings",
        nargs="*",
        default=list(SETTINGS),
        help="which of them; the first one is compared with",
    )
    parser.add_argument("--film-only", action="store_true", help="film, and stop there")
    chosen = parser.parse_args(arguments)
    folders = {
        name: chosen.out / name.replace(" ", "-").replace(",", "") for name in chosen.settings
    }
    for name, folder in folders.items():
        make(folder, SETTINGS[name], chosen.film_only)
    reference, *others = folders
    table = {
        name: dict(differences(folders[reference], folders[name], chosen.film_only))
        for name in others
    }
    write_json(
        chosen.out.with_suffix(".json"),
        {name: {s: vars(d) for s, d in row.items()} for name, row in table.items()},
    )
    for name, row in table.items():
        print(name, *(f"  {stage}: {difference}" for stage, difference in row.items()), sep="\n")


def make(folder: Path, setting: dict[str, str], film_only: bool) -> None:
    """Film and evaluate in processes of this setting; what is there already is left as it is."""
    for layout, options in CAPTURES.items():
        _ggvs_eval(setting, "film", folder / layout, *SIZE, *options)
    if not film_only:
        protocol = folder / "short.toml"
        protocol.write_text(_short_protocol())
        asked = ["--capture", folder / "dynerf", "--protocol", protocol]
        _ggvs_eval(setting, "run", folder / "run", *asked, "--methods", *METHODS)
        _ggvs_eval(setting, "prepare", folder / "raft", *asked, "--matcher", "raft")


def differences(reference: Path, other: Path, film_only: bool) -> Iterator[tuple[str, Difference]]:
    """Yield each stage and how far it is from the reference."""
    for layout in CAPTURES:
        yield f"film, {layout}", _bytes(reference / layout, other / layout)
    if not film_only:
        for name, run in (("depth, SGBM", "run"), ("depth, RAFT-Stereo", "raft")):
            yield name, _bytes(RunFolder(reference / run).depth, RunFolder(other / run).depth)
        for method in METHODS:
            yield (
                f"frames, {method}",
                _levels(reference / "run/renders" / method, other / "run/renders" / method),
            )
        yield "scores", _scores(reference / "run", other / "run")


def _bytes(reference: Path, other: Path) -> Difference:
    files = [
        path.relative_to(reference)
        for path in sorted(reference.rglob("*"))
        if path.is_file() and path.suffix != ".json"
    ]
    equal = sum(
        (other / file).is_file() and (reference / file).read_bytes() == (other / file).read_bytes()
        for file in files
    )
    return Difference(equal, len(files), 0.0, "")


def _levels(reference: Path, other: Path) -> Difference:
    """Of the values of all pixels of all frames, of 255 levels."""
    pairs = [
        (read_image(path), read_image(other / path.relative_to(reference)))
        for path in sorted(reference.glob("*/*.png"))
    ]
    gaps = np.concatenate([np.abs(a.astype(int) - b).ravel() for a, b in pairs])
    return Difference(int((gaps == 0).sum()), gaps.size, float(gaps.max()), "levels")


def _scores(reference: Path, other: Path) -> Difference:
    first, second = (
        pd.read_parquet(run / "results.parquet").set_index(KEY)["value"].sort_index()
        for run in (reference, other)
    )
    gaps = (first - second).abs() / first.abs().clip(lower=1e-6)
    return Difference(
        int((gaps == 0).sum() + gaps.isna().sum()), len(gaps), float(gaps.max()), "of their value"
    )


def _short_protocol() -> str:
    from importlib import resources

    text = (resources.files("ggvs_eval") / "protocols/demo.toml").read_text()
    for long, short in SHORT.items():
        text = text.replace(long, short)
    return text


def _ggvs_eval(setting: dict[str, str], *words: str | Path) -> None:
    ruled = {name for variables in SETTINGS.values() for name in variables}
    environment = {name: value for name, value in os.environ.items() if name not in ruled} | setting
    result = subprocess.run(
        [sys.executable, "-m", "ggvs_eval", *map(str, words)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode:
        raise SystemExit(
            f"{' '.join(map(str, words))} failed under {setting}:\n{result.stderr[-2000:]}"
        )


if __name__ == "__main__":
    main()
