"""Do the match metrics predict what people feel? Tables in, associations, models, profiles and a report out.

Importing this package loads numpy and nothing heavier; pandas, scipy and matplotlib come with the first call.
"""

from analysis.agreement.alpha import Alpha, bootstrap_alpha, krippendorff_alpha
from analysis.agreement.reliability import Intraclass, intraclass, noise_ceiling
from analysis.association.correlate import Association, Difference, compare_metrics, correlate
from analysis.association.dependent import Dependent, compare_dependent
from analysis.association.repeated import RepeatedMeasures, repeated_measures_correlation
from analysis.contrasts.bradley_terry import BradleyTerry, bradley_terry, bradley_terry_by_rater
from analysis.contrasts.discrimination import Discrimination, abx_d_prime, discriminate, discriminate_pairs
from analysis.contrasts.equivalence import Equivalence, NonInferiority, equivalence, non_inferiority
from analysis.contrasts.profile import profile_reducers
from analysis.mixed.inference import Estimate
from analysis.mixed.model import MixedFit, contrast, fit_mixed
from analysis.numbers import Number
from analysis.p1401.difference import P1401Difference, compare_p1401
from analysis.p1401.mapping import P1401, p1401
from analysis.primary.model import Primary, fit_attributes, fit_primary, tabulate_slopes
from analysis.primary.multiverse import Multiverse, run_multiverse
from analysis.primary.precision import Precision
from analysis.primary.sensitivity import vary_primary
from analysis.refined.refine import Refined, refine_metric
from analysis.report.results import Results
from analysis.report.sections.choices import Choices
from analysis.report.sections.section import Section
from analysis.report.write import compute_sections, write_report
from analysis.screening import RULES, Screening, multimodality, screen_raters, tukey_fences
from analysis.space.landmarks import Alignment, Ellipses, align_spaces, bootstrap_space, regress_attributes
from analysis.space.scaling import Space, fit_space, stress_by_dimension
from analysis.table.further import Further
from analysis.table.reading import Table, read_table
from analysis.table.sources import find_sources
from analysis.tradeoff.advise.rated import judge_ratings
from analysis.tradeoff.advise.report import advise_recordings, write_advice
from analysis.tradeoff.advise.scene import Context
from analysis.tradeoff.advise.tolerance import Tolerance
from analysis.tradeoff.advise.verdict import Rated
from analysis.tradeoff.chart.chart import Chart
from analysis.tradeoff.chart.compute import compute_chart
from analysis.tradeoff.chart.write import write_chart
from analysis.tradeoff.stress.run import stress_reducers, write_stress

__all__ = [  # noqa: RUF022 - in the order of sorted(), which a test checks
    "Alignment",
    "Alpha",
    "Association",
    "BradleyTerry",
    "Chart",
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
    "Rated",
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
    "judge_ratings",
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
