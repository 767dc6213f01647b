"""The one thing setup.cfg cannot say: the compiled kernels."""

import hashlib
import os
import re
import shutil
from pathlib import Path
from typing import Any

KERNELS = Path("ggvs_eval/kernels")
SOURCES = (
    *(
        "core",
        "splat",
        "tsdf",
        "occupancy",
        "warp",
        "dispatch",
        "level_baseline",
        "level_avx2",
        "level_avx512",
    ),
    *("images", "filter", "blend", "push_pull", "remember", "recur", "contested", "shade"),
    *("register", "compose", "outputs", "refine", "learned"),
    *(
        "convolve",
        "unet",
        "unet_bindings",
        "memory",
        "overview",
        "network_inputs",
        "ray_pooling",
        "ray_pooling_bindings",
    ),
)
GAUSSIANS = (
    *(
        "gaussian_bindings",
        "gaussian_splat",
        "gaussian_levels",
        "gaussian_baseline",
        "gaussian_avx2",
        "gaussian_avx512",
    ),
    "memory",
)
DEFORMATION = (
    *(
        "deformation_bindings",
        "deformation",
        "deformation_baseline",
        "deformation_avx2",
        "deformation_avx512",
    ),
    "memory",
)
STEREO = (
    *("stereo", "plane_sweep", "sgm", "block_match", "subpixel", "weighted_median", "edge_enlarge"),
    *("stereo_levels", "stereo_baseline", "stereo_avx2", "stereo_avx512"),
)
FEATURES = (
    "feature_bindings",
    "feature_maps",
    "feature_levels",
    "feature_baseline",
    "feature_avx2",
    "feature_avx512",
    "memory",
)

# No -march: the instruction set is chosen when the program runs (dispatch.cpp), so that one wheel
# serves every machine. No contraction to fused multiply-adds: then every instruction set gives the
# same bits.
FLAGS = ("-O3", "-ffp-contract=off", "-fno-math-errno", "-Wall", "-Wextra", "-pthread")


EXTENSIONS = {
    "_core": SOURCES,
    "_ssim": ("ssim",),
    "_iv_psnr": ("iv_psnr",),
    "_stereo": STEREO,
    "_features": FEATURES,
    "_film": ("film", "ray_tree"),
    "_gaussians": GAUSSIANS,
    "_deformation": DEFORMATION,
}
INCLUDED = re.compile(r'^#include "(.+)"$', re.MULTILINE)


def sources_of(name: str) -> list[Path]:
    """The sources of an extension module and every header that they include, sorted."""
    found: set[Path] = set()
    waiting = [KERNELS / f"{source}.cpp" for source in EXTENSIONS[name]]
    while waiting:
        file = waiting.pop()
        if file not in found:
            found.add(file)
            waiting += [
                KERNELS / header for header in INCLUDED.findall(file.read_text(encoding="utf-8"))
            ]
    return sorted(found)


def digest_sources(name: str) -> str:
    """SHA-256 of all that determines the results of an extension module, whatever compiles it."""
    texts = [f"{file.name}\0{file.read_text(encoding='utf-8')}" for file in sources_of(name)]
    return hashlib.sha256("\0".join([*FLAGS, *texts]).encode()).hexdigest()


def extension(name: str) -> Any:
    """One extension module, which carries the hash of its sources and is rebuilt when one of them
    changes.
    """
    from pybind11.setup_helpers import Pybind11Extension

    return Pybind11Extension(
        f"ggvs_eval.kernels.{name}",
        [str(KERNELS / f"{source}.cpp") for source in EXTENSIONS[name]],
        depends=[str(file) for file in sources_of(name)],
        define_macros=[("GGVS_EVAL_SOURCES", f'"{digest_sources(name)}"')],
        cxx_std=17,
        extra_compile_args=list(FLAGS),
        extra_link_args=["-pthread"],
    )


def main() -> None:
    """Hand the extension modules to setuptools."""
    from pybind11.setup_helpers import ParallelCompile
    from setuptools import setup
    from setuptools.command.build_ext import build_ext

    class BuildKernels(build_ext):
        """Compiles a module, unless one of the same sources lies in the folder GGVS_EVAL_BUILT: the
        wheel test waits for none.
        """

        def build_extension(self, ext: Any) -> None:
            """See `build_ext`."""
            target = Path(self.get_ext_fullpath(ext.name))
            built = Path(os.environ.get("GGVS_EVAL_BUILT", "")) / target.name
            digest = dict(ext.define_macros)["GGVS_EVAL_SOURCES"].strip('"')
            if built.is_file() and digest.encode() in built.read_bytes():
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(built, target)
            else:
                super().build_extension(ext)

    ParallelCompile("GGVS_EVAL_BUILD_JOBS").install()
    setup(
        ext_modules=[extension(name) for name in EXTENSIONS], cmdclass={"build_ext": BuildKernels}
    )


if __name__ == "__main__":  # tests read the sources of the modules without building them
    main()
