"""The only reader of foreign files: a recording of any format in, a `Recording` in m/s² out."""
