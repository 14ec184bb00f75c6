"""Studies: settings, stimuli, sessions and reports in one folder, and the ports for a lab's own presenter.

Imports nothing heavy: what a step needs is imported when it is called.
"""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from feel321.doors import import_lazily as _import_lazily
from feel321.study.session.engine import Outcome, run_session
from feel321.study.session.journal import Journal
from feel321.study.session.plan import Plan
from feel321.study.session.ports import (
    Abort,
    Confirm,
    Feel,
    Move,
    Pause,
    Playback,
    Presenter,
    Scaled,
    TimedOut,
    Tone,
)
from feel321.study.study import Study

if _TYPE_CHECKING:
    from feel321.study.settings.schema import Settings

__all__ = [
    "Abort",
    "Confirm",
    "Feel",
    "Journal",
    "Move",
    "Outcome",
    "Pause",
    "Plan",
    "Playback",
    "Presenter",
    "Scaled",
    "Settings",
    "Study",
    "TimedOut",
    "Tone",
    "run_session",
]


def __dir__() -> list[str]:
    return sorted(__all__)


__getattr__ = _import_lazily(__name__, {"Settings": "feel321.study.settings.schema:Settings"})
