"""Personal answers, kept apart from the journals, and participants who leave."""
