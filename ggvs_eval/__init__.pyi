from ggvs_eval.camera import Camera as Camera
from ggvs_eval.capture import Capture as Capture
from ggvs_eval.datasets import open_capture as open_capture
from ggvs_eval.errors import GgvsError as GgvsError
from ggvs_eval.method import Instant as Instant
from ggvs_eval.method import Method as Method
from ggvs_eval.method import Rendering as Rendering
from ggvs_eval.method import SourceView as SourceView
from ggvs_eval.pipelines.play.synthesizer import OnlineSynthesizer as OnlineSynthesizer
from ggvs_eval.pipelines.run.evaluate import evaluate as evaluate
from ggvs_eval.pipelines.run.import_renders import import_renders as import_renders
from ggvs_eval.pipelines.run.score import score as score
from ggvs_eval.protocol import Protocol as Protocol
from ggvs_eval.protocol import load_protocol as load_protocol
from ggvs_eval.results import Results as Results
from ggvs_eval.run_folder import RunFolder as RunFolder

__version__: str
