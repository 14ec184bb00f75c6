"""Columns of `participants.csv` and `ratings.csv`."""

PARTICIPANT_COLUMNS = (
    "participant",
    "number",
    "simulated",
    "state",
    "sessions",
    "answered",
    "given_up",
    "total",
)
"""The first columns of `participants.csv`; one per factor in which participants differ follows.

Last of all come those of `thresholds.list_columns`, where thresholds were measured."""

LAST_PARTICIPANT_COLUMNS = ("first_utc", "last_utc", "training_passed", "rig", "calibration")

RATING_COLUMNS = (
    "participant", "session", "protocol", "block", "trial", "repeat", "stimulus_id", "recording", "reducer",
    "level", "reference_id", "scale", "rating", "response_time_s", "onset_s", "underruns", "rejected", "simulated",
    "spectral_match_delivered", "temporal_match_delivered", "spectral_match_bounded_delivered", "level_error_db",
    "delivered_by", "sensation_level_db", "other_id",
)  # fmt: skip
"""The columns of `ratings.csv`, in order."""
