"""One participant's session: plan, journal, and the engine that works through it against ports."""
