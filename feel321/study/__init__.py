"""Sessions: plans, journals, the engine that presents trials, and the command line.

Imports nothing heavy. The steps of a whole study are in `feel321.study.workflow`, its settings in
`feel321.study.settings.read`.
"""

from feel321.study.folder import StudyFolder, create_study, require_study
from feel321.study.ratings import write_ratings
from feel321.study.session.engine import Outcome, Stage, run_session
from feel321.study.session.journal import Journal, create_journal, read_journal, require_journal
from feel321.study.session.opening import Stale, open_session
from feel321.study.session.plan import Design, Plan, create_plan, make_plan, require_plan
from feel321.study.session.ports import (
    Abort,
    Confirm,
    Feel,
    Move,
    Pause,
    Place,
    Playback,
    Presenter,
)

__all__ = [
    "Abort",
    "Confirm",
    "Design",
    "Feel",
    "Journal",
    "Move",
    "Outcome",
    "Pause",
    "Place",
    "Plan",
    "Playback",
    "Presenter",
    "Stage",
    "Stale",
    "StudyFolder",
    "create_journal",
    "create_plan",
    "create_study",
    "make_plan",
    "open_session",
    "read_journal",
    "require_journal",
    "require_plan",
    "require_study",
    "run_session",
    "write_ratings",
]
