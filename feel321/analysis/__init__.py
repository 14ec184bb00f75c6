"""Do the match metrics predict what people feel? Tables in, associations, models, profiles and a report out.

Importing this package loads none of it: a function's module is imported, with pandas and scipy, when the function is
asked for. What a statistic finds is a `Statistic`: named values, ``.to_frame()``, ``.to_dict()``; this and all other
records that functions return are in `feel321.results`. What cannot be computed is refused by a ValueError (a wrong type
by a TypeError) that says what must be, what was got and what to do; what is left out or assumed is in the notes.
"""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from feel321.arguments import import_lazily as _import_lazily

if _TYPE_CHECKING:
    from feel321.analysis.agreement import (
        intraclass,
        krippendorff_alpha,
        noise_ceiling,
        rater_model,
    )
    from feel321.analysis.association import compare_metrics, correlate
    from feel321.analysis.choices import discriminate
    from feel321.analysis.classic import compare_dependent, p1401, repeated_measures_correlation
    from feel321.analysis.contrasts.bradley_terry import bradley_terry
    from feel321.analysis.contrasts.compare import compare_reducers, equivalence
    from feel321.analysis.mixed.model import contrast, fit_mixed
    from feel321.analysis.plots import (
        plot_profile,
        plot_recording,
        plot_scatter,
        plot_slopes,
        plot_spectrum,
    )
    from feel321.analysis.primary.model import fit_attributes, fit_primary
    from feel321.analysis.report.write import write_report
    from feel321.analysis.screening import RULES, screen_raters
    from feel321.analysis.table.items import Table
    from feel321.analysis.table.reading import read_table
    from feel321.analysis.tradeoff.measure import measure_tradeoff
    from feel321.analysis.tradeoff.page import advise_tradeoff

__all__ = [
    "RULES", "Table", "advise_tradeoff", "bradley_terry",
    "compare_dependent", "compare_metrics", "compare_reducers", "contrast", "correlate",
    "discriminate", "equivalence", "fit_attributes", "fit_mixed", "fit_primary",
    "intraclass",
    "krippendorff_alpha", "measure_tradeoff", "noise_ceiling", "p1401",
    "plot_profile", "plot_recording", "plot_scatter", "plot_slopes",
    "plot_spectrum", "rater_model",
    "read_table", "repeated_measures_correlation", "screen_raters",
    "write_report",
]  # fmt: skip

__getattr__ = _import_lazily(__name__, __file__)


def __dir__() -> list[str]:
    return __all__
