"""What people tell apart, as a map, and what its axes mean."""
