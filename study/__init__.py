"""Sessions: plans, journals, the engine that presents trials, and the command line.

Imports nothing heavy. The steps of a whole study are in `study.workflow`, its settings in `study.settings`.
"""

from study.conduct import Stage
from study.folder import StudyFolder, create_study, require_study
from study.journal import Journal, create_journal, read_journal, require_journal
from study.opening import Stale, open_session
from study.plan import Design, Plan, create_plan, make_plan, require_plan
from study.ports import Abort, Confirm, Feel, Move, Pause, Place, Playback, Presenter
from study.ratings import write_ratings
from study.session import Outcome, run_session

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
