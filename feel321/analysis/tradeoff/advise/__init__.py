"""The least sufficient reducer of every scene.

A scene is a recording, or a segment of one, and the context in which it is felt (`scene`). Reducers are ordered by
simplicity, measured, compared with the best within tolerance and, where people rated them, by their ratings; the first
that is equivalent to the best is the answer (`choice`). `page` writes table, figure and page.
"""
