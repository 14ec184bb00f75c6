"""Records that functions of feel321 return: for annotations in a lab's own code; all have `to_frame` and `summary`."""

from feel321.analysis.agreement.alpha import Alpha
from feel321.analysis.agreement.reliability import Intraclass
from feel321.analysis.association.correlate import Association, Difference
from feel321.analysis.association.dependent import Dependent
from feel321.analysis.association.repeated import RepeatedMeasures
from feel321.analysis.contrasts.bradley_terry import BradleyTerry
from feel321.analysis.contrasts.compare import ReducerDifference
from feel321.analysis.contrasts.discrimination import Discrimination
from feel321.analysis.contrasts.equivalence import Equivalence, NonInferiority
from feel321.analysis.mixed.model import Estimate, MixedFit
from feel321.analysis.p1401.difference import P1401Difference
from feel321.analysis.p1401.mapping import P1401
from feel321.analysis.primary.model import Primaries, Primary
from feel321.analysis.primary.multiverse import Multiverse
from feel321.analysis.refined.refine import Refined
from feel321.analysis.report.results import Results
from feel321.analysis.screening.screen import Screening
from feel321.analysis.space import Alignment, Ellipses, Space
from feel321.analysis.table.items import Table
from feel321.analysis.table.reading import Further
from feel321.analysis.tradeoff.advise.page import Advice
from feel321.analysis.tradeoff.chart.compute import Chart
from feel321.analysis.tradeoff.stress.run import Stress

__all__ = [  # noqa: RUF022 - in the order of sorted(), which a test checks
    "Advice", "Alignment", "Alpha", "Association", "BradleyTerry", "Chart", "Dependent", "Difference",
    "Discrimination", "Ellipses", "Equivalence", "Estimate", "Further", "Intraclass", "MixedFit", "Multiverse",
    "NonInferiority", "P1401", "P1401Difference", "Primaries", "Primary", "ReducerDifference", "Refined",
    "RepeatedMeasures", "Results", "Screening", "Space", "Stress", "Table",
]  # fmt: skip
