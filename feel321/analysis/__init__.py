"""Do the match metrics predict what people feel? Tables in, associations, models, profiles and a report out.

Importing this package loads numpy and nothing heavier; pandas, scipy and matplotlib come with the first call.
"""

from feel321.analysis.agreement.alpha import Alpha, bootstrap_alpha, krippendorff_alpha
from feel321.analysis.agreement.reliability import Intraclass, intraclass, noise_ceiling
from feel321.analysis.association.correlate import (
    Association,
    Difference,
    compare_metrics,
    correlate,
)
from feel321.analysis.association.dependent import Dependent, compare_dependent
from feel321.analysis.association.repeated import RepeatedMeasures, repeated_measures_correlation
from feel321.analysis.contrasts.bradley_terry import (
    BradleyTerry,
    bradley_terry,
    bradley_terry_by_rater,
)
from feel321.analysis.contrasts.discrimination import (
    Discrimination,
    abx_d_prime,
    discriminate,
    discriminate_pairs,
)
from feel321.analysis.contrasts.equivalence import (
    Equivalence,
    NonInferiority,
    equivalence,
    non_inferiority,
    profile_reducers,
)
from feel321.analysis.mixed.model import Estimate, MixedFit, contrast, fit_mixed
from feel321.analysis.p1401.difference import P1401Difference, compare_p1401
from feel321.analysis.p1401.mapping import P1401, p1401
from feel321.analysis.primary.model import Primaries, Primary, fit_attributes, fit_primary
from feel321.analysis.primary.multiverse import Multiverse, run_multiverse
from feel321.analysis.refined.refine import Refined, refine_metric
from feel321.analysis.report.folder import Results
from feel321.analysis.report.section import Choices, Section
from feel321.analysis.report.write import compute_sections, write_report
from feel321.analysis.screening.rules import RULES
from feel321.analysis.screening.screen import Screening, screen_raters
from feel321.analysis.space import (
    Alignment,
    Ellipses,
    Space,
    align_spaces,
    bootstrap_space,
    fit_space,
    regress_attributes,
    stress_by_dimension,
)
from feel321.analysis.table.items import find_sources
from feel321.analysis.table.reading import Further, Table, read_table
from feel321.analysis.tradeoff.advise.page import advise_recordings, write_advice
from feel321.analysis.tradeoff.advise.ratings import judge_ratings
from feel321.analysis.tradeoff.advise.scene import Context, Rated, Tolerance
from feel321.analysis.tradeoff.chart.compute import compute_chart
from feel321.analysis.tradeoff.chart.page import write_chart
from feel321.analysis.tradeoff.chart.records import Chart
from feel321.analysis.tradeoff.stress.run import stress_reducers, write_stress
from feel321.analysis.words import Number
from feel321.doors import forward_old_names as _forward_old_names

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
    "Primaries",
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
    "write_advice",
    "write_chart",
    "write_report",
    "write_stress",
]

__getattr__ = _forward_old_names(
    __name__,
    {
        "Precision": "feel321.analysis.primary.sensitivity:SlopePrecision",
        "multimodality": "feel321.analysis.screening.rules:multimodality|Screening.items",
        "tabulate_slopes": "feel321.analysis.primary.model:tabulate_slopes|fit_attributes(table).to_frame()",
        "tukey_fences": "feel321.analysis.screening.rules:tukey_fences|Screening.items",
        "vary_primary": "feel321.analysis.primary.sensitivity:vary_primary|run_multiverse",
    },
)
