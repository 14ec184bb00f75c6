"""Stability: a battery of scenes in which methods fail, how badly they do, and which recordings come near."""

from analysis.stress.battery import BATTERY, Scene
from analysis.stress.cells import Cell
from analysis.stress.change import Change, relative_change
from analysis.stress.diagnosis import ambiguous_windows, eigenvalue_ratio, undetermined_share
from analysis.stress.limits import MEASURES
from analysis.stress.measures import edge_error, energy_error, fault_gain, perturbation_gain, shift_change
from analysis.stress.mounting import Spread, flip_change, metric_spread, rotation_change
from analysis.stress.result import StressResult
from analysis.stress.run import stress_reducers, write_stress
from analysis.stress.signs import SIGNS, Diagnosis, diagnose

__all__ = [
    "BATTERY",
    "MEASURES",
    "SIGNS",
    "Cell",
    "Change",
    "Diagnosis",
    "Scene",
    "Spread",
    "StressResult",
    "ambiguous_windows",
    "diagnose",
    "edge_error",
    "eigenvalue_ratio",
    "energy_error",
    "fault_gain",
    "flip_change",
    "metric_spread",
    "perturbation_gain",
    "relative_change",
    "rotation_change",
    "shift_change",
    "stress_reducers",
    "undetermined_share",
    "write_stress",
]
