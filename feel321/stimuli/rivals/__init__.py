"""Rival metrics: other ways to compare vibrations, most from the literature, to test the match metrics against."""
