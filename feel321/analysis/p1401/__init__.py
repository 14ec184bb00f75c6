"""ITU-T P.1401, the standard for judging objective metrics."""
