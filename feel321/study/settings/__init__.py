"""What a study decides: `study.toml` read, checked against itself, and turned into what the other rooms take."""
