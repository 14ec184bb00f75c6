"""Recordings in, stimuli out: readers, conditioning, reducers, metrics and stimulus sets.

Samples flow one way: `read_recording` or `make_scene` -> `condition` -> `reduce` -> `match` -> `build_stimuli`.
"""

from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.match import (
    SpectralMatch,
    TemporalMatch,
    spectral_match,
    spectral_match_bounded,
    spectral_match_details,
    temporal_match,
    temporal_match_details,
    temporal_match_windowed,
)
from feel321.stimuli.metrics import METRICS, match
from feel321.stimuli.recording import Recording, Reduced
from feel321.stimuli.reducers.registry import REDUCERS, StreamingReducer, reduce, reduce_many
from feel321.stimuli.rotation import INVARIANTS, rotation_statistics
from feel321.stimuli.sets.build import build_stimuli
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet, check_stimuli, read_stimuli
from feel321.stimuli.sets.recipe import ANCHORS, LEVELS, Recipe
from feel321.stimuli.spectra import Spectrogram, Spectrum, psd, spectrogram
from feel321.stimuli.synthesis import SCENES, make_scene
from feel321.stimuli.thresholds import (
    THRESHOLDS,
    acceleration_threshold,
    felt_level,
    sensation_level_db,
)
from feel321.stimuli.wav import read_wav, write_wav
from feel321.types import METRIC_INFO

__all__ = [
    "ANCHORS",
    "INVARIANTS",
    "LEVELS",
    "METRICS",
    "METRIC_INFO",
    "REDUCERS",
    "SCENES",
    "THRESHOLDS",
    "Conditioning",
    "Recipe",
    "Recording",
    "Reduced",
    "SpectralMatch",
    "Spectrogram",
    "Spectrum",
    "Stimulus",
    "StimulusSet",
    "StreamingReducer",
    "TemporalMatch",
    "acceleration_threshold",
    "build_stimuli",
    "check_stimuli",
    "condition",
    "felt_level",
    "make_scene",
    "match",
    "psd",
    "read_recording",
    "read_stimuli",
    "read_wav",
    "reduce",
    "reduce_many",
    "rotation_statistics",
    "sensation_level_db",
    "spectral_match",
    "spectral_match_bounded",
    "spectral_match_details",
    "spectrogram",
    "temporal_match",
    "temporal_match_details",
    "temporal_match_windowed",
    "write_wav",
]


def __dir__() -> list[str]:
    return __all__
