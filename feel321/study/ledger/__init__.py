"""Who takes part: slots in the design, how far everybody is, release and withdrawal."""
