"""How far people agree: with one another, and with themselves."""
