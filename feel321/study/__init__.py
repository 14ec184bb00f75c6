"""Studies: settings, stimuli, sessions and reports in one folder, and the ports for a lab's own presenter.

Imports nothing heavy: what a step needs is imported when it is called.
"""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from feel321.doors import forward_old_names as _forward_old_names
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

_old_names = {
    "Design": "feel321.study.session.plan:Design",
    "Place": "feel321.study.session.ports:Place",
    "Stage": "feel321.study.session.engine:Setup",
    "Stale": "feel321.study.session.plan:Stale",
    "StudyFolder": "feel321.study.folder:StudyFolder|Study.open(path).folder",
    "create_journal": "feel321.study.session.journal:create_journal",
    "create_plan": "feel321.study.session.plan:create_plan",
    "create_study": "feel321.study.folder:create_study|Study.create(path)",
    "make_plan": "feel321.study.session.plan:make_plan",
    "open_session": "feel321.study.session.plan:open_session",
    "read_journal": "feel321.study.session.journal:read_journal|Study.journal(participant)",
    "require_journal": "feel321.study.session.journal:require_journal",
    "require_plan": "feel321.study.session.plan:require_plan|Study.plan(participant)",
    "require_study": "feel321.study.folder:require_study|Study.open(path)",
    "write_ratings": "feel321.study.ratings:write_ratings|Study.ratings()",
}


def __dir__() -> list[str]:
    return sorted(__all__)


__getattr__ = _forward_old_names(
    __name__, _old_names, lazy={"Settings": "feel321.study.settings.schema:Settings"}
)
