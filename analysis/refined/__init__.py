"""Refined metrics: does a weighted sum of metrics, or another shape of one, predict new recordings better than each?

candidates (what may be chosen), folds (who is left out), moments (sums that every fit is made of), choice (the inner
cross-validation), score (the outer one), refine (the public function).
"""
