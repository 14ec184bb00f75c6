"""Sessions to look at: live and blind for the experimenter, replayed from a journal, rehearsed in a browser."""
