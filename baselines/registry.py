"""The learned baselines by name: each is a folder that describes itself, and a line of
`ggvs_eval.built_in`.
"""

from ggvs_eval import built_in
from ggvs_eval.baselines.learned import LearnedBaseline
from ggvs_eval.plugins import Registry

LEARNED_BASELINES: Registry[LearnedBaseline] = Registry(
    "learned baselines", built_in.LEARNED_BASELINES
)
