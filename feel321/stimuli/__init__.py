"""Recordings in, stimuli out: readers, conditioning, reducers, metrics and stimulus sets.

Samples flow one way: `read_recording` or `make_scene` -> `condition` -> `REDUCERS` -> `METRICS` -> `build_stimuli`.
"""

from feel321.stimuli.condition import Conditioning, condition, fade, resample
from feel321.stimuli.conform import check_dft321, golden_vectors
from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.match import (
    METRICS,
    spectral_match,
    spectral_match_bounded,
    spectral_match_details,
    temporal_match,
    temporal_match_details,
)
from feel321.stimuli.recording import UNITS, Recording
from feel321.stimuli.reducers.registry import REDUCERS, StreamingReducer
from feel321.stimuli.rotation import (
    INVARIANTS,
    RotationStatistics,
    rotation_statistics,
    spectral_match_energy_weighted,
    spectral_match_invariant,
    temporal_match_invariant,
)
from feel321.stimuli.sets.anchors import (
    ANCHORS,
    THRESHOLDS,
    acceleration_threshold,
    felt_level,
    sensation_level_db,
)
from feel321.stimuli.sets.build import build_stimuli
from feel321.stimuli.sets.inspection import check_stimuli
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet, read_stimuli
from feel321.stimuli.sets.recipe import LEVELS, Recipe
from feel321.stimuli.synthesis import SCENES, make_scene
from feel321.stimuli.version import __version__
from feel321.stimuli.wav import read_wav, write_wav

__all__ = [
    "ANCHORS",
    "INVARIANTS",
    "LEVELS",
    "METRICS",
    "REDUCERS",
    "SCENES",
    "THRESHOLDS",
    "UNITS",
    "Conditioning",
    "Recipe",
    "Recording",
    "RotationStatistics",
    "Stimulus",
    "StimulusSet",
    "StreamingReducer",
    "__version__",
    "acceleration_threshold",
    "build_stimuli",
    "check_dft321",
    "check_stimuli",
    "condition",
    "fade",
    "felt_level",
    "golden_vectors",
    "make_scene",
    "read_recording",
    "read_stimuli",
    "read_wav",
    "resample",
    "rotation_statistics",
    "sensation_level_db",
    "spectral_match",
    "spectral_match_bounded",
    "spectral_match_details",
    "spectral_match_energy_weighted",
    "spectral_match_invariant",
    "temporal_match",
    "temporal_match_details",
    "temporal_match_invariant",
    "write_wav",
]
