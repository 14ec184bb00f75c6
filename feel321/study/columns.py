"""Columns of `participants.csv` and `ratings.csv`."""

from __future__ import annotations

# Columns of `participants.csv`.

PARTICIPANT_COLUMNS = ("participant", "number", "simulated", "state", "sessions", "done", "total")
"""The table's first columns; one per factor in which participants differ follows."""


LAST_PARTICIPANT_COLUMNS = ("first_utc", "last_utc", "training_passed")


# Columns of `ratings.csv`.

RATING_COLUMNS = (
    "participant",
    "session",
    "protocol",
    "block",
    "trial",
    "repeat",
    "stimulus_id",
    "recording",
    "reducer",
    "level",
    "reference_id",
    "scale",
    "rating",
    "response_time_s",
    "onset_s",
    "underruns",
    "rejected",
    "simulated",
)
"""The table's columns, in order."""
