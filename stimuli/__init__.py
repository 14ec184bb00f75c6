"""Recordings in, stimuli out: readers, conditioning, reducers, metrics and stimulus sets.

Samples flow one way: `read_recording` or `make_scene` -> `condition` -> `REDUCERS` -> `METRICS` -> `build_stimuli`.
"""

from stimuli.anchors import ANCHORS
from stimuli.condition import Conditioning, condition, fade, resample
from stimuli.conform import check_dft321, golden_vectors
from stimuli.formats import read_recording
from stimuli.inspection import check_stimuli
from stimuli.invariant import (
    INVARIANTS,
    spectral_match_energy_weighted,
    spectral_match_invariant,
    temporal_match_invariant,
)
from stimuli.manifest import Stimulus, StimulusSet, read_stimuli
from stimuli.match import (
    METRICS,
    spectral_match,
    spectral_match_bounded,
    spectral_match_details,
    temporal_match,
    temporal_match_details,
)
from stimuli.perception import THRESHOLDS, acceleration_threshold, felt_level, sensation_level_db
from stimuli.recipe import LEVELS, Recipe
from stimuli.recording import UNITS, Recording
from stimuli.reduce import REDUCERS
from stimuli.rotation import RotationStatistics, rotation_statistics
from stimuli.sets import build_stimuli
from stimuli.stream import StreamingReducer
from stimuli.synthesis import SCENES, make_scene
from stimuli.version import __version__
from stimuli.wav import read_wav, write_wav

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
