"""Refined metrics: does a weighted sum of metrics, or another shape of one, predict what each alone does not.

candidates (what may be chosen), folds (who is left out), choice (the inner cross-validation), score (the outer one),
tables (what came out), refine (the public function).
"""
