"""Do the match metrics predict what people feel? Tables in, associations, models, profiles and a report out.

Importing this package loads numpy and nothing heavier; pandas, scipy and matplotlib come with the first call.
"""

from analysis.advise.report import advise_recordings, write_advice
from analysis.advise.scene import Context
from analysis.advise.tolerance import Tolerance
from analysis.agreement import Alpha, bootstrap_alpha, krippendorff_alpha
from analysis.association import Association, Difference, compare_metrics, correlate
from analysis.bradley_terry import BradleyTerry, bradley_terry, bradley_terry_by_rater
from analysis.chart.compute import compute_chart
from analysis.chart.write import write_chart
from analysis.dependent import Dependent, compare_dependent
from analysis.discrimination import Discrimination, abx_d_prime, discriminate, discriminate_pairs
from analysis.equivalence import Equivalence, NonInferiority, equivalence, non_inferiority
from analysis.further import Further
from analysis.landmarks import Alignment, Ellipses, align_spaces, bootstrap_space, regress_attributes
from analysis.mixed.inference import Estimate
from analysis.mixed.model import MixedFit, contrast, fit_mixed
from analysis.multiverse import Multiverse, run_multiverse
from analysis.numbers import Number
from analysis.p1401 import P1401, p1401
from analysis.p1401_difference import P1401Difference, compare_p1401
from analysis.precision import Precision
from analysis.primary import Primary, fit_attributes, fit_primary, tabulate_slopes
from analysis.profile import profile_reducers
from analysis.refined.refine import Refined, refine_metric
from analysis.reliability import Intraclass, intraclass, noise_ceiling
from analysis.repeated import RepeatedMeasures, repeated_measures_correlation
from analysis.report import compute_sections, write_report
from analysis.results import Results
from analysis.screening import RULES, Screening, multimodality, screen_raters, tukey_fences
from analysis.sections.choices import Choices
from analysis.sections.section import Section
from analysis.sensitivity import vary_primary
from analysis.sources import find_sources
from analysis.space import Space, fit_space, stress_by_dimension
from analysis.stress.run import stress_reducers, write_stress
from analysis.table import Table, read_table

__all__ = [  # noqa: RUF022 - in the order of sorted(), which a test checks
    "Alignment",
    "Alpha",
    "Association",
    "BradleyTerry",
    "Choices",
    "Context",
    "Dependent",
    "Difference",
    "Discrimination",
    "Ellipses",
    "Equivalence",
    "Estimate",
    "Further",
    "Intraclass",
    "MixedFit",
    "Multiverse",
    "NonInferiority",
    "Number",
    "P1401",
    "P1401Difference",
    "Precision",
    "Primary",
    "RULES",
    "Refined",
    "RepeatedMeasures",
    "Results",
    "Screening",
    "Section",
    "Space",
    "Table",
    "Tolerance",
    "abx_d_prime",
    "advise_recordings",
    "align_spaces",
    "bootstrap_alpha",
    "bootstrap_space",
    "bradley_terry",
    "bradley_terry_by_rater",
    "compare_dependent",
    "compare_metrics",
    "compare_p1401",
    "compute_chart",
    "compute_sections",
    "contrast",
    "correlate",
    "discriminate",
    "discriminate_pairs",
    "equivalence",
    "find_sources",
    "fit_attributes",
    "fit_mixed",
    "fit_primary",
    "fit_space",
    "intraclass",
    "krippendorff_alpha",
    "multimodality",
    "noise_ceiling",
    "non_inferiority",
    "p1401",
    "profile_reducers",
    "read_table",
    "refine_metric",
    "regress_attributes",
    "repeated_measures_correlation",
    "run_multiverse",
    "screen_raters",
    "stress_by_dimension",
    "stress_reducers",
    "tabulate_slopes",
    "tukey_fences",
    "vary_primary",
    "write_advice",
    "write_chart",
    "write_report",
    "write_stress",
]
