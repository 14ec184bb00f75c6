"""The cluster bootstrap over participants and recordings, and the weighted correlations it draws."""
