"""The power of a study that is not yet run: its own plan, stimuli and analysis, with planted slopes."""
