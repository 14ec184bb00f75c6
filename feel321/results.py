"""Records that functions of feel321 take and return: for annotations in a lab's own code.

Results have `to_frame` and `summary`; the other records are those that signals, pages and sessions are made of.
"""

from feel321.analysis.mixed.model import MixedFit
from feel321.analysis.primary.model import Primaries, Primary
from feel321.analysis.replication import Paper
from feel321.analysis.report.standing import About, Hypothesis, Standing
from feel321.analysis.report.write import Results
from feel321.analysis.table.items import Table
from feel321.analysis.table.reading import Further
from feel321.analysis.tradeoff.judge import Context
from feel321.analysis.tradeoff.page import Tradeoff
from feel321.protocols.trial import Trials
from feel321.records import PaperClaim, Statistic
from feel321.stimuli.recording import Signal
from feel321.study.folder import Audit, Problems, Seal
from feel321.study.power import StudyPower
from feel321.study.status import Status

__all__ = [
    "About", "Audit", "Context", "Further", "Hypothesis", "MixedFit", "Paper", "PaperClaim", "Primaries",
    "Primary", "Problems", "Results", "Seal", "Signal", "Standing", "Statistic", "Status", "StudyPower", "Table",
    "Tradeoff", "Trials",
]  # fmt: skip
