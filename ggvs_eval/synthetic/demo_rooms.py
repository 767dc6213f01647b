"""The demo captures: the main one, and two smaller rooms rendered by rigs like those of the other data sets, in their layouts."""

from dataclasses import replace

from ggvs_eval.synthetic.film.options import DemoOptions

MAIN = "demo"
SMALL = DemoOptions(width=384, height=216, n_frames=8, path_poses=0, depth_stride=0)
# Name of the packaged protocol -> what is rendered. ENeRF-Outdoor: 18 cameras on an arc; D3DMV: 10 in two rows of five.
DEMO_ROOMS: dict[str, DemoOptions] = {
    MAIN: DemoOptions(),
    "demo-enerf-outdoor": replace(SMALL, layout="enerf-outdoor", seed=1, cameras_per_row=9, rig="arc"),
    "demo-d3dmv": replace(SMALL, layout="d3dmv", seed=2, cameras_per_row=5, rig="grid"),
}
