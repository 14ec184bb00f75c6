"""Decisions made before ratings are seen: recorded, shown as text, and compared with what was done."""
