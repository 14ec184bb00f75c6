"""The least sufficient reducer of every scene."""
