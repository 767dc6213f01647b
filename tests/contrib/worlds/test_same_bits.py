"""A demo capture is the same file on every processor, whatever its libraries find in it."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import ggvs_eval.contrib
from ggvs_eval.files import video
from helpers import tiny_films

# Each library is made to believe in the instruction sets of an older processor, by variables of its
# own.
PROCESSORS = {
    "this one": {},
    "Nehalem": {
        "OPENBLAS_CORETYPE": "Nehalem",
        "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL",
        "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FMA3,FP16,AVX",
        "OPENCV_IPP": "sse42",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX,-AVX2,-AVX512F,-FMA,-FMA4",
        "JSIMD_FORCESSE2": "1",
    },
}
# SHA-256 of what is filmed before an encoder sees it. Whoever changes what demo captures show
# writes the new ones here.
GOLDEN = {
    "dynerf, pictures": "04e28b99372effb16ee8edfbd72c2d07e352837911103b279f17d8eaf7804c36",
    "enerf-outdoor, pictures": "4c0cb783aa7730dc2fe726d885789760b4131995639ce12f87044583511e57ac",
    "d3dmv, pictures": "a580a93c1472880933b859497405a20d93e77de59971602a5fd345ce20f26774",
}
# What chooses its code by the processor: products by BLAS, and elementary functions.
FORBIDDEN = {
    "linalg",
    "dot",
    "matmul",
    "inner",
    "tensordot",
    "sin",
    "cos",
    "tan",
    "arctan",
    "arctan2",
    "arcsin",
    "arccos",
    "hypot",
}
FORBIDDEN |= {
    "exp",
    "exp2",
    "expm1",
    "log",
    "log2",
    "log10",
    "log1p",
    "power",
    "float_power",
    "cbrt",
    "sinh",
    "cosh",
    "tanh",
}


def filmed_modules():
    root = Path(ggvs_eval.contrib.__file__).parent
    filming = (
        path
        for room in ("room", "film", "layouts")
        for path in (root / "worlds" / room).glob("*.py")
    )
    return [*sorted(filming), root / "training" / "stereo_pairs.py"]


@pytest.mark.parametrize(
    "module", filmed_modules(), ids=lambda path: f"{path.parent.name}/{path.stem}"
)
def test_what_is_filmed_asks_no_library_for_products_or_functions(module):
    """Products and elementary functions come from `portable`; a matrix product by @, or a function
    of NumPy, would be another.
    """
    tree = ast.parse(module.read_text())
    products = [
        node.lineno
        for node in ast.walk(tree)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult)
    ]
    functions = [
        node.lineno
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and node.attr in FORBIDDEN
        and getattr(node.value, "id", "") in ("np", "math")
    ]
    assert (products, functions) == ([], [])


@pytest.mark.proof
def test_films_have_the_same_bits_on_every_processor(tmp_path):
    """Three layouts have the golden pictures, depth and cameras, and equal files, under the
    settings of other processors too.
    """
    ruled = {name for setting in PROCESSORS.values() for name in setting}
    others = {name: value for name, value in os.environ.items() if name not in ruled}
    films = []
    for number, setting in enumerate(PROCESSORS.values()):
        command = [sys.executable, tiny_films.__file__, str(tmp_path / str(number))]
        films.append(
            json.loads(
                subprocess.run(
                    command, env=others | setting, capture_output=True, check=True
                ).stdout
            )
        )

    assert films == films[:1] * len(PROCESSORS)
    assert {name: films[0][name] for name in GOLDEN} == GOLDEN


def test_videos_have_the_same_bytes_with_and_without_assembly(tmp_path, monkeypatch):
    """x264's plain code writes what its assembly writes."""
    rng = np.random.default_rng(0)
    images = [rng.integers(60, 190, (48, 64, 3)).astype(np.uint8) for _ in range(4)]
    images = [
        np.asarray(cv2.GaussianBlur(image, (0, 0), 2), np.uint8)
        for image in images
        for _ in range(3)
    ]
    video.write_video(tmp_path / "usual.mp4", images, 30.0)
    monkeypatch.setattr(video, "X264", f"{video.X264}:asm=0")
    video.write_video(tmp_path / "plain.mp4", images, 30.0)

    assert (tmp_path / "plain.mp4").read_bytes() == (tmp_path / "usual.mp4").read_bytes()
