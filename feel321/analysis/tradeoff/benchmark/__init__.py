"""A fixed battery for reducers, one card per method, and a leaderboard of cards."""
