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
from feel321.analysis.primary.model import Primary, fit_attributes, fit_primary, tabulate_slopes
from feel321.analysis.primary.multiverse import Multiverse, run_multiverse
from feel321.analysis.primary.sensitivity import Precision, vary_primary
from feel321.analysis.refined.refine import Refined, refine_metric
from feel321.analysis.report.folder import Results
from feel321.analysis.report.section import Choices, Section
from feel321.analysis.report.write import compute_sections, write_report
from feel321.analysis.screening.rules import RULES, multimodality, tukey_fences
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
from feel321.analysis.tradeoff.face import advise, chart, stress
from feel321.analysis.words import Number
from feel321.doors import forward_old_names as _forward_old_names

__all__ = [  # noqa: RUF022 - in the order of sorted(), which a test checks
    "Alignment",
    "Alpha",
    "Association",
    "BradleyTerry",
    "Choices",
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
    "abx_d_prime",
    "advise",
    "align_spaces",
    "bootstrap_alpha",
    "bootstrap_space",
    "bradley_terry",
    "bradley_terry_by_rater",
    "chart",
    "compare_dependent",
    "compare_metrics",
    "compare_p1401",
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
    "stress",
    "stress_by_dimension",
    "tabulate_slopes",
    "tukey_fences",
    "vary_primary",
    "write_report",
]

_TRADEOFF = "feel321.analysis.tradeoff"
__getattr__ = _forward_old_names(
    __name__,
    {
        "Chart": f"{_TRADEOFF}.chart.compute:Chart|chart",
        "Context": f"{_TRADEOFF}.advise.scene:Context|the arguments of advise",
        "Rated": f"{_TRADEOFF}.advise.ratings:Rated|the arguments of advise",
        "Tolerance": f"{_TRADEOFF}.advise.scene:Tolerance|advise(weber=...)",
        "advise_recordings": f"{_TRADEOFF}.advise.page:advise_recordings|advise",
        "compute_chart": f"{_TRADEOFF}.chart.compute:compute_chart|chart",
        "judge_ratings": f"{_TRADEOFF}.advise.ratings:judge_ratings|advise(ratings=...)",
        "stress_reducers": f"{_TRADEOFF}.stress.run:stress_reducers|stress",
        "write_advice": f"{_TRADEOFF}.advise.page:write_advice|advise(...).write",
        "write_chart": f"{_TRADEOFF}.chart.page:write_chart|chart(...).write",
        "write_stress": f"{_TRADEOFF}.stress.run:write_stress|stress(...).write",
    },
)
