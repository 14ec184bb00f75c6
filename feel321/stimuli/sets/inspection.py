"""Moved to `feel321.stimuli.sets.manifest`; kept until all branches are in."""

from feel321.stimuli.sets.manifest import check_stimuli

__all__ = ["check_stimuli"]
