"""Do the match metrics predict what people feel? Tables in, associations, profiles and a report out.

Importing this package loads numpy and nothing heavier; pandas, scipy and matplotlib come with the first call.
"""

from analysis.association import Association, Difference, compare_metrics, correlate
from analysis.numbers import Number
from analysis.profile import profile_reducers
from analysis.reliability import Intraclass, intraclass, noise_ceiling
from analysis.report import write_report
from analysis.results import Results
from analysis.table import Table, read_table

__all__ = [
    "Association",
    "Difference",
    "Intraclass",
    "Number",
    "Results",
    "Table",
    "compare_metrics",
    "correlate",
    "intraclass",
    "noise_ceiling",
    "profile_reducers",
    "read_table",
    "write_report",
]
