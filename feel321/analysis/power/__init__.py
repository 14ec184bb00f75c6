"""Power of a study that is not yet run: its own stimuli, its own analysis, planted slopes."""
