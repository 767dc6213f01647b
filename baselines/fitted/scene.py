"""Scenes as fits leave them on disk: Gaussians and their motion in one safetensors file."""

import json
from collections.abc import Mapping
from pathlib import Path
from time import perf_counter
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save
from torch import Tensor

from ggvs_eval.baselines.fitted.hexplane import DeformationNetwork, FieldConfiguration
from ggvs_eval.baselines.fitted.motion import ExplicitMotion, HexPlaneMotion, Motion, NoMotion, Static
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import compute_device, rendering_on
from ggvs_eval.errors import WeightsError
from ggvs_eval.files.atomic import write_bytes
from ggvs_eval.files.weights_file import load_strict
from ggvs_eval.gaussians.cloud import GaussianCloud
from ggvs_eval.gaussians.render import render_gaussians
from ggvs_eval.method import Rendering
from ggvs_eval.scene_fitter import FittedScene, Footage
