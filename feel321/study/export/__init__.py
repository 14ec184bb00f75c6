"""A study for other people: a dataset that validators accept, and the methods section."""
