"""The old name of `view`, kept until all branches are in."""

from feel321.study.screen.view import Hand, View, make_screen_texts

__all__ = ["Hand", "View", "make_screen_texts"]
