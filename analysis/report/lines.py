"""The lines that open a report, and what they claim, for a program to read."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Line:
    """One of the lines that open a report.

    Parameters
    ----------
    text : str
        What is claimed.
    subject : str
        What was rated; lines of one subject stand together on the page.
    lead : str
        What kind of evidence that is, and how much of it.
    """

    text: str
    subject: str = ""
    lead: str = ""

    def __str__(self) -> str:
        """Write it as a sentence of its own."""
        about = ", ".join(filter(None, (self.subject, self.lead)))
        return f"{about}: {self.text}" if about else self.text


@dataclass(frozen=True, slots=True)
class Claim:
    """What is concluded about one metric, for a program to read.

    Parameters
    ----------
    scale, level, metric : str
        About which ratings and which metric.
    verdict : str
        ``predicts``, ``open`` or ``not_estimable``.
    direction : str
        ``higher`` or ``lower`` ratings with a higher metric, where it predicts; empty otherwise.
    number : str
        Name of the slope among the numbers.
    hinges_on : tuple of str
        Stimuli, recordings and reducers without which verdict or sign change, as ``reducer mag321``.
    better_than : tuple of str
        Metrics that it predicts better than, in the same model.
    """

    scale: str
    level: str
    metric: str
    verdict: str
    direction: str
    number: str
    hinges_on: tuple[str, ...] = ()
    better_than: tuple[str, ...] = ()
