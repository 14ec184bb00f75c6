"""Refined metrics: candidates and their nested cross-validation, and the public function with its tables."""
