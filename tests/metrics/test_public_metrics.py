"""`ggvs_eval.metrics` as a library: names that cost nothing until they are used, each with an
example that runs.
"""

import doctest
import inspect
import subprocess
import sys

import pytest

from ggvs_eval import metrics

FUNCTIONS = [name for name in metrics.__all__ if inspect.isfunction(getattr(metrics, name))]
PUBLIC = {name: getattr(metrics, name) for name in metrics.__all__}
NEEDS_FILES = {"lpips", "dists", "flip"}  # weights, or a package of an extra


@pytest.mark.parametrize("name", FUNCTIONS)
def test_examples_say_what_comes_out(name):
    """Each public function has an example that needs public names alone, and its numbers
    are right.
    """
    (example,) = doctest.DocTestFinder(recurse=False).find(PUBLIC[name], name, globs=dict(PUBLIC))
    result = doctest.DocTestRunner().run(example)
    assert example.examples
    assert result.failed == 0
    assert name in NEEDS_FILES or not any(doctest.SKIP in one.options for one in example.examples)


def test_names_are_imported_when_they_are_used():
    """Importing the package loads neither OpenCV nor torch, a metric of images no torch; `dir` and
    errors know the names.
    """
    code = (
        "import sys; from ggvs_eval import metrics; before = sorted({'cv2', 'torch', 'pandas'} & "
        "set(sys.modules));from ggvs_eval.metrics import lpips, psnr, ssim, strred, "
        "METRICS;print(before, 'torch' in sys.modules, set(metrics.__all__) <= set(dir(metrics)))"
    )
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert out.strip() == "[] False True"
    with pytest.raises(AttributeError, match="no attribute 'psnt'"):
        metrics.psnt  # noqa: B018
