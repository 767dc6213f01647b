"""The one thing setup.cfg cannot say: the compiled kernels."""

from pathlib import Path

from pybind11.setup_helpers import ParallelCompile, Pybind11Extension
from setuptools import setup

KERNELS = Path("ggvs_eval/kernels")
SOURCES = (
    *("core", "splat", "tsdf", "occupancy", "warp", "dispatch", "level_baseline", "level_avx2", "level_avx512"),
    *("images", "filter", "blend", "push_pull", "register", "compose", "refine", "learned", "unet", "unet_bindings"),
    *("memory", "overview", "network_inputs", "ray_pooling", "ray_pooling_bindings"),
)
STEREO = ("stereo", "plane_sweep", "sgm", "weighted_median", "stereo_levels", "stereo_baseline", "stereo_avx2", "stereo_avx512")

# No -march: the instruction set is chosen when the program runs (dispatch.cpp), so that one wheel serves every machine.
# No contraction to fused multiply-adds: then every instruction set gives the same bits.
FLAGS = ["-O3", "-ffp-contract=off", "-fno-math-errno", "-Wall", "-Wextra", "-pthread"]


def extension(name: str, sources: tuple[str, ...]) -> Pybind11Extension:
    """One extension module, rebuilt when any header beside it changes."""
    return Pybind11Extension(
        f"ggvs_eval.kernels.{name}",
        [str(KERNELS / f"{source}.cpp") for source in sources],
        depends=sorted(str(header) for header in KERNELS.glob("*.hpp")),
        cxx_std=17,
        extra_compile_args=FLAGS,
        extra_link_args=["-pthread"],
    )


ParallelCompile("GGVS_EVAL_BUILD_JOBS").install()
setup(ext_modules=[extension("_core", SOURCES), extension("_ssim", ("ssim",)), extension("_stereo", STEREO)])
