"""An archive is unpacked as far as the disk has room."""

import zipfile
from types import SimpleNamespace

import pytest

from ggvs_eval.errors import RenderError
from ggvs_eval.files import archive
from ggvs_eval.files.archive import Limits, unpack


@pytest.mark.parametrize(
    ("allowed", "free", "fits"), [(3000, 3000, True), (3000, 1500, False), (1500, 3000, False)]
)
def test_neither_the_limit_nor_the_disk_is_exceeded(tmp_path, monkeypatch, allowed, free, fits):
    """Two files of 1,000 bytes fit into 3,000, allowed and free; with 1,500 of either the archive
    is refused.
    """
    with zipfile.ZipFile(tmp_path / "renders.zip", "w") as packed:
        for name in ("a", "b"):
            packed.writestr(f"cam00/{name}.txt", b"x" * 1000)
    monkeypatch.setattr(archive.shutil, "disk_usage", lambda _folder: SimpleNamespace(free=free))

    def unpacked():
        return unpack(tmp_path / "renders.zip", tmp_path / "out", Limits(9, allowed), RenderError)

    if fits:
        assert unpacked() == tmp_path / "out" / "cam00"
    else:
        with pytest.raises(RenderError, match=r"renders\.zip"):
            unpacked()
