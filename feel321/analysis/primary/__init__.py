"""The primary model: what it is made of, and how its slopes stand under other choices."""
