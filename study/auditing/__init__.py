"""What the audit of a study verifies, one idea per module."""
