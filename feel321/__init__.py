"""Do the match metrics of three-to-one vibration reduction predict what people feel.

`feel321.stimuli` makes what is played, `feel321.protocols` says what is judged, `feel321.study` runs sessions and the
command line, `feel321.analysis` holds the statistics and the report. Importing this package loads none of them.
"""

__version__ = "0.1.0"
