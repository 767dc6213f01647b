"""The run that renders are imported into."""

import pytest

from ggvs_eval.run_folder import RunFolder
from helpers.render_folders import make_run


@pytest.fixture
def truth_run(tmp_path) -> RunFolder:
    """A run with captured frames and nothing rendered."""
    return make_run(tmp_path / "run")
