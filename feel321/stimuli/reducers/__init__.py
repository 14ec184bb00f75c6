"""Reducers: three axes of acceleration in, one signal out."""
