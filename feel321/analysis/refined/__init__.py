"""Refined metrics: does a weighted sum of metrics, or another shape of one, predict what each alone does not.

candidates (what is tried, and its nested cross-validation), refine (the public function and its tables).
"""
