"""Sessions: plans, journals, the engine that presents trials, and the command line.

Imports nothing heavy. The steps of a whole study are in `study.workflow`, its settings in `study.settings`.
"""

from study.folder import StudyFolder, create_study, require_study
from study.journal import Journal, create_journal, read_journal, require_journal
from study.plan import Plan, create_plan, make_plan, require_plan
from study.ports import Answer, Playback, Presenter, Replay
from study.ratings import write_ratings
from study.session import Stage, open_session, run_session

__all__ = [
    "Answer",
    "Journal",
    "Plan",
    "Playback",
    "Presenter",
    "Replay",
    "Stage",
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
