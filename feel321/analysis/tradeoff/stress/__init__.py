"""Stability: a battery of scenes in which methods fail, how badly they do, and which recordings come near."""
