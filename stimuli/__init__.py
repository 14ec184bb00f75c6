"""Recordings in, stimuli out: readers, reducers, metrics and stimulus sets."""
