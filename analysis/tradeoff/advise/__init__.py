"""The least sufficient reducer of every scene.

A scene is a recording, or a segment of one, and the context in which it is to be felt. Reducers go by simplicity
(`simplicity`), are measured (`measures`, `axes`), compared with the best (`verdict`, by `tolerance`) and, where people
rated them, by their ratings (`rated`); the first that is equivalent to the best is the answer (`choice`, `wording`).
`report` writes table, figure (`drawing`) and page.
"""
