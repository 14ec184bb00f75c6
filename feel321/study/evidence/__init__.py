"""Evidence: checkpoints in git, what was frozen, the engine run on journals, and the audit that compares them all."""
