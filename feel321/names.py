"""Names of reducers and metrics, and what each metric declares: data, for what reads tables and needs no signals."""

from collections.abc import Mapping

from feel321.doors import Registry
from feel321.types import Direction, MetricInfo

MOST_DB = 60.0  # levels further apart count as this far apart: people feel some 55 dB

REDUCER_NAMES = (
    "sax321", "say321", "saz321", "soc321", "mag321", "pca321", "pca321_adaptive", "dft321", "dft321_windowed",
    "dft321_principal", "dft321_principal_windowed", "sax321_matched", "say321_matched", "saz321_matched",
    "pca321_matched", "sax321_matched_running", "say321_matched_running", "saz321_matched_running",
    "pca321_matched_windowed", "dft321_bands", "dft321_filtered",
)  # fmt: skip
"""In the order of the paper, simplest first; later ones follow. The only list of names."""

_WORSE_DB: tuple[Direction, float, float, str] = ("worse", 0.0, MOST_DB, "dB")
METRIC_INFO: Mapping[str, MetricInfo] = Registry(
    "metric",
    {
        "spectral_match": MetricInfo("spectral match", high=1.0),
        "temporal_match": MetricInfo("temporal match", low=0.0, high=1.0),
        "spectral_match_bounded": MetricInfo("bounded spectral match", low=0.0, high=1.0),
        "temporal_match_windowed": MetricInfo("temporal match in windows", low=0.0, high=1.0),
        "level_difference": MetricInfo("level difference", *_WORSE_DB),
        "log_spectral_distance": MetricInfo("log-spectral distance", *_WORSE_DB),
        "pacinian_power_difference": MetricInfo("Pacinian power difference", *_WORSE_DB),
        "envelope_correlation": MetricInfo("envelope correlation", "better", -1.0, 1.0),
        "modulation_distance": MetricInfo("modulation spectrum distance", "worse", 0.0),
        "st_sim": MetricInfo("ST-SIM", "better", 0.0, 1.0),
        "spqi": MetricInfo("SPQI", "better", 0.0, 1.0),
    },
)
"""Name of a metric, the match metrics first -> which way it points, its bounds, and how it is called on a page."""

MATCHES = ("spectral_match", "temporal_match", "spectral_match_bounded")
"""The match metrics: what is compared with delivered signals and over orientations, too."""

WRITTEN = (*MATCHES, "temporal_match_windowed")  # the metrics that `build` writes
ANCHOR = "anchor"  # the role of anchors in the manifest
ANCHOR_NAMES = ("anchor_low", "anchor_mid")

MEASURES: Mapping[str, str] = Registry(
    "measure",
    {
        "metric_of_reducer": "measure_metric",
        "rating_of_reducer": "measure_rating",
        "slope": "measure_slope",
        "one_axis_against_three": "measure_told_apart",
        "map_attribute": "measure_attribute",
        "correlation": "measure_correlation",
        "rating_excess": "measure_rating_excess",
    },
)
"""What a paper's claim can be examined with: the name that `[[paper.claims]]` gives -> function of
`feel321.analysis.replication`."""

EXPECTATIONS = ("positive", "negative", "near", "highest", "lowest")
"""What a paper's claim says of its number: on which side of zero, near the paper's, or above or below all others."""

PROVENANCE = ("full text", "abstract", "ours", "unknown")  # of a statement about a paper
