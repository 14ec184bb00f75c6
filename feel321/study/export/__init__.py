"""Export a study for others: a dataset that validators accept, and the methods section."""
