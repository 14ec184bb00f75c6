"""How a report was computed, told to its reader; part of ``results.json``."""

from __future__ import annotations

PROFILES = (
    "Profiles: mean over participants of each participant's mean over stimuli, on a scale from 0 to 100; 95 % t "
    "intervals over participants, cut off at the ends of the scale, which speak of other people judging these "
    "recordings. Where all participants' means are alike there is no interval: they do not tell how people differ."
)


def tell_associations(draws: int) -> tuple[str, ...]:
    """Describe how correlations were computed.

    Parameters
    ----------
    draws : int
        Bootstrap draws per interval.

    Returns
    -------
    tuple of str
        One paragraph each.
    """
    return (
        "Ratings run from 0 to 100. A stimulus's rating is the mean over participants of each participant's mean "
        "over repeats. The hidden reference and the anchors are left out of every association, because stimuli "
        "chosen to be far apart inflate a correlation; they stand in the profile of ratings.",
        "Correlations are over test stimuli, separately per scale and level. Pearson's r measures how straight the "
        "relation is, Spearman's how monotone it is.",
        f"Two-way intervals: {draws} bootstrap draws of participants and, independently, of recordings with all "
        "their stimuli, both with replacement; "
        "tanh(atanh r ± t(.975, U − 1) sqrt(U / (U − 1)) SD(atanh r*)) with U the number of recordings or of "
        "participants, whichever is smaller (recordings of one source are drawn together and count as one): the fewer "
        "there are, the less is known of how they differ. Draws that "
        "give no correlation are left out and counted; with more than a tenth of them there is no interval. They say "
        "what other people and other recordings might give. Intervals over participants only treat these very stimuli "
        "as the only ones; they are far too narrow for a claim about the metric and are shown for comparison with the "
        "literature.",
        "Differences between metrics: both correlations are recomputed in every draw; the interval of the difference "
        "of Fisher's z is told as a difference of correlations about their mean z.",
        "Noise ceiling: sqrt(ICC(C,k)) from a two-way analysis of variance, the correlation that a perfect metric "
        "would be expected to reach with ratings as noisy as these; it rests on the stimuli that everyone rated and "
        "needs half of them. r / ceiling is for Pearson's r only, because the ceiling is that of a straight relation, "
        "and is left out where the ceiling rests on fewer stimuli than r; it may exceed 1 by chance.",
    )
