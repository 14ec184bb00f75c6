"""The least sufficient reducer of every scene.

A scene is a recording, or a segment of one, and the context in which it is to be felt. Reducers go by simplicity
(`simplicity`), are measured (`measures`, `axes`), compared with the best (`verdict`, by `tolerance`) and, where people
rated them, by their ratings (`rated`); the first that is equivalent to the best is the answer (`choice`, `wording`).
`report` writes table, figure (`drawing`) and page.
"""

from analysis.advise.choice import Advice, advise_scene
from analysis.advise.report import Study, advise_recordings, write_advice
from analysis.advise.scene import Context, Scene, split_recording
from analysis.advise.tolerance import Tolerance
from analysis.advise.verdict import Rated, Verdict

__all__ = [
    "Advice",
    "Context",
    "Rated",
    "Scene",
    "Study",
    "Tolerance",
    "Verdict",
    "advise_recordings",
    "advise_scene",
    "split_recording",
    "write_advice",
]
