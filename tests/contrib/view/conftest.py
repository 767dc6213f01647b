"""What the tests of the viewer look at."""

import pytest

from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.pipelines.play.playback import PlayOptions, playback_of_capture
from helpers.stereo_scenes import write_capture


@pytest.fixture(scope="session")
def playback(tmp_path_factory):
    """Five cameras before a plane that comes nearer, three instants, with depth of every camera at
    every instant.
    """
    folder = tmp_path_factory.mktemp("plane")
    options = PlayOptions(k=2)
    return playback_of_capture(
        write_capture(folder),
        options,
        DepthRunOptions("sgbm").options(),
        folder / "cache",
        anywhere=True,
    )
