"""The lines that open a report."""

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
