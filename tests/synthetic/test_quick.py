"""The demo of a first evaluation: its renders are those of a run, once as they are and once a frame
late.
"""

import numpy as np
import pytest

from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.protocol import load_protocol
from ggvs_eval.run_folder import frame_path
from ggvs_eval.synthetic import shipped
from helpers.packing import pack_renders


@pytest.mark.slow
def test_renders_of_a_run_are_packed_and_come_back(tmp_path, monkeypatch):
    """What a run rendered is what ``fixed`` shows at its number and ``late`` one frame later,
    within the video's coding.
    """
    monkeypatch.setattr(shipped, "RENDERS", tmp_path / "shipped")
    (tmp_path / "shipped").mkdir()
    protocol = shipped.quick_protocol()
    for index, view in enumerate(protocol.views.test):
        for frame in range(protocol.frames.numbers.stop):
            grey = np.full((48, 64, 3), 20 * frame + 10 * index + 20, np.uint8)
            write_image(frame_path(tmp_path / "ours" / view, frame), grey)
    pack_renders(tmp_path / "ours")
    folder = shipped.write_quick(tmp_path / "quick")

    assert load_protocol(folder / shipped.PROTOCOL) == protocol
    for index, view in enumerate(protocol.views.test):
        for frame in protocol.frames.numbers:
            for kind, shown in ((shipped.FIXED, frame), (shipped.LATE, frame - 1)):
                level = read_image(frame_path(folder / kind / view, frame)).mean()
                assert abs(level - (20 * shown + 10 * index + 20)) < 3
