"""Simulated participants: what stimuli feel like, who the raters are, and a presenter that answers for them."""
