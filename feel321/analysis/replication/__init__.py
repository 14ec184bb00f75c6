"""Papers replicated: their claims as records, each examined with a registered measure, and a verdict on each."""
