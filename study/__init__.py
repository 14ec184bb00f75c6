"""Sessions: plans, journals, the engine that presents trials, and the command line.

Imports nothing heavy. The steps of a whole study are in `study.workflow`, its settings in `study.settings.reading`.
"""

from study.folder import StudyFolder, create_study, require_study
from study.ratings import write_ratings
from study.session.conduct import Stage
from study.session.engine import Outcome, run_session
from study.session.journal import Journal, create_journal, read_journal, require_journal
from study.session.opening import Stale, open_session
from study.session.plan import Design, Plan, create_plan, make_plan, require_plan
from study.session.ports import Abort, Confirm, Feel, Move, Pause, Place, Playback, Presenter

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
